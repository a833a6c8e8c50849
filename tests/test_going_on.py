"""Who may write to a run's folder and go on in it; solvers that fail for a while; clocks that jump."""

import itertools
import json
import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from console import BAD_INPUT, DONE, STOPPED, Call
from faults import PLAIN, SLOWLY, arguments, assert_nothing_lost, rows, started, wait_for_row

from cosserat_fx._compat import PETSc
from cosserat_fx.newton import NewtonSolver
from cosserat_fx.problem import Problem
from cosserat_fx.results import read_run

ANEW = "--overwrite"


def contents(folder: Path) -> dict[str, tuple[bytes, int]]:
    """All files with the times of their last changes."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    return {str(file): (file.read_bytes(), file.stat().st_mtime_ns) for file in files}


# -- two runs on one folder --------------------------------------------------------------------------------------------


def test_a_folder_takes_one_run_at_a_time(tmp_path: Path, call: Call, undisturbed: Path) -> None:
    """The second is refused while the first goes on; when the first has been killed, the folder is free."""
    folder = tmp_path / "run"
    with started(folder, before=SLOWLY) as process:
        wait_for_row(process, folder, 2)
        for second in (arguments(folder), [*arguments(folder)[:-1], ANEW]):
            outcome = call(*second)
            assert outcome.status == BAD_INPUT
            assert outcome.err == f"cosserat-fx: output folder {folder}: another run is writing to it\n"
        row = rows(folder)
        wait_for_row(process, folder, row + 2)
        assert process.poll() is None
        assert row >= 2
    assert call(*arguments(folder)).status == DONE
    assert_nothing_lost(folder, undisturbed)


# -- what is in the folder ---------------------------------------------------------------------------------------------


def test_a_run_that_is_done_stays_as_it_is(tmp_path: Path, call: Call, undisturbed: Path) -> None:
    folder = tmp_path / "run"
    assert call(*arguments(folder)).status == DONE
    before = contents(folder)
    outcome = call(*arguments(folder))
    assert (outcome.status, outcome.err) == (DONE, "")
    assert contents(folder) == before
    assert_nothing_lost(folder, undisturbed)


def test_an_empty_folder_takes_a_run(tmp_path: Path, call: Call, undisturbed: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    assert call(*arguments(folder)).status == DONE
    assert_nothing_lost(folder, undisturbed)


@pytest.mark.parametrize("done", [True, False], ids=["done", "unfinished"])
def test_a_run_of_another_scene_is_left_alone(done: bool, tmp_path: Path, call: Call) -> None:
    folder = tmp_path / "run"
    status, keys = (DONE, PLAIN) if done else (STOPPED, (*PLAIN, "stepping.max_steps=4"))
    assert call(*arguments(folder, *keys)).status == status
    before = contents(folder)
    outcome = call(*arguments(folder, *PLAIN, "initial.void_ratio=0.61"))
    assert outcome.status == BAD_INPUT
    assert outcome.err.startswith("cosserat-fx: ")
    assert "another scene" in outcome.err
    assert outcome.err.count("\n") == 1
    assert contents(folder) == before


def test_beginning_anew_is_not_going_on(tmp_path: Path, call: Call) -> None:
    outcome = call(*arguments(tmp_path / "run"), ANEW)
    assert outcome.status == BAD_INPUT
    assert outcome.err.startswith("cosserat-fx: --resume: ")
    assert list(tmp_path.iterdir()) == []


# -- solvers -----------------------------------------------------------------------------------------------------------

type Sabotage = Callable[[NewtonSolver], None]


def starve(solver: NewtonSolver) -> None:
    """One iteration of a linear solver that does nothing."""
    ksp = solver.snes.getKSP()
    ksp.setType("richardson")
    ksp.getPC().setType("none")
    ksp.setTolerances(rtol=1e-12, max_it=1)


def discourage(solver: NewtonSolver) -> None:
    """SNES gives up at once."""
    solver.snes.setConvergenceTest(lambda *_: PETSc.SNES.ConvergedReason.DIVERGED_DTOL)


def blind(solver: NewtonSolver) -> None:
    """MUMPS is given a matrix without entries."""
    problem, assemble = solver._problem, solver._problem.assemble_jacobian

    def assemble_nothing() -> None:
        assemble()
        problem.matrix.zeroEntries()

    problem.assemble_jacobian = assemble_nothing  # type: ignore[method-assign]


@pytest.mark.parametrize("sabotage", [starve, discourage, blind])
def test_solvers_that_fail_end_a_run_that_goes_on(
    sabotage: Sabotage, tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch, undisturbed: Path
) -> None:
    """From the seventh step on nothing can be solved any more; another try has no such trouble."""
    folder = tmp_path / "run"
    with monkeypatch.context() as patch:
        solve, commits = NewtonSolver.solve, itertools.count(1)
        commit = Problem.commit

        def commit_and_count(problem: Problem) -> None:
            commit(problem)
            problem.broken = next(commits) >= 6  # type: ignore[attr-defined]

        def solve_or_not(solver: NewtonSolver) -> Any:
            if getattr(solver._problem, "broken", False):
                solver._problem.broken = False  # type: ignore[attr-defined]
                sabotage(solver)
            return solve(solver)

        patch.setattr(Problem, "commit", commit_and_count)
        patch.setattr(NewtonSolver, "solve", solve_or_not)
        outcome = call(*arguments(folder))
    assert outcome.status == STOPPED, outcome.err
    assert outcome.err.startswith("stopped early: the step from ")
    assert outcome.err.count("\n") == 1
    assert rows(folder) == 6
    assert call(*arguments(folder)).status == DONE
    assert_nothing_lost(folder, undisturbed)
    assert read_run(folder).summary["resumed_after_steps"] == [6]


# -- clocks ------------------------------------------------------------------------------------------------------------


def test_a_clock_that_jumps(tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch, undisturbed: Path) -> None:
    """By years, to and fro: nothing that a run decides or tells depends on the time of day."""
    dice = random.Random(1)
    start, seconds, year = time.perf_counter(), time.time, 365.25 * 86400
    monkeypatch.setattr(time, "time", lambda: seconds() + year * dice.uniform(-30, 30))
    monkeypatch.setattr(time, "time_ns", lambda: int(1e9 * time.time()))
    folder = tmp_path / "run"
    outcome = call(*arguments(folder, *PLAIN[:-2], "output.checkpoints=1e-9", PLAIN[-1]))
    assert (outcome.status, outcome.err) == (DONE, "")
    assert_nothing_lost(folder, undisturbed)
    summary = read_run(folder).summary
    assert summary["calls"]["checkpoints"] == summary["steps"]
    phases = summary["seconds"]
    assert min(phases.values()) >= 0
    assert sum(phases.values()) - phases["whole run"] <= phases["whole run"] < time.perf_counter() - start
    assert json.loads((folder / "run.json").read_text()) == summary
