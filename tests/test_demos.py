"""The demos run as they are, and give the numbers that they stand for."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from layers import DEMOS, HEIGHT, REQUESTED, WALLS, converged, demo

from cosserat_fx.results import Run, read_run

TIMEOUT = 300  # s, the first compilation of the kernel included
PROGRAM = "from cosserat_fx.cli import main; main()"

# Where the middle of the band is, over the height.
CENTRE = {"very_rough": 0.5, "medium_rough": 0.951}


def execute(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT)


def test_every_demo_is_tested_here() -> None:
    known = {f"layer_{wall}.toml" for wall in WALLS} | {"layer_from_python.py"}
    assert {path.name for path in DEMOS.iterdir() if path.suffix in (".toml", ".py")} == known


@pytest.mark.parametrize("wall", WALLS)
def test_a_scene_runs_from_file_to_figures(wall: str, tmp_path: Path) -> None:
    out = tmp_path / "run"
    process = execute("-c", PROGRAM, "run", demo(wall), "--out", out)
    assert (process.returncode, process.stderr) == (0, "")
    run = read_run(out)
    assert run.summary["status"] == "done"
    friction, band = run.summary["friction"], run.summary["band"]
    assert friction["refined_peak_shear_stress_Pa"] == pytest.approx(converged(wall, "peak"), rel=0.002)
    assert friction["residual_shear_stress_Pa"] == pytest.approx(converged(wall, "residual"), rel=0.002)
    assert band["centre_m"] / HEIGHT == pytest.approx(CENTRE[wall], abs=0.01)
    assert [block["top_displacement_m"][0] for block in run.profile_blocks()] == list(REQUESTED)
    for name in ("history.png", "profiles.png", "layer.png"):
        assert (out / "figures" / name).read_bytes().startswith(b"\x89PNG")
    assert len(list((out / "fields").glob("*.vtu"))) == 1 + len(REQUESTED)
    seconds = run.summary["seconds"]
    assert sum(part for phase, part in seconds.items() if phase != "whole run") <= seconds["whole run"]


def test_the_python_demo_walks_the_medium_rough_layer_step_by_step(default_runs: dict[str, Run]) -> None:
    """It builds by hand what the scene file describes; only one profile fewer is asked for on the way."""
    process = execute(DEMOS / "layer_from_python.py")
    assert (process.returncode, process.stderr) == (0, "")
    number = r"([-+.\d]+)"
    line = rf"step +(\d+): u1 = +{number} mm, s12 = +{number} kPa, height {number} mm, (\d+) iterations"
    matches = [re.fullmatch(line, told) for told in process.stdout.splitlines()]
    table = np.array([match.groups() for match in matches if match], dtype=float)
    assert len(table) == len(matches) <= 45
    scene = default_runs["medium_rough"]
    travel, stress, rise = table[:, 1], table[:, 2], table[:, 3]
    assert {10.0, 20.0, 30.0} <= set(travel)
    assert 1e3 * stress.max() == pytest.approx(scene.summary["friction"]["peak_shear_stress_Pa"], rel=1e-3)
    assert 1e3 * stress[-1] == pytest.approx(scene.summary["friction"]["residual_shear_stress_Pa"], rel=1e-3)
    assert 1e-3 * rise[-1] == pytest.approx(scene.history["height_change_m"][-1], rel=5e-3)
    assert table[:, 4].sum() <= 220
