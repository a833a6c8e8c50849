"""The performance benchmarks run, on the smallest meshes, and leave what the documentation is made of."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest
from ranks import ENVIRONMENT, TIMEOUT

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
INSTALLED = importlib.util.find_spec("dolfinx_external_operator") is not None


def run(name: str, out: Path) -> str:
    """What a benchmark prints."""
    command = [sys.executable, str(BENCHMARKS / f"{name}.py"), "--quick", "--out", str(out)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=TIMEOUT)
    assert done.returncode == 0, done.stderr
    return done.stdout


def figures(name: str, out: Path) -> dict[str, object]:
    """What a benchmark measured; it left a table too."""
    assert "| ---" in (out / f"{name}.md").read_text()
    found: dict[str, object] = json.loads((out / f"{name}.json").read_text())
    assert found["machine"]
    return found


@pytest.mark.parametrize("name", ["newton_floor", "ranks", "growth", "effects_price"])
def test_benchmarks_leave_figures_table_and_picture(name: str, tmp_path: Path) -> None:
    run(name, tmp_path)
    figures(name, tmp_path)
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000


@pytest.mark.parametrize("name", ["overhead", "prediction"])
def test_benchmarks_without_a_picture(name: str, tmp_path: Path) -> None:
    run(name, tmp_path)
    figures(name, tmp_path)


def test_the_two_programs_of_the_update_agree(tmp_path: Path) -> None:
    """The kernel's answers are those of the C program, in stress and tangent, to rounding."""
    run("kernel_speed", tmp_path)
    found = figures("kernel_speed", tmp_path)["runs"]
    assert isinstance(found, dict)
    differences = [run["difference"] for run in found.values()]
    assert all(0 < part < 1e-10 for difference in differences for part in difference.values())


def test_the_law_behind_an_external_operator_gives_the_same_solution(tmp_path: Path) -> None:
    """Where the package is not installed, the benchmark says how to install it and leaves nothing."""
    said = run("external_operator", tmp_path)
    if not INSTALLED:
        assert "pip install --no-deps dolfinx-external-operator" in said
        assert not list(tmp_path.iterdir())
        return
    difference = figures("external_operator", tmp_path)["difference_of_solutions"]
    assert isinstance(difference, float)
    assert difference < 1e-12
