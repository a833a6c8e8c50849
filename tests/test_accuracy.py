"""A run to a requested accuracy: what it chooses, that it keeps its promise, and what it says of its error."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from console import Call
from layers import converged, scene
from ranks import on_ranks
from scenes import ABSENT, RECTANGLE, change, to_toml

from cosserat_fx._compat import MPI
from cosserat_fx.accuracy import plan as planning
from cosserat_fx.accuracy.choice import (
    LARGEST_FACTOR,
    Level,
    Settings,
    cells_for,
    checked_cells,
    choose_steps,
    coarsest_cells,
    orders_and_errors,
    refine,
)
from cosserat_fx.accuracy.estimate import estimate
from cosserat_fx.accuracy.trace import Trace
from cosserat_fx.accuracy.trial import Trials
from cosserat_fx.bodies import build
from cosserat_fx.layer import Layer
from cosserat_fx.results import Run, read_run
from cosserat_fx.run import run
from cosserat_fx.scene import LayerScene, SceneError, parse_scene
from cosserat_fx.scenes.layer import Leg
from cosserat_fx.stepping import SteppingError
from cosserat_fx.typing import Array

LAYER: dict[str, Any] = {
    "accuracy": 0.01,
    "geometry": {"height": 0.015},
    "initial": {"stress": -100e3, "void_ratio": 0.62},
    "walls": {"top": {"normal_stress": -100e3, "shear_displacement": [0.003]}},
    "output": {"profiles_at": [], "figures": False, "fields": False},
}
"""Thirty grains high, and past its peak in the end."""
FINE = {"accuracy": ABSENT, "stepping.tolerance": 0.03, "stepping.strain": 0.1, "solver.local_tolerance": 1e-4}
GRAIN = 0.5e-3


def layer(changes: dict[str, object] | None = None) -> LayerScene:
    parsed = parse_scene(change(LAYER, changes or {}))
    assert isinstance(parsed, LayerScene)
    return parsed


def made(folder: Path, changes: dict[str, object] | None = None) -> Run:
    """The run of the layer with some keys changed."""
    assert run(layer(changes), folder, comm=MPI.COMM_SELF).reason is None
    return read_run(folder)


def shear_stresses(found: Run, scene: LayerScene) -> tuple[Array, Array]:
    """Peak among the steps and shear stress at the end of each leg (Pa)."""
    ends = [0.0, *np.cumsum(np.abs(np.diff([0.0, *scene.walls.top.shear_displacement])))]
    ends = ends if scene.initial.stress == scene.walls.top.normal_stress else [0.0, *(GRAIN + np.array(ends))]
    trace = Trace.of(
        np.cumsum(found.history["step_size_m"]), found.history["shear_stress_Pa"], ends, scene.legs, rate_error=0.0
    )
    return trace.peaks, trace.ends


def totals(found: Run) -> dict[str, float]:
    errors = found.summary["accuracy"]["estimated_error"]
    return {name: errors[name]["total"] for name in ("peak", "residual")}


# -- what a scene may ask for ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"accuracy": 0}, "accuracy = 0: must be a finite number greater than 0 and at most 0.1"),
        ({"accuracy": 0.2}, "accuracy = 0.2: must be a finite number greater than 0 and at most 0.1"),
        ({"accuracy": ABSENT}, "geometry.cells is missing: must be given unless accuracy is, by which they are chosen"),
        ({"effects.polar": False}, "accuracy = 0.01: must be left out where effects.polar = false"),
    ],
)
def test_an_accuracy_that_cannot_be_kept_is_refused(changes: dict[str, object], told: str) -> None:
    with pytest.raises(SceneError) as refusal:
        parse_scene(change(LAYER, changes))
    assert str(refusal.value).startswith(told)


def test_a_plane_body_has_no_accuracy() -> None:
    with pytest.raises(SceneError) as refusal:
        parse_scene(change(RECTANGLE, {"accuracy": 0.01}))
    assert str(refusal.value).startswith('accuracy = 0.01: must be left out, as only geometry.kind = "layer" has this')


def test_a_scene_that_leaves_the_choice_leaves_it_in_its_dictionary_too() -> None:
    asked = layer()
    tables = asked.as_dict()
    assert "cells" not in tables["geometry"]
    assert not {"first_step", "tolerance", "strain"} & tables["stepping"].keys()
    assert "local_tolerance" not in tables["solver"]
    again = parse_scene(tables)
    assert again == asked
    assert isinstance(again, LayerScene)
    assert again.given == ()


def test_without_an_accuracy_there_is_no_plan_and_no_entry(tmp_path: Path) -> None:
    few: dict[str, object] = {"accuracy": ABSENT, "geometry.cells": 8, "walls.top.shear_displacement": [1e-4]}
    body = build(layer(few), MPI.COMM_SELF)
    assert isinstance(body, Layer)
    assert body.plan is None
    summary = made(tmp_path / "run", few).summary
    assert "accuracy" not in summary
    assert "accuracy" not in summary["scene"]
    assert summary["warnings"] == []


# -- what is chosen ----------------------------------------------------------------------------------------------------


def levels(error: Callable[[float], float], cells: list[int]) -> list[Level]:
    """Meshes of a made-up layer whose peak is 1 + error(cell size) Pa; its residual has no error."""
    return [Level(n, np.array([[1 + error(1 / n)], [0.5]])) for n in cells]


def test_errors_of_second_order_are_found_and_met() -> None:
    found = levels(lambda h: -6.4 * h**2, [10, 20, 40])
    orders, errors = orders_and_errors(found)
    assert orders[0, 0] == pytest.approx(2.0, abs=0.05)
    assert errors[0, 0] == pytest.approx(6.4 / 40**2, rel=0.05)
    # Finer than all that were tried, and between two of them.
    assert cells_for(found, 0.002) == pytest.approx(np.sqrt(6.4 / 0.002), rel=0.05)
    assert cells_for(found, 0.03) == pytest.approx(np.sqrt(6.4 / 0.03), rel=0.05)


def test_a_mesh_that_does_not_converge_is_not_trusted() -> None:
    tried: list[int] = []

    def walk(cells: int) -> Trace:
        tried.append(cells)
        values = np.array([1 + 0.05 * (-1) ** len(tried)])
        return Trace(values, values, values, np.zeros(1), 0.0)

    found = refine(walk, coarsest=10, finest=100, share=0.001)
    assert tried == [10, 20, 40, 80, 160]
    assert orders_and_errors(found)[1].min() > 0.1
    assert cells_for(found, 0.001) == 160


def test_a_mesh_that_is_worse_than_expected_gives_way_to_the_finest_that_was_tried() -> None:
    found = levels(lambda h: -6.4 * h**2, [10, 20, 40])
    wanted = cells_for(found, 0.03)
    assert checked_cells(lambda cells: _flat(1 - 6.4 / cells**2, other=0.5), found, 0.03) == wanted
    assert checked_cells(lambda cells: _flat(0.9, other=0.5), found, 0.03) == 40


def test_one_small_difference_is_enough() -> None:
    found = refine(lambda cells: _flat(1 - 1e-2 / cells**2), coarsest=10, finest=100, share=0.001)
    assert [level.cells for level in found] == [10, 20]
    assert cells_for(found, 0.001) == 10


def _flat(value: float, rate_error: float = 0.1, other: float | None = None) -> Trace:
    """A walk with one value for its peak and the same, or another, for its residual."""
    values = np.array([value])
    return Trace(values, values, values if other is None else np.array([other]), np.zeros(1), rate_error)


@pytest.mark.parametrize(("slope", "share"), [(0.05, 1e-3), (0.05, 7e-3), (1e-4, 1e-2)])
def test_steps_follow_from_the_error_of_the_strain_rate(slope: float, share: float) -> None:
    """Walks whose error is proportional to that of the strain rate, which is so to the aims."""
    factor, found = choose_steps(
        lambda settings: _flat(1 - slope * 0.1 * settings.factor, 0.1 * settings.factor), 10, 1e-3, share, fixed=False
    )
    assert found == pytest.approx(slope, rel=0.01)
    assert factor == pytest.approx(min(LARGEST_FACTOR, share / (slope * 0.1)), rel=0.01)


def test_steps_that_are_given_stay() -> None:
    tried: list[float] = []

    def walk(settings: Settings) -> Trace:
        tried.append(settings.factor)
        return _flat(1 - 0.1 * settings.factor, settings.factor)

    assert choose_steps(walk, 10, 1e-3, 1e-6, fixed=True)[0] == 1.0
    assert tried == [2.0, 1.0]


def test_the_coarsest_mesh_shows_what_the_initial_state_has() -> None:
    assert coarsest_cells(layer({"geometry.height": 0.1})) == 50
    zone = {"y": [0.05, 0.051], "void_ratio": 0.65}
    assert coarsest_cells(layer({"geometry.height": 0.1, "initial.zones": [zone]})) == pytest.approx(100, abs=1)
    wavy = {"standard_deviation": 0.01, "correlation_length_d50": 1.0, "seed": 1}
    assert coarsest_cells(layer({"geometry.height": 0.1, "initial.random": wavy})) == 200


def test_peaks_and_ends_of_legs_are_measured_along_them() -> None:
    travel = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    shear = np.array([3.0, 4.0, 3.5, 1.0, -2.0, -1.5])
    found = Trace.of(travel, shear, [0.0, 3.0, 6.0], [Leg(3.0, 0.0), Leg(0.0, 0.0)], rate_error=0.0)
    assert found.peaks.tolist() == [4.0, 2.0]
    assert found.ends.tolist() == [3.5, 1.5]
    assert found.vertices[0] == pytest.approx(4.0 + 0.25**2 / (4 * 0.75))
    assert found.sampling[0] == pytest.approx((found.vertices - found.peaks) / found.vertices)
    assert found.sampling[1].tolist() == [0.0, 0.0]
    assert np.all(found.chance >= found.sampling)


# -- the promise -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("accuracy", [0.03, 0.01])
def test_the_medium_rough_demo_keeps_the_accuracy_it_is_asked_for(tmp_path: Path, accuracy: float) -> None:
    tables = change(scene("medium_rough").as_dict(), {"accuracy": accuracy, "geometry.cells": ABSENT})
    for name, keys in {"stepping": ("tolerance", "strain"), "solver": ("local_tolerance",)}.items():
        tables = change(tables, {f"{name}.{key}": ABSENT for key in keys})
    run(parse_scene(tables), tmp_path / "run", comm=MPI.COMM_SELF)
    found = read_run(tmp_path / "run")
    friction, told = found.summary["friction"], totals(found)
    true = {name: abs(friction[f"{name}_shear_stress_Pa"] / converged("medium_rough", name) - 1) for name in told}
    assert max(true.values()) <= accuracy
    assert max(true.values()) >= accuracy / 10, "more than was asked for"
    assert max(told.values()) <= accuracy
    assert 1 / 3 < max(told.values()) / max(true.values()) < 4
    assert found.summary["warnings"] == []


SCENES: dict[str, dict[str, object]] = {
    "loose, to and fro": {"initial.void_ratio": 0.85, "walls.top.shear_displacement": [0.002, 0.0]},
    "rolling, a weak zone": {
        "walls.top.rolling": 0.02,
        "initial.zones": [{"y": [0.003, 0.0045], "void_ratio": 0.7}],
    },
    "loaded first, fractions, frozen void ratio, no spin": {
        "walls.top.normal_stress": -150e3,
        "walls.top.f_u": 0.8,
        "walls.top.f_r": 0.02,
        "walls.top.f_s": 0.18,
        "effects": {"void_ratio": False, "spin": "none"},
    },
    "constant height, weight": {
        "walls.top": {"constant_height": True, "shear_displacement": [0.002]},
        "weight": {"density": 1700.0},
    },
}


@pytest.mark.parametrize("case", SCENES)
def test_scenes_of_many_kinds_keep_the_accuracy(tmp_path: Path, case: str) -> None:
    asked = made(tmp_path / "asked", SCENES[case])
    fine = made(tmp_path / "fine", SCENES[case] | FINE | {"geometry.cells": 120})
    worst = 0.0
    for value, exact in zip(
        shear_stresses(asked, layer(SCENES[case])), shear_stresses(fine, layer(SCENES[case])), strict=True
    ):
        worst = max(worst, float(np.max(np.abs(value / exact - 1))))
    assert worst <= 0.01
    assert worst <= 2 * max(totals(asked).values())
    assert not any("accuracy" in warning for warning in asked.summary["warnings"])


# -- what a run says ---------------------------------------------------------------------------------------------------


def test_what_the_scene_gives_stays_and_is_told(call: Call, tmp_path: Path) -> None:
    given = {"geometry.cells": 10, "stepping.tolerance": 0.2, "solver.local_tolerance": 5e-3, "accuracy": 0.002}
    (tmp_path / "scene.toml").write_text(to_toml(change(LAYER, given)))
    outcome = call("run", tmp_path / "scene.toml", "--out", tmp_path / "run")
    accuracy = read_run(tmp_path / "run").summary["accuracy"]
    assert (
        accuracy["chosen"] | {"cells": 10, "tolerance": 0.2, "strain": 0.4, "local_tolerance": 5e-3}
        == accuracy["chosen"]
    )
    assert accuracy["given"] == ["geometry.cells", "stepping.tolerance", "solver.local_tolerance"]
    kept = "given and kept: geometry.cells, stepping.tolerance, solver.local_tolerance"
    assert kept in " ".join(outcome.out.split())
    total = max(it["total"] for it in accuracy["estimated_error"].values())
    assert total > 0.002
    assert f"is estimated at {100 * total:.2g} %, more than the 0.2 % asked for" in outcome.err
    peak, residual = (f"{100 * accuracy['estimated_error'][name]['total']:.2g} %" for name in ("peak", "residual"))
    assert f"estimated error: peak {peak}, residual {residual} (asked: 0.2 %)" in outcome.out


def test_a_check_tells_what_a_run_would_choose(call: Call, tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(to_toml(LAYER))
    told = " ".join(call("check", tmp_path / "scene.toml").out.split())
    chosen = made(tmp_path / "run").summary["accuracy"]
    assert f"accuracy 1 %, by {chosen['trial_runs']} trial runs: {chosen['chosen']['cells']} cells of" in told


def test_the_scene_of_a_run_runs_alike_again(tmp_path: Path) -> None:
    first = made(tmp_path / "first")
    scene_again = parse_scene(first.summary["scene"])
    run(scene_again, tmp_path / "second", comm=MPI.COMM_SELF)
    second = read_run(tmp_path / "second")
    assert np.array_equal(first.history["shear_stress_Pa"], second.history["shear_stress_Pa"])


def test_a_run_in_two_halves_tells_the_same_error(tmp_path: Path) -> None:
    whole = made(tmp_path / "whole").summary
    assert run(layer({"stepping.max_steps": 6}), tmp_path / "halves", comm=MPI.COMM_SELF).reason is not None
    half = read_run(tmp_path / "halves").summary["accuracy"]
    assert half["estimated_error"] is None
    assert half["chosen"] == whole["accuracy"]["chosen"]
    assert run(layer(), tmp_path / "halves", comm=MPI.COMM_SELF, resume=True).reason is None
    resumed = read_run(tmp_path / "halves").summary
    assert resumed["resumed_after_steps"] == [6]
    assert resumed["accuracy"] == whole["accuracy"]


def test_where_trial_runs_fail_the_run_is_made_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Trials, settings: Settings) -> Trace:
        raise SteppingError("the step from 0 m failed")

    monkeypatch.setattr(Trials, "__call__", fail)
    found = made(tmp_path / "run", {"walls.top.shear_displacement": [2e-4]}).summary
    assert found["accuracy"]["estimated_error"] is None
    assert found["accuracy"]["chosen"]["cells"] == 0.015 / GRAIN
    assert found["warnings"] == [
        "accuracy: the error of this run is not known, as a trial run failed: the step from 0 m failed"
    ]


def test_the_estimate_adds_up_its_sources() -> None:
    asked = layer()
    found = planning.plan(asked, None)
    assert found.choice is not None
    trace = Trials(asked, {})(found.choice.settings)
    told = estimate(found.choice, trace)
    parts = told.mesh + told.steps + told.local_tolerance
    assert told.total == pytest.approx(parts)  # with one leg, it is the worst one for all sources
    finer = replace(found.choice, settings=replace(found.choice.settings, cells=4 * found.choice.levels[-1].cells))
    assert np.all(estimate(finer, trace).mesh <= told.mesh)


def test_several_ranks_choose_and_tell_what_one_does(tmp_path: Path) -> None:
    ranks, short = 3, {"walls.top.shear_displacement": [0.0005], "geometry.height": 0.006}
    program = """
import json, sys
from pathlib import Path
from cosserat_fx.run import run
from cosserat_fx.scene import parse_scene
run(parse_scene(json.loads(sys.argv[1])), Path(sys.argv[2]))
"""
    on_ranks(ranks, program, json.dumps(change(LAYER, short)), tmp_path / "several")
    one, several = made(tmp_path / "one", short).summary, read_run(tmp_path / "several").summary
    assert several["ranks"] == ranks
    assert several["accuracy"]["chosen"] == one["accuracy"]["chosen"]
    for name in ("peak", "residual"):
        ours, theirs = (it["accuracy"]["estimated_error"][name] for it in (one, several))
        assert theirs == pytest.approx(ours, rel=1e-4)
