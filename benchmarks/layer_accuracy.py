"""How accurate a layer is for what it costs: integration points, cells, steps, local tolerance.

Measures the paper's layer under both walls and writes `runs.csv`, `converged.csv`, `tables.md` and two figures. Runs
serially, in a few minutes; docs/layer-accuracy.md shows and discusses the result.

    python benchmarks/layer_accuracy.py --out runs/layer_accuracy
"""

from __future__ import annotations

import csv
import gc
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from accuracy_report import Report, draw_costs, draw_mesh_errors
from measured import QUANTITIES, Converged, Measured, Quantity, walk
from rich.console import Console

from cosserat_fx._compat import MPI
from cosserat_fx.layer import build
from cosserat_fx.scene import load_scene
from cosserat_fx.stepping import StepControl, Stepper
from cosserat_fx.studies.convergence import limit

DEMOS = Path(__file__).resolve().parents[1] / "demos"
WALLS = {"very rough": "layer_very_rough.toml", "medium rough": "layer_medium_rough.toml"}
ALONG_GIVEN_STEPS = StepControl(first=math.inf, smallest=1e-9, tolerance=math.inf, strain=math.inf, growth=math.inf)
"""Goes from station to station in one step, whatever the strains say; only a failure cuts it."""

_LOW_PRESSURE = ("initial.stress=-1e3", "walls.top.normal_stress=-1e3")
_STRONG_ROTATION = ("walls.top.rolling=0.125",)
HARD_CASES = {
    "1 kPa": _LOW_PRESSURE,
    "w = -0.25 u/d50": _STRONG_ROTATION,
    "both": (*_LOW_PRESSURE, *_STRONG_ROTATION),
}
"""Keys that make the medium rough scene a hard one."""


@dataclass(frozen=True)
class Studies:
    """Sizes of the measurements.

    Attributes:
        cells: of the comparison of both integrations.
        mesh_cells: of the mesh refinement, for one and two integration points.
        mesh_parts: into how many parts the mesh refinement cuts each default step.
        step_cells: of the step refinement.
        step_parts: into how many parts it cuts each default step.
        tight: local tolerance of both refinements.
        step_factors: by which the step control's aims are scaled when steps alone are varied.
        local_tolerances: when these alone are varied.
        hard_cases: names of those to try.
    """

    cells: tuple[int, ...] = (20, 40, 80, 160, 320, 640)
    mesh_cells: tuple[tuple[int, ...], tuple[int, ...]] = (
        (20, 40, 80, 160, 320, 640, 1280),
        (20, 40, 80, 160, 320, 640),
    )
    mesh_parts: int = 4
    step_cells: int = 320
    step_parts: tuple[int, ...] = (4, 8, 16, 32)
    tight: float = 1e-6
    step_factors: tuple[float, ...] = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125, 0.0625)
    local_tolerances: tuple[float, ...] = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
    hard_cases: tuple[str, ...] = ("1 kPa", "w = -0.25 u/d50", "both")


QUICK = Studies(
    cells=(20, 40, 80),
    mesh_cells=((20, 40, 80), (20, 40)),
    mesh_parts=2,
    step_cells=40,
    step_parts=(2, 4, 8),
    tight=1e-5,
    step_factors=(2.0, 1.0, 0.5),
    local_tolerances=(1e-2, 1e-4),
    hard_cases=("w = -0.25 u/d50",),
)


class Bench:
    """Makes runs and remembers them."""

    def __init__(self, studies: Studies, console: Console) -> None:
        """Start with no runs."""
        self.studies, self._console = studies, console
        self.runs: list[Measured] = []

    def run(
        self,
        study: str,
        wall: str,
        *,
        case: str = "",
        cells: int = 80,
        points: int = 1,
        local_tolerance: float | None = None,
        overrides: Sequence[str] = (),
        travels: Sequence[float] = (),
        step_factor: float = 1.0,
    ) -> Measured:
        """Shear one layer.

        Args:
            study, wall, case: kept with the result.
            cells: over the height.
            points: integration points per cell.
            local_tolerance: of the constitutive update; the scene's default if None.
            overrides: further keys of the scene.
            travels: go exactly along these (m) instead of choosing the steps.
            step_factor: scales the aims of the step control.
        """
        keys = [f"geometry.cells={cells}", f"solver.integration_points={points}", *overrides]
        if local_tolerance is not None:
            keys.append(f"solver.local_tolerance={local_tolerance}")
        scene = load_scene(DEMOS / WALLS[wall], keys)
        layer = build(scene, MPI.COMM_SELF)
        control = ALONG_GIVEN_STEPS if travels else _scaled(layer.stepper.control, step_factor)
        stations = travels or layer.stations
        stepper = Stepper(layer.problem, layer.stepper.solver, layer.path.corners, stations, control)
        measured = Measured(study=study, wall=wall, case=case, points=points, cells=cells, **walk(layer, stepper))
        layer.stepper.solver.snes.destroy()  # or its callbacks keep the problem and its MPI communicators, of which
        del layer, stepper  # a process has not many
        gc.collect()
        self.runs.append(measured)
        self._console.print(str(measured), highlight=False)
        return measured

    def compare_integrations(self, wall: str) -> None:
        """One and two points on every mesh, with the default step control."""
        for points in (1, 2):
            for cells in self.studies.cells:
                self.run("integration", wall, points=points, cells=cells)

    def try_hard_cases(self) -> None:
        """One and two points where convergence is not a matter of course."""
        for case in self.studies.hard_cases:
            for points in (1, 2):
                self.run("hard case", "medium rough", case=case, points=points, overrides=HARD_CASES[case])

    def turn_knobs(self, wall: str) -> None:
        """The step control and the local tolerance, each alone."""
        for factor in self.studies.step_factors:
            self.run("steps", wall, case=f"aims x {factor:g}", step_factor=factor)
        for tolerance in self.studies.local_tolerances:
            self.run("local tolerance", wall, case=f"{tolerance:.0e}", local_tolerance=tolerance)

    def converge(self, wall: str) -> list[Converged]:
        """Refine steps, mesh and local tolerance, each until its limit is in sight.

        The steps are those of the default run, each cut into equal parts, so that a finer run's steps contain a
        coarser one's and nothing else changes with them.
        """
        studies, tight = self.studies, self.studies.tight
        coarse = self.run("default", wall).travels

        def along(study: str, parts: int, cells: int, points: int = 1, tolerance: float = tight) -> Measured:
            return self.run(
                study,
                wall,
                case=f"{parts} parts",
                cells=cells,
                points=points,
                local_tolerance=tolerance,
                travels=_cut(coarse, parts),
            )

        steps = [along("step refinement", parts, studies.step_cells) for parts in studies.step_parts]
        one, two = studies.mesh_cells
        mesh = [along("mesh refinement", studies.mesh_parts, cells) for cells in one]
        for cells in two:
            along("mesh refinement", studies.mesh_parts, cells, points=2)
        parts = studies.step_parts[-2]
        local = [along("local refinement", parts, 80, tolerance=tolerance) for tolerance in (tight, tight / 10)]
        base = one.index(studies.step_cells)
        return [self._combine(wall, quantity, steps, mesh, base, local) for quantity in QUANTITIES]

    @staticmethod
    def _combine(
        wall: str, quantity: Quantity, steps: list[Measured], mesh: list[Measured], base: int, local: list[Measured]
    ) -> Converged:
        """The limit of the steps on one mesh, corrected by what that mesh still misses."""
        step, step_error, step_rate = limit([run.value(quantity) for run in steps])
        fine, mesh_error, mesh_rate = limit([run.value(quantity) for run in mesh])
        value = float(step + fine - mesh[base].value(quantity))
        local_error = abs(local[1].value(quantity) - local[0].value(quantity))
        return Converged(wall, quantity, value, step_error, mesh_error, local_error, step_rate, mesh_rate)


def _scaled(control: StepControl, factor: float) -> StepControl:
    """The same control with first step and both aims scaled."""
    return replace(
        control, first=factor * control.first, tolerance=factor * control.tolerance, strain=factor * control.strain
    )


def _cut(travels: Iterable[float], parts: int) -> list[float]:
    """Each step cut into equal parts; the ends of the steps stay exactly what they were."""
    ends = [0.0, *travels]
    inner = np.arange(1, parts) / parts
    return [travel for start, end in pairwise(ends) for travel in (*(start + inner * (end - start)).tolist(), end)]


def _write_csv(file: Path, rows: Sequence[Measured] | Sequence[Converged], without: str = "") -> None:
    names = [field.name for field in fields(rows[0]) if field.name != without]
    with file.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def main(
    out: Annotated[Path, typer.Option(help="Folder for tables and figures.")] = Path("runs/layer_accuracy"),
    quick: Annotated[bool, typer.Option("--quick", help="Few and coarse runs, to see that it works.")] = False,
) -> None:
    """Measures the accuracy of the layer against its cost."""
    console = Console(soft_wrap=True)
    bench = Bench(QUICK if quick else Studies(), console)
    out.mkdir(parents=True, exist_ok=True)
    converged = []
    bench.run("warm-up", next(iter(WALLS)))
    for wall in WALLS:
        converged += bench.converge(wall)
        bench.compare_integrations(wall)
        bench.turn_knobs(wall)
    bench.try_hard_cases()
    report = Report(bench.runs, converged)
    _write_csv(out / "runs.csv", bench.runs, without="travels")
    _write_csv(out / "converged.csv", converged)
    (out / "tables.md").write_text(report.tables(), encoding="utf-8")
    draw_mesh_errors(report, out / "layer_accuracy_mesh.png")
    draw_costs(report, out / "layer_accuracy_cost.png")
    console.print(report.tables(), highlight=False)


if __name__ == "__main__":
    typer.run(main)
