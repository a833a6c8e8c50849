"""Runs with a fault built in, started as users start them, and what has to be true of a run that went through some."""

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from console import settings
from layers import demo
from ranks import ENVIRONMENT, TIMEOUT, mpiexec

from cosserat_fx.results import read_run

PROGRAM = "from cosserat_fx.cli import main; main()"
FIGURES = {"history.png", "profiles.png", "layer.png"}
SMALL = (
    "geometry.cells=20",
    "walls.top.shear_displacement=0.004",
    "output.profiles_at=[0.001, 0.002, 0.003, 0.004]",
    "output.fields=true",
    "output.checkpoints=0",
)
"""Some twenty steps over a peak, with profiles and fields on the way, and a checkpoint after each of them."""
PLAIN = (*SMALL, "output.figures=false")

ON_CALL = """
import importlib, os, signal, time
ALL = 0
def on_call(name, number, fault, *, after=False, rank=0, given=""):
    "Let something happen on a rank before, or after, one call or all of a function that is given something."
    module, _, path = name.partition(":")
    *owners, last = path.split(".")
    owner = importlib.import_module(module)
    for one in owners:
        owner = getattr(owner, one)
    from mpi4py import MPI
    if MPI.COMM_WORLD.rank != rank:
        return
    plain, calls = getattr(owner, last), [0]
    def faulty(*arguments, **named):
        calls[0] += given in str(arguments)
        meant = number in (ALL, calls[0]) and given in str(arguments)
        if meant and not after:
            fault()
        result = plain(*arguments, **named)
        if meant and after:
            fault()
        return result
    setattr(owner, last, faulty)
def send(number):
    return lambda: os.kill(os.getpid(), number)
def throw(error):
    def fault():
        raise error
    return fault
"""
"""Helpers for what a run is to suffer; put before it."""


SLOWLY = "on_call('cosserat_fx.recorder:Recorder.record', ALL, lambda: time.sleep(0.1))"
"""Leaves time to do something to a run between its steps."""


def command(*arguments: object, ranks: int = 1, before: str = "") -> list[str]:
    """The program with arguments, after some other code; several ranks are started by a launcher."""
    launcher = [mpiexec(), "-n", str(ranks)] if ranks > 1 else []
    return [*launcher, sys.executable, "-c", f"{ON_CALL}{before}\n{PROGRAM}", *map(str, arguments)]


def arguments(folder: Path, *overrides: str) -> list[object]:
    """Those of a run of the small layer; it goes on where there is something to go on from."""
    return ["run", demo("medium_rough"), "--out", folder, *settings(*(overrides or PLAIN)), "--resume"]


def launch(
    folder: Path, *overrides: str, ranks: int = 1, before: str = "", within: Sequence[str] = ()
) -> subprocess.CompletedProcess[str]:
    """Runs the small layer to its end, whichever that is; ranks that wait for each other fail the test by the clock.

    Args:
        folder: of the run.
        overrides: keys of the scene; PLAIN without any.
        ranks: processes.
        before: what to do before the program begins.
        within: a command that runs another one, its arguments.
    """
    line = [*within, *command(*arguments(folder, *overrides), ranks=ranks, before=before)]
    return subprocess.run(line, env=ENVIRONMENT, capture_output=True, text=True, timeout=TIMEOUT)


@contextmanager
def started(folder: Path, *overrides: str, ranks: int = 1, before: str = "") -> Iterator[subprocess.Popen[str]]:
    """A run of the small layer that goes on while the test does something to it, and is killed at last."""
    line = command(*arguments(folder, *overrides), ranks=ranks, before=before)
    with subprocess.Popen(line, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def rows(folder: Path) -> int:
    """Steps that are in the history."""
    history = folder / "history.csv"
    return max(history.read_text().count("\n") - 1, 0) if history.exists() else 0


def wait_for_row(process: subprocess.Popen[str], folder: Path, row: int) -> None:
    """Wait until a run has so many rows, or is over."""
    while process.poll() is None and rows(folder) < row:
        time.sleep(0.01)


def assert_nothing_lost(folder: Path, undisturbed: Path, figures: bool = False) -> None:
    """A run that went through faults has left what it would have left without them, to the byte."""
    summary, wanted = read_run(folder).summary, read_run(undisturbed).summary
    assert (summary["status"], summary["reason"]) == ("done", None)
    for table in ("history.csv", "profiles.csv"):
        assert (folder / table).read_bytes() == (undisturbed / table).read_bytes(), table
    for key in ("scene_sha256", "steps", "newton_iterations", "cutbacks", "warnings", "band", "friction"):
        assert summary[key] == wanted[key], key
    assert _series(folder) == _series(undisturbed)
    for name in ("fields", *["figures"] * figures):
        assert all(file.stat().st_size for file in (folder / name).iterdir())
    names = {"history.csv", "profiles.csv", "run.json", "fields", *["figures"] * figures}
    assert {file.name for file in folder.iterdir()} == names
    if figures:
        drawn = {file.name: file.read_bytes() for file in (folder / "figures").iterdir()}
        assert set(drawn) == FIGURES
        assert all(b"IEND" in data[-12:] for data in drawn.values())


def _series(folder: Path) -> dict[str, Any]:
    """What ParaView is shown: the list of files and each of them, and nothing beside them."""
    files = {file.name: file.read_bytes() for file in (folder / "fields").iterdir()}
    entries = [dict(entry.attrib) for entry in ElementTree.fromstring(files["layer.pvd"]).iter("DataSet")]
    assert {"layer.pvd", *(entry["file"] for entry in entries)} == set(files)
    return {"entries": entries, **files}
