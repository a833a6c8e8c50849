"""How accurate the biaxial test is on three meshes and with three step sizes, and what it is without polar terms.

Runs demos/biaxial.toml and writes `tables.md` and the figure `biaxial_meshes.png`; docs/biaxial.md shows both. Runs
serially, in about ten minutes.

    python benchmarks/biaxial_accuracy.py --out runs/biaxial_accuracy
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from matplotlib.collections import PolyCollection
from rich.console import Console

from cosserat_fx._compat import MPI
from cosserat_fx.output.page import figure
from cosserat_fx.output.plane_fields import PlaneState, read_states
from cosserat_fx.results import Run, read_run
from cosserat_fx.run import run
from cosserat_fx.scene import load_scene
from cosserat_fx.studies.tables import markdown

SCENE = Path(__file__).resolve().parents[1] / "demos" / "biaxial.toml"
CELLS = ((16, 56), (32, 112), (48, 168))
CLASSICAL_CELLS = ((8, 28), (16, 56), (32, 112))
"""Without polar terms; on all but the coarsest a run ends where its band begins."""
STEPS = (1e-3, 0.4e-3, 0.1e-3)
"""Largest steps asked for, which are the first ones too (m)."""
STATIONS = (0.003, 0.005, 0.007, 0.01)
"""Shortenings at which the axial stress is compared (m)."""
WIDTH, D50 = 0.04, 1e-3
ORDER = 2.0
"""Of the error in the size of the cells, for the extrapolation."""
CLASSICAL = (
    "effects.polar=false",
    "stepping.first_step=4e-4",
    "stepping.min_step=1e-5",
    "solver.max_iterations=80",
)
"""What a run without polar terms changes: steps and iterations with which it gets far; smaller steps do not save it."""
QUANTITIES = {**{f"stress at {1e3 * at:.0f} mm": "kPa" for at in STATIONS}, "inclination": "deg", "thickness": "d50"}
"""What is compared, with its unit."""


@dataclass(frozen=True)
class Test:
    """One run of the test.

    Attributes:
        polar: whether grains rotate and carry couple stresses.
        cells: along x1 and x2.
        step: asked for (m); None for the scene's own steps.
        run: what the run's folder holds.
        states: its fields at the start and at the stations.
        reason: why it stopped early, if it did.
    """

    polar: bool
    cells: tuple[int, int]
    step: float | None
    run: Run
    states: list[PlaneState]
    reason: str | None

    @property
    def size(self) -> float:
        """Of the cells, in mean grain diameters."""
        return WIDTH / self.cells[0] / D50

    @property
    def shortening(self) -> np.ndarray:
        """At each step (m)."""
        return self.run.history["top_displacement_m"]

    @property
    def stress(self) -> np.ndarray:
        """Axial stress at each step (kPa)."""
        return 1e-3 * self.run.history["axial_stress_Pa"]

    def values(self) -> dict[str, float]:
        """What is compared, by name, the band at the run's end; what the run did not come to is missing."""
        found = dict(zip(np.round(self.shortening, 9), self.stress, strict=True))
        names = list(QUANTITIES)
        values = {name: float(found[at]) for name, at in zip(names, STATIONS, strict=False) if at in found}
        band = self.run.summary.get("band")
        if band is not None:
            values |= {"inclination": band["inclination_deg"], "thickness": band["thickness_d50"]}
        return values


def measure(out: Path, cells: tuple[int, int], step: float | None, *, polar: bool = True) -> Test:
    """Run the test once.

    Args:
        out: where its folder goes.
        cells: along x1 and x2.
        step: first and largest step (m); None for the scene's own.
        polar: whether grains rotate.
    """
    asked = [f"stepping.first_step={step}", f"stepping.max_step={step}"] if step else []
    changes = [f"geometry.cells=[{cells[0]}, {cells[1]}]", *asked, *(() if polar else CLASSICAL)]
    scene = load_scene(SCENE, [*changes, "output.figures=false", "output.frames=0"])
    name = f"{'polar' if polar else 'classical'}_{cells[0]}_{'default' if step is None else f'{1e3 * step:g}mm'}"
    reason = run(scene, out / name, overwrite=True, comm=MPI.COMM_SELF).reason
    done = read_run(out / name)
    return Test(polar, cells, step, done, read_states(out / name / "fields"), reason)


def extrapolate(tests: Sequence[Test]) -> tuple[dict[str, float], dict[str, float]]:
    """The limit of vanishing cells from the two finest meshes at the smallest steps, and its own error.

    The error is the extrapolation's correction, and what the smallest steps change against the next larger ones on the
    finest mesh.
    """
    by = {(test.cells, test.step): test.values() for test in tests}
    (middle, fine), (larger, smallest) = CELLS[-2:], STEPS[-2:]
    weight = 1 / ((fine[0] / middle[0]) ** ORDER - 1)
    limit, error = {}, {}
    for name, value in by[fine, smallest].items():
        correction = weight * (value - by[middle, smallest][name])
        limit[name] = value + correction
        error[name] = abs(correction) + abs(value - by[fine, larger][name])
    return limit, error


def tables(polar: Sequence[Test], classical: Sequence[Test]) -> str:
    """All tables, in Markdown."""
    limit, error = extrapolate(polar)
    heads = ["", *(f"{name} ({unit})" for name, unit in QUANTITIES.items())]
    converged = [
        ["value", *(f"{limit[name]:.2f}" for name in QUANTITIES)],
        ["error", *(f"{error[name]:.2f}" for name in QUANTITIES)],
        ["error (%)", *(f"{100 * error[name] / limit[name]:.2f}" for name in QUANTITIES)],
    ]
    compared = 2 + len(QUANTITIES)
    heads_of_runs = ["cells (d50)", "steps asked (mm)", *QUANTITIES, "steps", "iterations", "passages"]
    return "\n\n".join(
        [
            "### Converged values\n\n" + markdown(heads, converged),
            "### Values\n\n" + markdown(heads_of_runs, [_row(test, {}) for test in polar]),
            "### Errors (%) against the converged values\n\n"
            + markdown(heads_of_runs[:compared], [_row(test, limit)[:compared] for test in polar]),
            "### Without polar terms\n\n"
            + markdown(
                [*heads_of_runs[:1], *heads_of_runs[2:], "how it ended"],
                [[_row(test, {})[0], *_row(test, {})[2:], _ending(test)] for test in classical],
            ),
        ]
    )


def _row(test: Test, limit: Mapping[str, float]) -> list[str]:
    """A test's values, or their errors where converged values are given."""
    values, summary = test.values(), test.run.summary
    if limit:
        values = {name: 100 * (value / limit[name] - 1) for name, value in values.items()}
    shown = [f"{values[name]:{'+.2f' if limit else '.2f'}}" if name in values else "" for name in QUANTITIES]
    passages = int(test.run.history["branch_passages"].sum())
    counts = [str(summary["steps"]), str(summary["newton_iterations"]), str(passages)]
    return [f"{test.size:.3g}", "default" if test.step is None else f"{1e3 * test.step:g}", *shown, *counts]


def _ending(test: Test) -> str:
    return "done" if test.reason is None else f"stopped at {1e3 * test.shortening[-1]:.2f} mm: {test.reason}"


def draw(polar: Sequence[Test], classical: Sequence[Test], file: Path) -> None:
    """Load-shortening curves and maps of the shear strain on three meshes, polar above classical.

    Args:
        polar, classical: a run on each mesh.
        file: the PNG to write.
    """
    points = 1e3 * np.concatenate([test.states[-1].deformed for test in (*polar, *classical)])
    left, right = points[:, 0].min() - 1, points[:, 0].max() + 1
    top_strain = max(float(test.states[-1].means["shear_strain"].max()) for test in polar)
    highest = 1.05 * max(float(test.stress.max()) for test in (*polar, *classical))
    with figure(file, 15.5) as sheet:
        grid = sheet.subplots(2, 4, width_ratios=[1.75, 1, 1, 1])
        for row, tests, words in zip(grid, (polar, classical), ("Cosserat", "classical"), strict=True):
            for test, style in zip(tests, (":", "--", "-"), strict=True):
                row[0].plot(1e3 * test.shortening, test.stress, style, color="k", label=f"{test.size:.3g} $d_{{50}}$")
                if test.reason is not None:
                    row[0].plot(1e3 * test.shortening[-1], test.stress[-1], "x", color="k")
            row[0].set(
                xlim=(0, 1e3 * STATIONS[-1]),
                ylim=(0, highest),
                title=words,
                ylabel="axial stress (kPa)",
                xticks=range(0, 11, 2),
            )
            row[0].legend(title="cells", loc="lower right")
            for axes, test in zip(row[1:], tests, strict=True):
                state = test.states[-1]
                picture = PolyCollection(
                    list(1e3 * state.deformed[state.cells]),
                    array=state.means["shear_strain"],
                    cmap="YlOrBr",
                    clim=(0, top_strain),
                    antialiaseds=False,
                )
                axes.add_collection(picture)
                axes.set(aspect="equal", xlim=(left, right), ylim=(-1, 1e3 * 0.141))
                axes.axis("off")
                axes.set_title(f"{test.size:.3g} $d_{{50}}$, {1e3 * state.travel:.3g} mm", fontsize=9.0)
        grid[1, 0].set_xlabel("shortening (mm)")
        sheet.colorbar(picture, ax=grid[:, 1:], label="shear strain", extend="max", location="bottom", aspect=40)


def main(out: Annotated[Path, typer.Option(help="Folder for the runs, the tables and the figure.")]) -> None:
    """Make all runs, and from them tables and figure."""
    console = Console()
    out.mkdir(parents=True, exist_ok=True)
    polar, default = [], []
    for cells in CELLS:
        default.append(measure(out, cells, None))
        polar += [measure(out, cells, step) for step in STEPS]
        console.print(f"{cells[0]} x {cells[1]} cells are done")
    classical = [measure(out, cells, None, polar=False) for cells in CLASSICAL_CELLS]
    (out / "tables.md").write_text(tables([*default, *polar], classical) + "\n")
    draw(default, classical, out / "biaxial_meshes.png")
    console.print((out / "tables.md").read_text(), soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
