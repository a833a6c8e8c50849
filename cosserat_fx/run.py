"""One run: a scene, stepped through, with everything it leaves in its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from rich.console import Console
from rich.table import Table

from cosserat_fx._compat import MPI, PETSc
from cosserat_fx.audit import Audit
from cosserat_fx.bodies import Body, build, recording_of
from cosserat_fx.effects import Effect, effects
from cosserat_fx.hypoplasticity import REASONS, Status
from cosserat_fx.kernel_time import IN_KERNEL, kernel_shares
from cosserat_fx.newton import PetscOption
from cosserat_fx.output.layer_observation import looseness
from cosserat_fx.output.recording import Recording
from cosserat_fx.parallel import on_first_rank
from cosserat_fx.plots import draw_all
from cosserat_fx.progress import RunProgress
from cosserat_fx.results import FORMAT, OutputError, RunFolder
from cosserat_fx.scene import Scene, SceneError
from cosserat_fx.stepping import Step, SteppingError
from cosserat_fx.versions import versions


@dataclass
class Ledger:
    """What a run has come to so far.

    Attributes:
        steps, iterations, cutbacks, passages: totals.
        reason: why it stopped early, if it did.
        warnings: what the user should know.
    """

    steps: int = 0
    iterations: int = 0
    cutbacks: int = 0
    passages: int = 0
    reason: str | None = None
    warnings: list[str] = field(default_factory=list)


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
        body = build(scene, comm, dict(options or {}))
    except PETSc.Error as error:
        raise SceneError(f"solver.petsc: {_told_by(error)}") from error
    recording = recording_of(body)
    folder = on_first_rank(comm, lambda: RunFolder.create(out, overwrite, recording.columns, recording.profile_columns))
    recorder = Recorder(body, recording, folder, start)
    recorder.summarise("running")
    console.print(describe(body, recorder.effects))
    body.problem.stopwatch.seconds["set-up"] = perf_counter() - start
    ledger = recorder.ledger
    try:
        recorder.start()
        with RunProgress(console, body.path.length) as progress:
            for step in body.stepper:
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


def describe(body: Body, listed: list[Effect]) -> Table:
    """A table of a body's effects with the share of each, and of the problem's sizes.

    Args:
        body: what is run.
        listed: its effects.
    """
    shares = [_kernel_share(effect) for effect in listed]
    caption = _sizes_line(body) + "\n? is measured by the command check with --measure" * ("?" in shares)
    table = Table(title=body.scene.title or None, caption=caption, box=None, padding=(0, 2, 0, 0))
    for heading in ("effect", "choice"):
        table.add_column(heading)
    for heading in ("unknowns", "bytes/point", "kernel time"):
        table.add_column(heading, justify="right")
    table.add_column("reason")
    for effect, share in zip(listed, shares, strict=True):
        sizes = [str(size or "") for size in (effect.unknowns, effect.bytes_per_point)]
        table.add_row(effect.name, effect.choice, *sizes, share, effect.reason)
    return table


def _kernel_share(effect: Effect) -> str:
    if effect.kernel_time is not None:
        return f"{100 * effect.kernel_time:.0f} %"
    return "?" if effect.is_on and effect.name in IN_KERNEL else ""


def _sizes_line(body: Body) -> str:
    counts = [f"{value} {name.replace('_', ' ')}" for name, value in body.problem.sizes.items()]
    return ", ".join([*counts, f"elements of {body.element_sizes}"])


class Recorder:
    """Writes what a run's folder holds as the run goes on."""

    def __init__(self, body: Body, recording: Recording, folder: RunFolder, start: float) -> None:
        """Prepare to observe.

        Args:
            body: what is run.
            recording: what its kind shows.
            folder: the run's folder, just created.
            start: when the run began, by ``perf_counter`` (s).
        """
        self.ledger = Ledger(warnings=list(body.warnings))
        self._start = start
        self._body, self._problem, self._scene = body, body.problem, body.scene
        self._audit = Audit(body)
        self._recording, self._folder = recording, folder
        self._comm = body.problem.comm
        self._loose = False
        self.effects = kernel_shares(effects(body), body, compiling=False)

    def start(self) -> None:
        """Write the initial state."""
        self._recording.start(self._folder)

    def record(self, step: Step) -> None:
        """Write an accepted step: its row, and what else its kind of body shows."""
        with self._problem.stopwatch("output"):
            row = self._recording.row(step)
            ledger = self.ledger
            ledger.steps, ledger.iterations = step.number, ledger.iterations + step.iterations
            ledger.cutbacks += step.cutbacks
            ledger.passages += step.passages
            self._audit.observe(row)
            on_first_rank(self._comm, lambda: self._folder.append_history(row))
            self._watch_looseness(step)
            self._tell_passage(step)
            self._recording.record(step)

    def finish(self) -> None:
        """Write the summary and draw the figures."""
        if self.ledger.steps:
            self._recording.finish()
        self.ledger.warnings += self._audit.warnings(self._recording.entries())
        status = "done" if self.ledger.reason is None else "stopped"
        self.summarise(status)
        if self._scene.output.figures and self.ledger.steps:
            with self._problem.stopwatch("figures"):
                on_first_rank(self._comm, lambda: draw_all(self._folder.path))
            self.summarise(status)

    def summarise(self, status: str) -> None:
        """Write run.json, on rank 0, which needs no other rank for it."""
        on_first_rank(self._comm, lambda: self._folder.write_summary(self._summary(status)))

    def _summary(self, status: str) -> dict[str, Any]:
        problem, scene, ledger, sizes = self._problem, self._scene, self.ledger, self._body.element_sizes
        phases = problem.stopwatch.seconds | {"whole run": perf_counter() - self._start}
        return {
            "format": FORMAT,
            "status": status,
            "reason": ledger.reason,
            "title": scene.title,
            "versions": versions(),
            "ranks": self._comm.size,
            "scene": scene.as_dict(),
            "effects": [asdict(effect) for effect in self.effects],
            "sizes": problem.sizes,
            "element_size_d50": {name: getattr(sizes, name) for name in ("smallest", "median", "largest")},
            "steps": ledger.steps,
            "newton_iterations": ledger.iterations,
            "cutbacks": ledger.cutbacks,
            "branch_passages": ledger.passages,
            "seconds": {name: round(seconds, 6) for name, seconds in sorted(phases.items())},
            "calls": dict(sorted(problem.stopwatch.calls.items())),
            "warnings": ledger.warnings,
            **self._recording.entries(),
        }

    def _watch_looseness(self, step: Step) -> None:
        """Warn once, where and from when the void ratio exceeds e_i."""
        loose = None if self._loose else looseness(self._problem)
        if loose is None:
            return
        self._loose = True
        self.ledger.warnings.append(
            f"{REASONS[Status.LOOSER_THAN_E_I]}, at {loose.count} point(s) from a travel of "
            f"{self._recording.travel(step):.6g} m on, first at {loose.place}"
        )

    def _tell_passage(self, step: Step) -> None:
        """Tell where a branch of equilibria became unstable, and what was done."""
        if step.passages:
            done = "followed on" if self._body.stepper.control.branch == "primary" else "left for a stable one"
            self.ledger.warnings.append(
                f"at a travel of {self._recording.travel(step):.6g} m the branch of equilibria had become unstable "
                f"and was {done}"
            )
