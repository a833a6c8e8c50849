"""Steps in which a body moves to an equilibrium that is not near the last one: how they are told, and for how long."""

import re
from pathlib import Path

import pytest
from console import DONE, STOPPED, Call, settings

from cosserat_fx.results import Run, read_run

SCENE = """
[geometry]
kind = "layer"
height = 0.004
cells = 80
[material]
constants = "paper-sand"
phi_c = 45.0
a_c = 0.5
[initial]
stress = -10.0
void_ratio = 0.5125
[walls.top]
normal_stress = -10.0
shear_displacement = 4e-5
[output]
figures = false
fields = false
checkpoints = 0
"""
"""Very dense sand under hardly any pressure, whose path of equilibria turns back behind the peak."""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    file = tmp_path / "scene.toml"
    file.write_text(SCENE)
    return file


def assert_told_once(run: Run) -> None:
    """The total is that of the history, and the first jump's place is in the one warning on jumps."""
    jumps = run.history["jumps"]
    assert set(jumps) == {0, 1}
    assert run.summary["jumps"] == jumps.sum()
    first = run.history["top_displacement_m"][jumps > 0][0]
    told = [warning for warning in run.summary["warnings"] if "let move to another" in warning]
    assert len(told) == 1
    assert told[0].startswith(f"at a travel of {first:.6g} m there was no equilibrium near the last one")


def test_jumps_are_marked_counted_and_told_and_outlive_a_stop(scene: Path, tmp_path: Path, call: Call) -> None:
    """Stopped after the step with the first jump, and gone on with: the same rows, total and warning."""
    whole, parted = tmp_path / "whole", tmp_path / "parted"
    assert call("run", scene, "--out", whole).status == DONE
    assert_told_once(read_run(whole))
    history = read_run(whole).history
    after = int(history["step"][history["jumps"] > 0][0])
    assert call("run", scene, "--out", parted, *settings(f"stepping.max_steps={after}")).status == STOPPED
    assert_told_once(read_run(parted))
    assert read_run(parted).summary["jumps"] == 1
    assert call("run", scene, "--out", parted, "--resume").status == DONE
    assert_told_once(read_run(parted))
    assert (parted / "history.csv").read_bytes() == (whole / "history.csv").read_bytes()
    assert call("run", scene, "--out", parted, "--resume").status == DONE  # there is nothing left to do
    assert_told_once(read_run(parted))


def test_a_run_that_never_jumps_says_so(undisturbed: Path) -> None:
    run = read_run(undisturbed)
    assert set(run.history["jumps"]) == {0}
    assert run.summary["jumps"] == 0
    assert not any("let move to another" in warning for warning in run.summary["warnings"])


def test_a_body_that_jumps_too_often_ends_the_run_with_the_place(scene: Path, tmp_path: Path, call: Call) -> None:
    """And goes on where more jumps are allowed."""
    out = tmp_path / "run"
    assert call("run", scene, "--out", out, *settings("stepping.max_jumps=0")).status == STOPPED
    stopped = read_run(out)
    assert stopped.history["jumps"].tolist()[-2:] == [0, 1]
    reason = stopped.summary["reason"]
    assert "stick and slip" in reason
    assert "more often than stepping.max_jumps = 0" in reason
    [place] = re.findall(r"mostly at (\S+) m", reason)
    assert 0 < float(place) < 0.004
    assert call("run", scene, "--out", out, "--resume").status == DONE
    assert read_run(out).summary["jumps"] == 1
