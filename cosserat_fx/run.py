"""One run: a scene, stepped through, with everything it leaves in its folder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from time import perf_counter

from rich.console import Console
from rich.table import Table

from cosserat_fx._compat import MPI, PETSc
from cosserat_fx.bodies import Body, build, recording_of, told_by
from cosserat_fx.checkpoint import Checkpoints
from cosserat_fx.effects import Effect
from cosserat_fx.form_cache import with_forms
from cosserat_fx.interruption import InterruptedRunError, Interruption
from cosserat_fx.layer import Layer
from cosserat_fx.linear_solver import PetscOption
from cosserat_fx.output.lock import FolderLock
from cosserat_fx.parallel import FailedAloneError, RollCall, on_first_rank
from cosserat_fx.progress import RunProgress
from cosserat_fx.recorder import Ledger, Recorder
from cosserat_fx.results import OutputError, RunFolder, read_run
from cosserat_fx.scene import Scene
from cosserat_fx.stepping import SteppingError


def run(
    scene: Scene,
    out: Path,
    *,
    overwrite: bool = False,
    resume: bool = False,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    console: Console | None = None,
    options: Mapping[str, PetscOption] | None = None,
) -> Ledger:
    """Run a scene and write its folder. Every rank calls this; rank 0 writes.

    Args:
        scene: the validated scene.
        out: the run's folder.
        overwrite: whether an earlier run there may be replaced.
        resume: whether an unfinished run of the scene there is to be gone on with; without one the run begins.
        comm: the ranks.
        console: where progress goes; silence by default.
        options: PETSc options (without prefix).

    Returns:
        The totals; ``reason`` tells whether and why the run stopped early.

    Raises:
        OutputError: the folder cannot be made, or what is in it cannot be gone on with.
        SceneError: as :func:`~cosserat_fx.bodies.build` says.
        FailedAloneError: this rank failed and others did not.
    """
    start = perf_counter()
    console = console if console is not None and comm.rank == 0 else Console(quiet=True)
    on_first_rank(comm, lambda: RunFolder.check(out, overwrite or resume))

    def set_up() -> tuple[Body, RunFolder, Checkpoints, Recorder]:
        body = build(scene, comm, dict(options or {}))
        recording = recording_of(body)
        folder = RunFolder(out, recording.columns, recording.profile_columns)
        checkpoints = Checkpoints(folder, body.scene, body.stepper)
        return body, folder, checkpoints, Recorder(body, recording, folder, start, checkpoints.scene_digest)

    body, folder, checkpoints, recorder = with_forms(comm, set_up)
    with _locked(out, comm):
        if resume and on_first_rank(comm, lambda: folder.is_done(checkpoints.scene_digest)):
            return on_first_rank(comm, lambda: Ledger.of(read_run(out).summary))
        going_on = checkpoints.load() if resume else None
        if going_on is None:
            on_first_rank(comm, lambda: folder.clear(overwrite or resume))
            recorder.summarise("running")
            recorder.start()
        else:
            recorder.resume(*going_on)
            recorder.summarise("running")
            console.print(f"going on after step {recorder.ledger.steps}", highlight=False)
        console.print(describe(body, recorder.effects))
        body.problem.stopwatch.seconds["set-up"] += perf_counter() - start
        with Interruption(comm) as interruption, RollCall(comm) as roll:
            body.stepper.solver.before_evaluation = interruption.check
            _walk(body, recorder, checkpoints, console, roll)
    return recorder.ledger


@contextmanager
def _locked(out: Path, comm: MPI.Intracomm) -> Iterator[None]:
    """Keep other runs out of the folder."""
    lock = FolderLock(out)
    on_first_rank(comm, lock.acquire)
    try:
        yield
    finally:
        lock.release()


def _walk(body: Body, recorder: Recorder, checkpoints: Checkpoints, console: Console, roll: RollCall) -> None:
    """Walk to the end or as far as it goes, and leave the folder so that nothing of it is lost."""
    ledger = recorder.ledger
    try:
        with RunProgress(console, body.path.length) as progress:
            for step in body.stepper:
                recorder.record(step)
                progress.report(step)
                if checkpoints.due():
                    _save(checkpoints, recorder)
    except (OutputError, SteppingError, InterruptedRunError, PETSc.Error) as error:
        if not roll.is_complete():
            raise FailedAloneError(str(error)) from error
        ledger.reason = told_by(error) if isinstance(error, PETSc.Error) else str(error)
        if not isinstance(error, OutputError):
            _save(checkpoints, recorder)
    try:
        recorder.finish()
        if ledger.reason is None:
            checkpoints.remove()
    except OutputError as failure:
        ledger.reason = ledger.reason or str(failure)
        with suppress(OutputError):
            recorder.summarise("stopped")


def _save(checkpoints: Checkpoints, recorder: Recorder) -> None:
    """Write a checkpoint; a run without one is worth more than no run, so that it only warns where that fails."""
    if not checkpoints.wanted:
        return
    with recorder.stopwatch("checkpoints"):
        try:
            checkpoints.save(recorder.memento())
        except OutputError as failure:
            recorder.warn_once(f"no checkpoint could be written: {failure}")


def describe(body: Body, listed: list[Effect]) -> Table:
    """A table of a body's effects with the share of each, and of the problem's sizes.

    Args:
        body: what is run.
        listed: its effects.
    """
    shares = [_kernel_share(effect) for effect in listed]
    caption = f"{_sizes_line(body)}\n{body.stepper.solver.linear.choice}" + (
        f"\n{body.plan}" if isinstance(body, Layer) and body.plan else ""
    )
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
    return "" if effect.kernel_time is None else f"{100 * effect.kernel_time:.0f} %"


def _sizes_line(body: Body) -> str:
    counts = [f"{value} {name.replace('_', ' ')}" for name, value in body.problem.sizes.items()]
    return ", ".join([*counts, f"elements of {body.element_sizes}"])
