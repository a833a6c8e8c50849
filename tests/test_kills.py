"""SIGKILL, after which nothing can be tidied up: whenever it comes, the run goes on and leaves what it would have."""

import random
import signal
import time
from pathlib import Path

from faults import SLOWLY, SMALL, assert_nothing_lost, launch, started, wait_for_row

from cosserat_fx.results import read_run

FOLDER = "cosserat_fx.output.folder:RunFolder"
PLACES = {
    "before the first summary takes its place": "on_call('os:replace', 1, send(9), given='run.json')",
    "between field and list of fields": "on_call('os:replace', 1, send(9), given='layer.pvd')",
    "between its records and the disk": "on_call('cosserat_fx.checkpoints.file:_told', 2, send(9), after=True)",
    "between both names of a checkpoint": "on_call('os:replace', 1, send(9), after=True, given='previous')",
    "between figures": "on_call('cosserat_fx.plots:draw_profiles', 1, send(9))",
    "before the checkpoints are removed": f"on_call('{FOLDER}.remove_checkpoints', 1, send(9))",
}
"""Moments that are too short to be met by chance, in the order in which a run comes to them."""


def test_at_random_moments(tmp_path: Path, undisturbed: Path) -> None:
    """One kill while the program starts, and three while it makes steps."""
    dice, folder, killed = random.Random(4), tmp_path / "run", 0
    for moment in range(4):
        with started(folder, before=SLOWLY) as process:
            if moment:
                wait_for_row(process, folder, 4 * moment - 3)
            time.sleep(dice.uniform(0.0, 0.4))
            process.kill()
            killed += process.wait() == -signal.SIGKILL
    assert launch(folder).returncode == 0
    assert_nothing_lost(folder, undisturbed)
    assert killed > 2
    assert read_run(folder).summary["resumed_after_steps"]


def test_at_the_worst_moments(tmp_path: Path, undisturbed: Path) -> None:
    """One run is killed at each of them in turn."""
    folder = tmp_path / "run"
    for place, fault in PLACES.items():
        process = launch(folder, *SMALL, before=fault)
        assert process.returncode == -signal.SIGKILL, f"{place}: {process.stderr}"
    process = launch(folder, *SMALL)
    assert process.returncode == 0, process.stderr
    assert_nothing_lost(folder, undisturbed, figures=True)


def test_without_a_checkpoint_the_run_begins_again(tmp_path: Path, undisturbed: Path) -> None:
    """The rows of the run that was killed do not stay, and the figures that it could not draw are made."""
    keys = [*SMALL[:-1], "output.checkpoints='off'"]
    folder = tmp_path / "run"
    process = launch(folder, *keys, before="on_call('cosserat_fx.recorder:Recorder._draw', 1, send(9))")
    assert process.returncode == -signal.SIGKILL, process.stderr
    process = launch(folder, *keys)
    assert process.returncode == 0, process.stderr
    assert_nothing_lost(folder, undisturbed, figures=True)
    assert read_run(folder).summary["resumed_after_steps"] == []
