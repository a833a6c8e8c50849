"""Signals that ask a run to stop: to the program itself, and to the launcher of several ranks."""

import re
import signal
from pathlib import Path

from faults import SLOWLY, assert_nothing_lost, launch, started, wait_for_row

from cosserat_fx._compat import MPI
from cosserat_fx.interruption import SIGNALS
from cosserat_fx.results import read_run

RECORD = "cosserat_fx.recorder:Recorder.record"
LAUNCHER_WAITS = MPI.Get_library_version().startswith("MPICH")
"""Open MPI's launcher passes on SIGUSR1 as well, but kills its ranks soon after SIGTERM and SIGINT."""


def test_a_run_stops_and_goes_on(tmp_path: Path, undisturbed: Path) -> None:
    """Each of the signals stops it once; each comes twice, as those do that scheduler and launcher both send."""
    folder = tmp_path / "run"
    for number in SIGNALS:
        twice = f"on_call('{RECORD}', 4, lambda: (send({number})(), send({number})()))"
        process = launch(folder, before=twice)
        assert process.returncode == 3, process.stderr
        assert re.fullmatch(rf"stopped early: interrupted by {number.name}\. .*--resume .*\n", process.stderr)
        summary = read_run(folder).summary
        assert (summary["status"], summary["reason"]) == ("stopped", f"interrupted by {number.name}")
    process = launch(folder)
    assert (process.returncode, process.stderr) == (0, "")
    assert_nothing_lost(folder, undisturbed)
    assert read_run(folder).summary["resumed_after_steps"] == [4, 8, 12]


def test_a_second_signal_ends_the_process(tmp_path: Path) -> None:
    wait = "time.sleep(1.1)"
    process = launch(
        tmp_path / "run", before=f"on_call('{RECORD}', 4, lambda: (send(15)(), {wait}, send(15)(), {wait}))"
    )
    assert process.returncode == -signal.SIGTERM
    assert process.stderr == ""


def test_launchers_pass_on_signals(tmp_path: Path, undisturbed_on_two: Path) -> None:
    """Whatever the launcher makes of a signal, the run goes on afterwards."""
    folder = tmp_path / "run"
    for turn, number in enumerate((signal.SIGUSR1, signal.SIGTERM), 1):
        with started(folder, ranks=2, before=SLOWLY) as process:
            wait_for_row(process, folder, 4 * turn)
            process.send_signal(number)
            told = process.communicate()[1]
        if LAUNCHER_WAITS or number == signal.SIGUSR1:
            assert process.returncode == 3, told
            assert told.count(f"stopped early: interrupted by {number.name}. ") == 1
        else:
            assert process.returncode != 0
    last = launch(folder, ranks=2)
    assert last.returncode == 0, last.stderr
    assert_nothing_lost(folder, undisturbed_on_two)
