"""The command line: run, check, study, plot, info.

Exit status: 0 done; 2 bad input, with one message and nothing written; 3 the simulation stopped early, with the reason,
and everything computed so far on disk. Modules that need DOLFINx are imported by the commands that need them.
"""

from __future__ import annotations

import io
import os
import sys
import time
import traceback
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer
from rich.console import Console

from cosserat_fx.results import OutputError, RunFolder
from cosserat_fx.scene import Scene, SceneError, load_scene

if TYPE_CHECKING:
    from mpi4py import MPI

BAD_INPUT = 2
STOPPED = 3
BY_KEYBOARD = 130
_CALLS_SHOWN = 6

app = typer.Typer(
    help="Granular bodies against rough walls: hypoplastic Cosserat continua.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE.toml", help="The scene.")]
Overrides = Annotated[
    list[str], typer.Option("--set", metavar="KEY.PATH=VALUE", help="Replaces a key of the scene; may be repeated.")
]
_PASS_THROUGH = {"allow_extra_args": True, "ignore_unknown_options": True}


@app.command(context_settings=_PASS_THROUGH)
def run(
    context: typer.Context,
    scene: SceneFile,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The run's folder.")],
    overrides: Overrides = [],  # noqa: B006  # typer's way to say "any number of"
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replaces an earlier run in the folder.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Goes on with the scene's unfinished run there.")] = False,
) -> None:
    """Runs a scene. Options with a single dash, such as -snes_monitor, go to PETSc; works under mpirun."""
    options = _petsc_options(context.args)
    if overwrite and resume:
        _refuse("--resume: cannot be given along with --overwrite, which begins anew")
    loaded = _load(scene, overrides)
    _need_dolfinx()
    from cosserat_fx.run import run as run_scene

    console = _console()
    try:
        ledger = run_scene(loaded, out, overwrite=overwrite, resume=resume, console=console, options=options)
    except (OutputError, SceneError) as error:
        _refuse(str(error))
    except KeyboardInterrupt:  # where the run does not wait for it: while it is set up
        print("cosserat-fx: interrupted", file=sys.stderr)
        raise typer.Exit(BY_KEYBOARD) from None
    for warning in ledger.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if ledger.answer:
        console.print(f"answer: {ledger.answer}", highlight=False)
    if ledger.accuracy:
        console.print(ledger.accuracy, highlight=False)
    if ledger.reason:
        further = "; --resume goes on from there" if RunFolder(out).checkpoint.exists() else ""
        print(f"stopped early: {ledger.reason}. What was computed is in {out}{further}.", file=sys.stderr)
    else:
        console.print(
            f"done: {ledger.steps} steps, {ledger.iterations} Newton iterations, {ledger.cutbacks} cutbacks; see {out}",
            highlight=False,
        )
    raise typer.Exit(STOPPED if ledger.reason else 0)


@app.command()
def check(
    scene: SceneFile,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Validates a scene and prints its effects, sizes and expected cost, without running it."""
    loaded = _load(scene, overrides)
    _need_dolfinx()
    from cosserat_fx._compat import MPI
    from cosserat_fx.bodies import build
    from cosserat_fx.cost import expected_cost
    from cosserat_fx.effects import effects
    from cosserat_fx.form_cache import with_forms
    from cosserat_fx.kernel_time import kernel_shares
    from cosserat_fx.run import describe

    try:
        body = with_forms(MPI.COMM_WORLD, lambda: build(loaded, MPI.COMM_WORLD))
        listed = kernel_shares(effects(body), body)
        cost = expected_cost(body)
    except SceneError as error:
        _refuse(str(error))
    console = _console()
    console.print(describe(body, listed))
    console.print(str(cost), highlight=False)
    for warning in body.warnings:
        print(f"warning: {warning}", file=sys.stderr)


@app.command()
def study(
    scene: SceneFile,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The study's folder; what is there is kept.")],
    overrides: Overrides = [],  # noqa: B006
    quick: Annotated[bool, typer.Option("--quick", help="Tries little, and coarsely.")] = False,
    repeats: Annotated[int, typer.Option("--repeats", metavar="N", min=1, help="How often a run is timed.")] = 3,
) -> None:
    """Shows what accuracy costs in time: each knob of a scene is turned alone, then several together."""
    ranks = _ranks()
    if ranks is not None and ranks.size > 1:
        _refuse(f"study: times runs of one rank each and cannot be started on {ranks.size} ranks; leave out mpirun")
    _need_dolfinx()
    from cosserat_fx.studies.study import StudyError
    from cosserat_fx.studies.study import study as study_scene

    console = _console()
    try:
        study_scene(scene, out, overrides=overrides, quick=quick, repeats=repeats, console=console)
    except (OutputError, SceneError) as error:
        _refuse(str(error))
    except StudyError as error:
        print(f"stopped early: {error}", file=sys.stderr)
        raise typer.Exit(STOPPED) from None
    except KeyboardInterrupt:
        print("cosserat-fx: interrupted; the same command goes on", file=sys.stderr)
        raise typer.Exit(BY_KEYBOARD) from None
    console.print(f"done: see {out / 'study.md'} and {out / 'figures'}", highlight=False)


@app.command()
def plot(folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run.")]) -> None:
    """Draws the figures of a run again."""
    from cosserat_fx.plots import draw_all

    try:
        files = draw_all(folder)
    except OutputError as error:
        _refuse(str(error))
    for file in files:
        print(file)


@app.command()
def info() -> None:
    """Prints versions."""
    _need_dolfinx()
    from cosserat_fx.versions import versions

    for name, version in versions().items():
        print(f"{name:12} {version}")


def main() -> None:
    """Entry point of the console script. Of several ranks the first one speaks; what breaks one of them ends all."""
    ranks = _ranks()
    if ranks is None or ranks.size == 1:
        app()
        return
    from cosserat_fx.parallel import FailedAloneError, RollCall

    said = io.StringIO()
    with ExitStack() as silence:
        roll = silence.enter_context(RollCall(ranks))
        if ranks.rank > 0:
            silence.enter_context(redirect_stdout(silence.enter_context(Path(os.devnull).open("w"))))
            silence.enter_context(redirect_stderr(said))
        try:
            app()
        except SystemExit as end:
            if not end.code or roll.is_complete():
                raise
            _end_all(ranks, said.getvalue(), end.code if isinstance(end.code, int) else 1)
        except Exception as error:
            message = _internal_error(error, ranks.rank)
            if isinstance(error, FailedAloneError) or not roll.is_complete():
                _end_all(ranks, message, 1)
            if ranks.rank == 0:
                print(message, end="", file=sys.stderr)
            sys.exit(1)


def _end_all(ranks: MPI.Intracomm, message: str, status: int) -> NoReturn:
    """End all ranks, which would wait for this one for ever, after it has told why."""
    sys.stdout.flush()
    print(message, end="", file=sys.__stderr__, flush=True)
    time.sleep(0.3)  # for the launcher to pass it on, which Open MPI's does not any more afterwards
    ranks.Abort(status)
    os._exit(status)  # MPICH's launcher ends the ranks, but not at once


def _internal_error(error: Exception, rank: int) -> str:
    """The last calls that led to an exception, and one line that says what and where it was."""
    calls = "".join(traceback.format_exception(error, limit=-_CALLS_SHOWN))
    cause = error.__cause__ or error
    return f"{calls}cosserat-fx: internal error on rank {rank}: {type(cause).__name__}: {cause}\n"


def _load(file: Path, overrides: list[str]) -> Scene:
    try:
        return load_scene(file, overrides)
    except SceneError as error:
        _refuse(str(error))


def _petsc_options(arguments: list[str]) -> dict[str, str]:
    """Options for PETSc from what is left of the command line: ``-name`` or ``-name value``."""
    options: dict[str, str] = {}
    name = ""
    for argument in arguments:
        if argument.startswith("--"):
            _refuse(f"{argument}: unknown option; options for PETSc have a single dash")
        if argument.startswith("-") and not _is_number(argument):
            name = argument[1:]
            options[name] = ""
        elif name and not options[name]:
            options[name] = argument
        else:
            _refuse(f"{argument}: unexpected argument; a run takes one scene")
    return options


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _need_dolfinx() -> None:
    try:
        import cosserat_fx._compat  # noqa: F401
    except ImportError as error:
        _refuse(str(error))


def _console() -> Console:
    """The terminal, or a log file, in which lines are plain and left as long as they are.

    Under mpirun it is taken for a log file: Open MPI puts a terminal between its ranks and a pipe.
    """
    ranks = _ranks()
    console = Console(force_terminal=None if ranks is None or ranks.size == 1 else False)
    if not console.is_terminal:
        console.width = 160
    return console


def _refuse(message: str) -> NoReturn:
    """Print one message and leave with the status of bad input."""
    print(f"cosserat-fx: {message}", file=sys.stderr)
    raise typer.Exit(BAD_INPUT)


def _ranks() -> MPI.Intracomm | None:
    """All ranks, or None where DOLFINx, and MPI with it, may not be installed."""
    try:
        from mpi4py import MPI
    except ImportError:
        return None
    return MPI.COMM_WORLD
