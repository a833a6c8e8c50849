"""Under mpirun: the same answer on any number of ranks, one voice, and an end for all when one fails."""

import re
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
from console import settings
from layers import D50, HEIGHT, NOTHING_TO_LOOK_AT, demo, difference, walk
from ranks import ENVIRONMENT, TIMEOUT, mpiexec

from cosserat_fx._compat import MPI
from cosserat_fx.parallel import on_first_rank
from cosserat_fx.results import OutputError, Run, read_run

PROGRAM = "from cosserat_fx.cli import main; main()"
SHORT = ["walls.top.shear_displacement=0.002", "output.profiles_at=[0.001, 0.002]"]


def launch(ranks: int, *arguments: object, before: str = "") -> subprocess.CompletedProcess[str]:
    """Runs the program on several ranks, after some other code."""
    command = [mpiexec(), "-n", str(ranks), sys.executable, "-c", f"{before}\n{PROGRAM}", *map(str, arguments)]
    return subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=TIMEOUT)


def quietly(*overrides: str) -> list[str]:
    return settings(*NOTHING_TO_LOOK_AT, *overrides)


def assert_equal(one: Run, several: Run, ranks: int) -> None:
    """Everything that both have written agrees to 1e-8 of its largest value."""
    assert (one.summary["ranks"], several.summary["ranks"]) == (1, ranks)
    for key in ("status", "steps", "newton_iterations", "cutbacks", "warnings", "sizes"):
        assert one.summary[key] == several.summary[key]
    for here, there in ((one.history, several.history), (one.profiles, several.profiles)):
        for name, column in here.items():
            assert difference(column, there[name]) < 1e-8, name
    for key, value in one.summary["band"].items():
        assert several.summary["band"][key] == (pytest.approx(value, rel=1e-8) if isinstance(value, float) else value)


def test_two_ranks_give_the_answer_of_one(tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """The whole scene of the demo: forty steps, a peak, and a band that forms across the ranks' border."""
    out = tmp_path / "run"
    process = launch(2, "run", demo("very_rough"), "--out", out, *quietly())
    assert process.returncode == 0, process.stderr
    assert_equal(default_runs["very_rough"], read_run(out), 2)
    assert "\x1b" not in process.stdout
    assert len(re.findall("^done: ", process.stdout, re.MULTILINE)) == 1
    assert len(re.findall(r"^polar +on\b.*\bdefault", process.stdout, re.MULTILINE)) == 1


def test_three_ranks_give_the_answer_of_one_with_fields_and_figures(tmp_path: Path) -> None:
    """Up to the peak under the medium rough wall; what is gathered from the ranks is written and drawn."""
    out = tmp_path / "three"
    drawn = ("output.figures=true", "output.fields=true")
    process = launch(3, "run", demo("medium_rough"), "--out", out, *quietly(*SHORT, *drawn))
    assert process.returncode == 0, process.stderr
    one = walk(tmp_path / "one", "medium_rough", *SHORT, "output.fields=true")
    assert_equal(one, read_run(out), 3)
    assert {file.name for file in (out / "figures").iterdir()} == {"history.png", "profiles.png", "layer.png"}
    for file in (tmp_path / "one" / "fields").glob("*.vtu"):
        here, there = meshio.read(file), meshio.read(out / "fields" / file.name)
        assert difference(here.points, there.points) < 1e-12
        assert difference(here.point_data["rotation"], there.point_data["rotation"]) < 1e-8
        assert difference(here.cell_data["void_ratio"][0], there.cell_data["void_ratio"][0]) < 1e-8


def test_more_ranks_than_cells_are_no_harm(tmp_path: Path) -> None:
    """A rank without a single cell takes part all the same."""
    little = ("geometry.cells=1", "walls.top.shear_displacement=2e-4", "output.profiles_at=[2e-4]")
    process = launch(2, "run", demo("very_rough"), "--out", tmp_path / "two", *quietly(*little))
    assert process.returncode == 0, process.stderr
    assert_equal(walk(tmp_path / "one", "very_rough", *little), read_run(tmp_path / "two"), 2)


def test_points_that_fail_on_one_rank_stop_all_of_them(tmp_path: Path) -> None:
    """The grains at the top fail, which one of the two ranks has: both cut back, both stop, one tells."""
    wild = ("walls.top.rolling=20.0", "stepping.min_step=1e-5")
    process = launch(2, "run", demo("medium_rough"), "--out", tmp_path / "two", *quietly(*wild))
    assert process.returncode == 3, process.stderr
    one, two = walk(tmp_path / "one", "medium_rough", *wild), read_run(tmp_path / "two")
    (step, cause), (other_step, other_cause) = (it.summary["reason"].split(": ") for it in (one, two))
    assert step == other_step
    for told in (cause, other_cause):  # rounding decides how the last iteration leaves the law, in which of two cells
        assert float(told.rpartition(" at ")[2].removesuffix(" m")) > HEIGHT - 2 * D50
    assert len(re.findall("^stopped early: ", process.stderr, re.MULTILINE)) == 1
    assert two.summary["steps"] == one.summary["steps"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "nowhere.toml", "--out", "run"], "cosserat-fx: nowhere.toml: cannot be read as a scene file"),
        (["run", demo("medium_rough"), "--out", "."], "holds something other than a run"),
        (["run", demo("medium_rough")], "--out"),
    ],
)
def test_bad_input_is_told_once_and_ends_all_ranks(
    arguments: list[object], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bystander").write_text("stays")
    monkeypatch.chdir(tmp_path)
    process = launch(2, *arguments)
    assert process.returncode == 2
    assert process.stderr.count(message) == 1
    assert "Traceback" not in process.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["bystander"]


def test_an_error_nobody_foresaw_on_one_rank_ends_all_ranks(tmp_path: Path) -> None:
    """Without it being told the first rank would wait for the other one's part for ever."""
    sabotage = """
from cosserat_fx._compat import MPI
from cosserat_fx.output.layer_observation import LayerObserver
def broken(self, step):
    raise ZeroDivisionError("on the second rank")
if MPI.COMM_WORLD.rank == 1:
    LayerObserver.row = broken
"""
    process = launch(
        2,
        "run",
        demo("medium_rough"),
        "--out",
        tmp_path / "run",
        *quietly(*SHORT),
        before=sabotage,
    )
    assert process.returncode not in (0, 2, 3)
    told = "cosserat-fx: internal error on rank 1: ZeroDivisionError: on the second rank"
    assert process.stderr.splitlines().count(told) == 1


def test_work_of_the_first_rank_is_shared_whatever_comes_of_it() -> None:
    assert on_first_rank(MPI.COMM_SELF, lambda: {"a": np.arange(3).tolist()}) == {"a": [0, 1, 2]}

    def refuse() -> None:
        raise OutputError("no room")

    with pytest.raises(OutputError, match="no room"):
        on_first_rank(MPI.COMM_SELF, refuse)
