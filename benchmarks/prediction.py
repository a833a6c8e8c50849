"""What the command check predicts a run to take, against what it takes.

The demos and scenes that differ from them in cells, path, element, pressure and grain size. Predictions and runs take
place in one process, one after the other. Writes `prediction.json` and `.md`.

    python benchmarks/prediction.py --out runs/prediction
"""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer
from timing_pairs import table, write

from cosserat_fx._compat import MPI
from cosserat_fx.bodies import build
from cosserat_fx.cost import expected_cost
from cosserat_fx.scene import load_scene
from cosserat_fx.stepping import SteppingError

DEMOS = Path(__file__).resolve().parents[1] / "demos"
RUNS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("layer_very_rough", ()),
    ("layer_medium_rough", ()),
    ("layer_medium_rough", ("geometry.cells=640",)),
    ("layer_medium_rough", ("walls.top.shear_displacement=[0.01,-0.01,0.01]", "output.profiles_at=[]")),
    ("layer_very_rough", ("initial.stress=-5e3", "walls.top.normal_stress=-5e3")),
    ("layer_very_rough", ("material.d50=0.2e-3", "geometry.cells=200")),
    ("biaxial", ()),
    ("biaxial", ("geometry.cells=[32,112]", "boundaries.top.u2=-0.004", "output.fields_at=[0.004]")),
    ("biaxial", ('solver.element="Q1"', "boundaries.top.u2=-0.005", "output.fields_at=[0.005]")),
    ("shear_box", ()),
    ("rough_strip_very_rough", ()),
    ("rough_strip_medium_rough", ()),
)
QUIET = ("output.figures=false",)


def main(
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    quick: Annotated[bool, typer.Option(help="The layers of the demos alone.")] = False,
) -> None:
    """Measure and report."""
    rows, ratios = [], []
    for name, overrides in RUNS[:2] if quick else RUNS:
        scene = load_scene(DEMOS / f"{name}.toml", [*QUIET, *overrides])
        cost = expected_cost(build(scene, MPI.COMM_SELF))
        body = build(scene, MPI.COMM_SELF)
        start, steps = perf_counter(), 0
        try:
            for step in body.stepper:
                steps = step.number
        except SteppingError:
            name += " (stopped early)"
        took = perf_counter() - start
        body.stepper.solver.snes.destroy()
        ratios.append(cost.seconds / took)
        what = ", ".join((name.replace("_", " "), *(f"`{one}`" for one in overrides)))
        rows.append([what, cost.steps, steps, f"{cost.seconds:.2g}", f"{took:.2g}", f"{ratios[-1]:.2f}"])
    headings = ["run", "steps predicted", "made", "seconds predicted", "taken", "ratio"]
    within = sum(0.5 <= ratio <= 2 for ratio in ratios)
    text = table(headings, rows) + f"\nWithin a factor of two: {within} of {len(ratios)}.\n"
    write(out, "prediction", {"ratios": ratios}, text)
    print(text)


if __name__ == "__main__":
    typer.run(main)
