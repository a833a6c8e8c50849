"""The command study: a small one from its scene to its figures, gone on with, and what it refuses.

Most runs are made in this process, which spares their start; a few are the processes that a user's study starts.
"""

import json
import os
import re
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from console import BAD_INPUT, DONE, STOPPED, Call, assert_refused, listing, settings
from layers import DEMOS, demo
from typer.testing import CliRunner

from cosserat_fx import cli
from cosserat_fx.results import read_run
from cosserat_fx.run import run
from cosserat_fx.scene import load_scene
from cosserat_fx.studies import plan, runs, study
from cosserat_fx.studies.plan import Sizes
from cosserat_fx.studies.quantities import measure, quantities
from cosserat_fx.studies.runs import Runs

SMALL = (
    "geometry.cells=8",
    "walls.top.shear_displacement=2e-3",  # 5 % of the height, a finite strain
    "output.profiles_at=[1e-3, 2e-3]",
)
TINY = Sizes(
    cells=(2.0,),
    steps=(0.5,),
    local=(0.1,),
    together_cells=(1.0, 2.0),
    together_steps=(1.0, 0.5),
    together_local=(1.0,),
    diagonal=(),
    fine_cells=(1.0, 2.0, 4.0),
    fine_steps=(1.0, 0.5, 0.25),
    corner=(1.0, 0.5),
    tight=0.1,
)
INTERRUPTED = 130


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan, "QUICK", TINY)


class InThisProcess:
    """Makes runs without a process of their own.

    Attributes:
        made: their command lines.
        most: after so many the user interrupts.
    """

    def __init__(self) -> None:
        self.made: list[Sequence[str]] = []
        self.most = 1000

    def __call__(self, command: Sequence[str], patience: float | None) -> runs._Outcome:
        if len(self.made) == self.most:
            raise KeyboardInterrupt
        self.made.append(command)
        result = CliRunner().invoke(cli.app, command[4:], catch_exceptions=False)
        words = result.output.splitlines()[-1].removeprefix("cosserat-fx: ") if result.exit_code else ""
        return runs._Outcome(result.exit_code, 1.0, 0.5, words, None)

    @property
    def names(self) -> list[str]:
        """Those of the runs that were made to be looked at."""
        names = [Path(command[command.index("--out") + 1]).name for command in self.made]
        return [name for name in names if name != runs.WARM_UP]


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> InThisProcess:
    runner = InThisProcess()
    monkeypatch.setattr(runs, "_once", runner)
    return runner


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study that came to its end."""
    out = tmp_path_factory.mktemp("finished") / "study"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "QUICK", TINY)
        patch.setattr(runs, "_once", InThisProcess())
        study.study(demo("very_rough"), out, overrides=SMALL, quick=True, repeats=2)
    return out


def study_of(out: Path, *overrides: str, wall: str = "very_rough", repeats: int = 1) -> list[object]:
    quickly = ["--quick", "--repeats", repeats]
    return ["study", demo(wall), "--out", out, *quickly, *settings(*SMALL, *overrides)]


def summary_of(out: Path) -> dict[str, Any]:
    summary = json.loads((out / "study.json").read_text())
    assert isinstance(summary, dict)
    return summary


def test_a_study_leaves_its_tables_and_figures(finished: Path) -> None:
    assert {file.name for file in finished.iterdir()} == {"study.json", "study.md", "figures", "runs"}
    drawn = list((finished / "figures").iterdir())
    assert {file.name for file in drawn} == {"cost.png", "rates.png", "where.png"}
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in drawn)

    summary = summary_of(finished)
    assert (summary["status"], summary["reason"]) == ("done", None)
    assert summary["scene"] == json.loads(json.dumps(load_scene(demo("very_rough"), SMALL).as_dict()))
    points = {point["words"]: point for point in summary["points"]}
    turned = ["start", "cells", "element", "steps", "local tolerance", *["effects"] * 4, "together"]
    assert [point["turned"] for point in points.values()] == turned
    for point in points.values():
        assert (point["status"], len(point["runs"])) == ("done", 2)
        assert point["loop_s"] == pytest.approx(np.median([it["loop"] for it in point["runs"]]))
        assert 0 < point["loop_s"] < point["phases_s"]["whole run"]

    page = (finished / "study.md").read_text()
    assert "16 cells, steps x 0.5" in page
    for name, quantity in summary["quantities"].items():
        assert f"| {name} | " in page
        clean = [rate for rate in (quantity["cell_rate"], quantity["step_rate"]) if rate is not None]
        assert quantity["how"].count("extrapolated") == len(clean)
        assert quantity["how"].count("finest run") == 2 - len(clean)


def test_the_errors_are_those_of_the_runs(finished: Path) -> None:
    summary = summary_of(finished)
    peak = summary["quantities"]["peak shear stress"]
    for point in summary["points"]:
        reported = read_run(finished / "runs" / point["name"]).summary["friction"]["refined_peak_shear_stress_Pa"]
        error = point["errors_percent"]["peak shear stress"]
        assert error["error"] == pytest.approx(100 * (reported / peak["reference"] - 1))
        assert error["is_bound"] == (abs(error["error"]) <= peak["error_percent"])


def test_what_is_there_is_not_made_again(
    call: Call, tmp_path: Path, finished: Path, in_this_process: InThisProcess
) -> None:
    out = tmp_path / "study"
    shutil.copytree(finished, out)
    outcome = call(*study_of(out, repeats=2))
    assert (outcome.status, outcome.err) == (DONE, "")
    assert f"done: see {out / 'study.md'}" in outcome.out
    assert in_this_process.made == []
    assert summary_of(out) == summary_of(finished)


def test_an_interrupted_study_goes_on(call: Call, tmp_path: Path, in_this_process: InThisProcess) -> None:
    out, in_this_process.most = tmp_path / "study", 5
    outcome = call(*study_of(out))
    assert outcome.status == INTERRUPTED
    assert outcome.err == "cosserat-fx: interrupted; the same command goes on\n"
    assert (summary_of(out)["status"], summary_of(out)["reason"]) == ("stopped", "interrupted")
    in_this_process.most = 7
    assert call(*study_of(out)).status == INTERRUPTED
    made = in_this_process.names
    assert len(made) == len(set(made)) == 4


def test_runs_that_fail_are_points_with_a_reason(
    call: Call, tmp_path: Path, in_this_process: InThisProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "study"
    few = replace(TINY, cells=(), local=(), together_cells=(1.0,), fine_cells=(1.0,), fine_steps=(1.0, 0.5))
    monkeypatch.setattr(plan, "QUICK", few)
    call("run", demo("medium_rough"), "--out", tmp_path / "run", *settings(*SMALL, "output.figures=false"))
    steps = read_run(tmp_path / "run").summary["steps"]
    outcome = call(*study_of(out, f"stepping.max_steps={steps}", wall="medium_rough"))
    assert outcome.status == DONE
    points = {point["words"]: point for point in summary_of(out)["points"]}
    half = points["steps x 0.5"]
    assert half["status"] == "stopped"
    assert half["reason"].startswith(f"the run reached its limit of {steps} steps")
    assert half["errors_percent"] == {}
    assert f"steps x 0.5: 0.0 s, stopped: {half['reason']}" in re.sub(
        r"[\d.]+ s, stopped", "0.0 s, stopped", outcome.out
    )
    refused = points["without polar"]
    assert refused["status"] == "refused"
    assert refused["reason"].startswith("walls.top.rolling = 0.0125: must be 0 where effects.polar = false")
    assert not (out / "runs" / refused["name"]).exists()
    assert f"refused: {refused['reason']}" in (out / "study.md").read_text()
    assert set(summary_of(out)["not_compared"]) == {it.name for it in quantities(load_scene(demo("medium_rough")))}


def test_a_scene_that_does_not_reach_its_end_cannot_be_studied(
    call: Call, tmp_path: Path, in_this_process: InThisProcess
) -> None:
    outcome = call(*study_of(tmp_path / "study", "stepping.max_steps=1"))
    assert outcome.status == STOPPED
    message = "stopped early: the scene as it is was stopped: the run reached its limit of 1 steps"
    assert outcome.err.startswith(message)
    assert summary_of(tmp_path / "study")["status"] == "stopped"


def test_a_plane_body_is_measured_by_its_column(tmp_path: Path) -> None:
    keys = ("geometry.cells=[4, 14]", "boundaries.top.u2=-5e-4", "output.fields_at=[2e-4, 5e-4]", "output.fields=false")
    scene = load_scene(DEMOS / "biaxial.toml", [*keys, "output.figures=false", "output.frames=0"])
    run(scene, tmp_path / "run")
    done = read_run(tmp_path / "run")
    measured = measure(done, scene)
    stress = done.history["axial_stress_Pa"]
    assert measured["final axial stress"] == stress[-1]
    assert measured["peak axial stress"] >= stress.max()
    at = np.isin(done.history["travel_m"], [2e-4, 5e-4])
    assert np.array_equal(measured["axial stress at the travels in fields_at"], stress[at])
    assert set(measured) <= {quantity.name for quantity in quantities(scene)}


# -- processes ---------------------------------------------------------------------------------------------------------


def test_a_run_is_a_process_that_is_timed(tmp_path: Path) -> None:
    made = Runs(tmp_path, demo("very_rough"), SMALL, plane=False)
    record = made.run("small", {"geometry.cells": "4"}, repeats=1)
    assert (record.status, record.reason) == ("done", None)
    made_of = read_run(tmp_path / "small")
    assert made_of.summary["sizes"]["cells"] == 4
    assert record.counts["steps"] == made_of.summary["steps"]
    assert record.process is not None
    assert record.loop is not None
    assert record.process > made_of.summary["seconds"]["whole run"] > record.loop > 0
    assert record.timings[0].processor > record.loop / 2
    assert made.run("small", {"geometry.cells": "4"}, repeats=1) == record
    assert made.started == 1


def test_a_run_that_takes_too_long_is_stopped(tmp_path: Path) -> None:
    made = Runs(tmp_path, demo("very_rough"), SMALL, plane=False)
    record = made.run("endless", {"geometry.cells": "4000", "stepping.max_step": "1e-7"}, repeats=3, patience=5.0)
    assert not record.done
    assert record.reason == "stopped after 5 s, many times what was expected"
    assert made.started == 1


def test_a_run_that_breaks_is_made_again_when_the_study_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Runs(tmp_path, demo("very_rough"), SMALL, plane=False)
    with monkeypatch.context() as patch:
        patch.setattr(made, "_command", lambda *_, **__: [sys.executable, "-c", "import os; os.abort()"])
        broken = made.run("small", {}, repeats=1)
    assert (broken.status, broken.reason) == ("broken", "ended by SIGABRT")
    with monkeypatch.context() as patch:
        patch.setattr(made, "_command", lambda *_, **__: [sys.executable, "-c", "raise SystemExit('no luck')"])
        assert made.run("small", {}, repeats=1).reason == "no luck"
    assert made.started == 2


def test_runs_inherit_no_surprises(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.setenv("PMI_RANK", "0")
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    found = runs.environment()
    assert found["OMP_NUM_THREADS"] == "1"
    assert not found.keys() & {"PMI_RANK", "OMPI_COMM_WORLD_SIZE"}
    assert set(found["PYTHONPATH"].split(os.pathsep)) == set(filter(None, sys.path))


# -- refusals ----------------------------------------------------------------------------------------------------------


def test_a_study_is_not_started_on_several_ranks(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ranks = SimpleNamespace(size=2, rank=0)
    monkeypatch.setattr(cli, "_ranks", lambda: ranks)
    monkeypatch.setattr(cli, "main", cli.app)  # without what waits for other ranks
    outcome = call(*study_of(tmp_path / "study"))
    assert_refused(outcome, "cannot be started on 2 ranks; leave out mpirun")
    assert list(tmp_path.iterdir()) == []


def of_other_things(out: Path) -> str:
    out.mkdir()
    (out / "thesis.tex").write_text("precious")
    return "holds something other than a study; choose another folder"


def of_a_file(out: Path) -> str:
    out.write_text("precious")
    return "exists and is not a folder"


def of_another_study(out: Path) -> str:
    out.mkdir()
    (out / "study.json").write_text(json.dumps({"study_format": 1, "scene": {"title": "another"}}))
    return "holds a study of another scene; choose another folder"


@pytest.mark.parametrize("fill", [of_other_things, of_a_file, of_another_study])
def test_a_folder_of_something_else_is_left_alone(call: Call, tmp_path: Path, fill: Callable[[Path], str]) -> None:
    message = fill(tmp_path / "out")
    before = listing(tmp_path)
    assert_refused(call(*study_of(tmp_path / "out")), message)
    assert listing(tmp_path) == before


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("geometry.cells=0", "geometry.cells = 0"),
        ("accuracy=0.01", "accuracy = 0.01: must be left out of a study, which varies what it would choose"),
    ],
)
def test_a_scene_that_cannot_be_studied_is_refused(call: Call, tmp_path: Path, override: str, message: str) -> None:
    assert_refused(call(*study_of(tmp_path / "study", override)), message)
    assert list(tmp_path.iterdir()) == []


def test_repeats_are_counted_from_one(call: Call, tmp_path: Path) -> None:
    outcome = call(*study_of(tmp_path / "study", repeats=0))
    assert outcome.status == BAD_INPUT
