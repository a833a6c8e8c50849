"""One run: a scene, stepped through, with everything it leaves in its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from cosserat_fx._compat import MPI, PETSc
from cosserat_fx.bands import band_metrics, friction_metrics
from cosserat_fx.effects import audit, effects
from cosserat_fx.fields import FieldWriter
from cosserat_fx.hypoplasticity import REASONS, Status
from cosserat_fx.layer import Layer, build
from cosserat_fx.newton import PetscOption
from cosserat_fx.observation import Columns, LayerObserver
from cosserat_fx.parallel import on_first_rank
from cosserat_fx.plots import draw_all
from cosserat_fx.progress import RunProgress
from cosserat_fx.results import FORMAT, OutputError, RunFolder, read_run
from cosserat_fx.scene import Scene, SceneError
from cosserat_fx.stepping import Step, SteppingError
from cosserat_fx.versions import versions


@dataclass
class Ledger:
    """What a run has come to so far.

    Attributes:
        steps, iterations, cutbacks: totals.
        reason: why it stopped early, if it did.
        warnings: what the user should know.
        max_shear_strain: largest |du1/dx2| of any point at any step.
    """

    steps: int = 0
    iterations: int = 0
    cutbacks: int = 0
    reason: str | None = None
    warnings: list[str] = field(default_factory=list)
    max_shear_strain: float = 0.0


def run(
    scene: Scene,
    out: Path,
    *,
    overwrite: bool = False,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    console: Console | None = None,
    options: Mapping[str, PetscOption] | None = None,
) -> Ledger:
    """Run a scene and write its folder. Every rank calls this; rank 0 writes.

    Args:
        scene: the validated scene.
        out: the run's folder.
        overwrite: whether an earlier run there may be replaced.
        comm: the ranks.
        console: where progress goes; silence by default.
        options: PETSc options (without prefix).

    Returns:
        The totals; ``reason`` tells whether and why the run stopped early.

    Raises:
        OutputError: the folder cannot be made.
        SceneError: PETSc refuses an option.
    """
    start = perf_counter()
    console = console if console is not None and comm.rank == 0 else Console(quiet=True)
    on_first_rank(comm, lambda: RunFolder.check(out, overwrite))
    try:
        layer = build(scene, comm, dict(options or {}))
    except PETSc.Error as error:
        raise SceneError(f"solver.petsc: {_told_by(error)}") from error
    folder = on_first_rank(comm, lambda: RunFolder.create(out, overwrite))
    recorder = Recorder(layer, folder, start)
    recorder.summarise("running")
    console.print(describe(layer))
    layer.problem.stopwatch.seconds["set-up"] = perf_counter() - start
    ledger = recorder.ledger
    try:
        recorder.start()
        with RunProgress(console, layer.path.length) as progress:
            for step in layer.stepper:
                recorder.record(step)
                progress.report(step)
    except (SteppingError, OutputError) as failure:
        ledger.reason = str(failure)
    except PETSc.Error as error:
        ledger.reason = _told_by(error)
    try:
        recorder.finish()
    except OutputError as failure:
        ledger.reason = ledger.reason or str(failure)
    return ledger


def _told_by(error: PETSc.Error) -> str:
    """What PETSc says, without the trace of calls that it puts first."""
    return f"PETSc says: {str(error).splitlines()[-1].partition('] ')[2]}"


def describe(layer: Layer) -> Table:
    """A table of the effects that a scene calls for, with the problem's sizes."""
    table = Table(title=layer.scene.title or None, caption=_sizes_line(layer), box=None, padding=(0, 2, 0, 0))
    for heading in ("effect", "choice", "reason"):
        table.add_column(heading)
    for effect in effects(layer.scene):
        table.add_row(effect.name, effect.choice, effect.reason)
    return table


def _sizes_line(layer: Layer) -> str:
    sizes = layer.problem.sizes
    return ", ".join(f"{value} {name.replace('_', ' ')}" for name, value in sizes.items())


class Recorder:
    """Writes what a run's folder holds as the run goes on."""

    def __init__(self, layer: Layer, folder: RunFolder, start: float) -> None:
        """Prepare to observe.

        Args:
            layer: what is run.
            folder: the run's folder, just created.
            start: when the run began, by ``perf_counter`` (s).
        """
        self.ledger = Ledger()
        self._start = start
        self._layer, self._folder = layer, folder
        self._scene, self._comm = layer.scene, layer.problem.comm
        self._observer = LayerObserver(layer)
        self._fields: FieldWriter | None = None
        self._profile: Columns | None = None
        self._step, self._travel = 0, 0.0
        self._loose = False

    def start(self) -> None:
        """Write the initial state."""
        if self._scene.output.fields and self._comm.rank == 0:
            self._fields = FieldWriter(self._folder.fields)
        self._write_fields(0, 0.0)
        if 0.0 in self._layer.stations:
            self._write_profile(0, 0.0)

    def record(self, step: Step) -> None:
        """Write an accepted step: its row, and where asked for its profiles and fields."""
        with self._layer.problem.stopwatch("output"):
            row = self._observer.row(step)
            ledger = self.ledger
            ledger.steps, ledger.iterations = step.number, ledger.iterations + step.iterations
            ledger.cutbacks += step.cutbacks
            ledger.max_shear_strain = max(ledger.max_shear_strain, row["max_shear_strain"])
            on_first_rank(self._comm, lambda: self._folder.append_history(row))
            self._watch_looseness(step)
            if step.travel in self._layer.stations:
                self._write_profile(step.number, step.travel)
                self._write_fields(step.number, step.travel)
            self._step, self._travel = step.number, step.travel

    def finish(self) -> None:
        """Write the summary and draw the figures."""
        self.ledger.warnings += audit(self._scene, self.ledger.max_shear_strain)
        if self.ledger.steps:
            self._profile = self._observer.profile(self._step, self._travel)
        status = "done" if self.ledger.reason is None else "stopped"
        self.summarise(status)
        if self._scene.output.figures and self.ledger.steps:
            with self._layer.problem.stopwatch("figures"):
                on_first_rank(self._comm, lambda: draw_all(self._folder.path))
            self.summarise(status)

    def summarise(self, status: str) -> None:
        """Write run.json, on rank 0, which needs no other rank for it."""
        on_first_rank(self._comm, lambda: self._folder.write_summary(self._summary(status)))

    def _summary(self, status: str) -> dict[str, Any]:
        problem, scene, ledger = self._layer.problem, self._scene, self.ledger
        phases = problem.stopwatch.seconds | {"whole run": perf_counter() - self._start}
        summary: dict[str, Any] = {
            "format": FORMAT,
            "status": status,
            "reason": ledger.reason,
            "title": scene.title,
            "versions": versions(),
            "ranks": self._comm.size,
            "scene": scene.as_dict(),
            "effects": [asdict(effect) for effect in effects(scene)],
            "sizes": problem.sizes,
            "steps": ledger.steps,
            "newton_iterations": ledger.iterations,
            "cutbacks": ledger.cutbacks,
            "seconds": {name: round(seconds, 6) for name, seconds in sorted(phases.items())},
            "calls": dict(sorted(problem.stopwatch.calls.items())),
            "warnings": ledger.warnings,
        }
        if self._profile is not None:
            history = read_run(self._folder.path).history
            profile = self._profile
            pressure = -(profile["s11_Pa"] + profile["s22_Pa"] + profile["s33_Pa"]) / 3
            critical = scene.material.characteristic_void_ratios(pressure).e_c
            if np.any(profile["shear_strain"]):
                band = band_metrics(profile, critical, d50=scene.material.d50, height=scene.geometry.height)
                summary["band"] = asdict(band)
            summary["friction"] = asdict(friction_metrics(history))
        return summary

    def _write_profile(self, step: int, travel: float) -> None:
        profile = self._observer.profile(step, travel)
        on_first_rank(self._comm, lambda: None if profile is None else self._folder.append_profile(profile))

    def _write_fields(self, step: int, travel: float) -> None:
        if not self._scene.output.fields:
            return
        nodes, profile = self._observer.nodes(), self._observer.profile(step, travel)

        def write() -> None:
            if self._fields is not None and nodes is not None and profile is not None:
                self._fields.write(travel, nodes, profile)

        on_first_rank(self._comm, write)

    def _watch_looseness(self, step: Step) -> None:
        """Warn once, where and from when the void ratio exceeds e_i."""
        loose = self._observer.looseness()
        if loose is None or self._loose:
            return
        self._loose = True
        self.ledger.warnings.append(
            f"{REASONS[Status.LOOSER_THAN_E_I]}, at {loose.count} point(s) from a travel of {step.travel:.6g} m on, "
            f"first at y = {loose.height:.6g} m"
        )
