"""What a study tries, how it writes it down, and what it makes of the runs: without running anything."""

import io
import itertools
import json
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from layers import DEMOS, demo, scene
from rich.console import Console

from cosserat_fx.scene import Scene, SceneError, load_scene, parse_scene
from cosserat_fx.studies.assessment import Assessment
from cosserat_fx.studies.choice import WITHOUT, Choice, Spelling
from cosserat_fx.studies.plan import KNOBS, LAYER, PLANE, QUICK, Plan, Sizes, element_of, elements_for, plan, weight
from cosserat_fx.studies.progress import LEAST_PATIENCE, Forecast, StudyProgress, Task
from cosserat_fx.studies.quantities import Quantity, quantities, stress_column
from cosserat_fx.studies.reference import reference
from cosserat_fx.studies.runs import Record, Timing
from cosserat_fx.typing import Array

START = Choice(1.0, "1 point", 1.0, 1.0)
SCENES = {
    "layer": (demo("very_rough"), LAYER, "1 point"),
    "rectangle": (DEMOS / "biaxial.toml", PLANE, "Q1R"),
    "mesh": (DEMOS / "rough_strip_very_rough.toml", PLANE, "Q1R"),
    "quick": (demo("medium_rough"), QUICK, "1 point"),
}
TURNED = ("cells", "element", "steps", "local", "without")


def planned(case: str) -> tuple[Scene, Spelling, Plan]:
    file, sizes, element = SCENES[case]
    loaded = load_scene(file)
    assert element_of(loaded) == element
    spelling = Spelling(loaded, element, first_step=1e-4)
    return loaded, spelling, plan(loaded, spelling.start, list(WITHOUT), sizes)


def differences(a: Choice, b: Choice) -> int:
    return sum(getattr(a, knob) != getattr(b, knob) for knob in TURNED)


@pytest.mark.parametrize("case", SCENES)
def test_each_knob_is_turned_alone_and_several_together(case: str) -> None:
    loaded, _, wanted = planned(case)
    assert all(differences(wanted.start, choice) == 1 for knob in KNOBS for choice in wanted.alone[knob])
    assert all(differences(wanted.start, choice) > 1 for choice in wanted.together)
    assert len({choice.name for choice in wanted.timed}) == len(set(wanted.timed)) == len(wanted.timed)
    others = [name for name in elements_for(loaded, wanted.start.element) if name != wanted.start.element]
    assert [choice.element for choice in wanted.alone["element"]] == others
    assert [choice.without for choice in wanted.alone["effects"]] == list(WITHOUT)


@pytest.mark.parametrize("case", ["layer", "rectangle", "quick"])
def test_the_refinements_double_and_share_their_corner(case: str) -> None:
    _, _, wanted = planned(case)
    fine = wanted.refinement
    for levels, knob, ratio in ((fine.cells, "cells", 2.0), (fine.steps, "steps", 0.5)):
        assert fine.corner in levels
        settings = [getattr(choice, knob) for choice in levels]
        assert [after / before for before, after in itertools.pairwise(settings)] == [ratio] * (len(levels) - 1)
        assert len(levels) >= 3
    assert fine.diagonal is not None
    assert fine.diagonal.cells in [choice.cells for choice in fine.cells]
    assert fine.diagonal.steps in [choice.steps for choice in fine.steps]
    assert not set(wanted.untimed) & set(wanted.timed)
    assert set(wanted.untimed) | set(wanted.timed) >= set(fine.choices)


@pytest.mark.parametrize("case", SCENES)
def test_choices_are_spelled_as_scenes_that_differ_in_nothing_else(case: str) -> None:
    loaded, spelling, wanted = planned(case)
    file = SCENES[case][0]
    for choice in [*wanted.timed, *wanted.untimed]:
        settings = spelling.settings(choice)
        keys = [f"{key}={value}" for key, value in settings.items()]
        if choice.without == "polar" and case == "quick":  # its grains roll at the wall
            with pytest.raises(SceneError, match=r"walls\.top\.rolling"):
                load_scene(file, keys)
            continue
        found = load_scene(file, keys)
        expected = loaded.as_dict()
        for dotted, value in flat(found.as_dict()).items():
            assert value == flat(expected).get(dotted) or dotted in settings, dotted
        assert found.solver.local_tolerance == pytest.approx(choice.local * loaded.solver.local_tolerance)
        assert found.stepping.tolerance == pytest.approx(choice.steps * loaded.stepping.tolerance)
        assert found.stepping.strain == pytest.approx(choice.steps * loaded.stepping.strain)
        if choice.steps != 1.0:
            assert found.stepping.first_step == pytest.approx(choice.steps * 1e-4)


def flat(tables: dict[str, object], above: str = "") -> dict[str, object]:
    found: dict[str, object] = {}
    for key, value in tables.items():
        found |= flat(value, f"{above}{key}.") if isinstance(value, dict) else {f"{above}{key}": value}
    return found


def test_a_choice_that_is_the_scene_as_it_is_changes_nothing() -> None:
    spelling = Spelling(scene("very_rough"), "1 point", first_step=1e-4)
    assert spelling.settings(spelling.start) == {}
    assert spelling.fragment(spelling.start) == ""
    assert spelling.words(spelling.start) == "the scene as it is"


def test_largest_and_smallest_steps_that_a_scene_gives_go_along() -> None:
    given = ("stepping.min_step=5e-5", "stepping.first_step=1e-4", "stepping.max_step=2e-3")
    spelling = Spelling(scene("very_rough", *given), "1 point", first_step=1e-4)
    settings = spelling.settings(replace(START, steps=0.25))
    assert float(settings["stepping.max_step"]) == pytest.approx(5e-4)
    assert float(settings["stepping.min_step"]) == float(settings["stepping.first_step"]) == pytest.approx(2.5e-5)
    scene("very_rough", *given, *(f"{key}={value}" for key, value in settings.items()))


@pytest.mark.parametrize("case", ["layer", "rectangle"])
def test_the_fragment_to_paste_says_the_same_as_the_settings(case: str) -> None:
    _, spelling, wanted = planned(case)
    for choice in wanted.timed:
        written = flat(tomllib.loads(spelling.fragment(choice)))
        assert {key: str(value) for key, value in written.items()} == {
            key: {"true": "True", "false": "False"}.get(value, value)
            for key, value in spelling.settings(choice).items()
        }


def test_a_mesh_from_a_file_is_not_refined_and_that_is_said() -> None:
    _, _, wanted = planned("mesh")
    assert wanted.skipped["cells"] == "the mesh is from a file, which a study does not refine"
    assert {choice.cells for choice in [*wanted.timed, *wanted.untimed]} == {1.0}


def test_finer_costs_more() -> None:
    for finer in ({"cells": 2.0}, {"steps": 0.5}, {"local": 0.1}, {"element": "2 points"}):
        assert weight(replace(START, **finer), START, 1) > 1.0
    assert weight(replace(START, cells=2.0), START, 2) == pytest.approx(4.0)


# -- what is compared --------------------------------------------------------------------------------------------------


def test_a_plane_body_is_compared_by_its_own_column_or_what_is_moved() -> None:
    biaxial = load_scene(DEMOS / "biaxial.toml")
    assert stress_column(biaxial) == "axial_stress_Pa"  # type: ignore[arg-type]
    assert [it.name for it in quantities(biaxial)][:2] == ["peak axial stress", "final axial stress"]
    tables = biaxial.as_dict()
    tables["output"].pop("columns")
    assert stress_column(parse_scene(tables)) == "top_force2_N_per_m"  # type: ignore[arg-type]
    box = load_scene(DEMOS / "shear_box.toml").as_dict()
    box["output"].pop("columns")
    assert stress_column(parse_scene(box)) == "top_force1_N_per_m"  # type: ignore[arg-type]


def test_errors_of_numbers_have_a_sign_and_those_of_profiles_are_relative_to_their_range() -> None:
    number, profile = Quantity("peak", "Pa", "stress"), Quantity("displacement", "", "profiles")
    assert number.error(np.array(99.0), np.array(100.0)) == pytest.approx(-1.0)
    assert profile.error(np.array([0.1, 9.9]), np.array([0.0, 10.0])) == pytest.approx(1.0)


# -- the reference -----------------------------------------------------------------------------------------------------

PEAK = Quantity("peak", "Pa", "stress")
PROFILES = Quantity("profiles", "", "profiles")
EXACT, SHAPE = 100.0, np.array([0.0, 1.0, 4.0])


def synthetic(choice: Choice, *, mixed: float = 0.0) -> dict[str, Array]:
    """Second order in the cells, first in the steps, and what depends on both."""
    h, step = 1 / choice.cells, choice.steps
    error = 0.8 * h**2 - 0.5 * step + mixed * h**2 * step
    without = 3.0 if choice.without else 0.0
    points = 2.0 if choice.element == "2 points" else 0.0
    local = 1e-3 * choice.local
    return {
        "peak": np.array(EXACT + error + without + points + local),
        "profiles": SHAPE * (1 + 0.01 * h**2) + 0.01 * step,
    }


@pytest.mark.parametrize("sizes", [LAYER, PLANE, QUICK])
def test_the_reference_of_clean_rates_is_exact(sizes: Sizes) -> None:
    wanted = plan(load_scene(demo("very_rough")), START, [], sizes).refinement
    measured = {choice: synthetic(choice) for choice in wanted.choices}
    found = reference(PEAK, wanted, measured, with_cells=True)
    assert found is not None
    assert found.cell_rate == pytest.approx(2.0)
    assert found.step_rate == pytest.approx(1.0)
    assert found.value == pytest.approx(EXACT, abs=1e-3 * sizes.tight * 1.01)
    assert found.local_error == pytest.approx(1e-3 * 9 * sizes.tight)
    assert found.mixed_error == pytest.approx(0.0, abs=1e-9)
    assert abs(found.value - EXACT) <= found.error
    shape = reference(PROFILES, wanted, measured, with_cells=True)
    assert shape is not None
    assert shape.value == pytest.approx(SHAPE, abs=1e-12)


def test_the_error_that_depends_on_cells_and_steps_together_is_seen() -> None:
    wanted = plan(load_scene(demo("very_rough")), START, [], QUICK).refinement
    found = reference(PEAK, wanted, {it: synthetic(it, mixed=0.4) for it in wanted.choices}, with_cells=True)
    assert found is not None
    left_out = 0.4 * (1 / wanted.corner.cells) ** 2 * wanted.corner.steps
    assert abs(found.value - EXACT) == pytest.approx(left_out, rel=1e-2)
    assert found.mixed_error == pytest.approx(left_out, rel=0.05)
    assert abs(found.value - EXACT) <= found.error


def test_a_reference_makes_do_with_the_runs_around_its_corner() -> None:
    wanted = plan(load_scene(demo("very_rough")), START, [], LAYER).refinement
    measured = {choice: synthetic(choice) for choice in wanted.choices}
    del measured[wanted.cells[-1]], measured[wanted.steps[-1]]
    found = reference(PEAK, wanted, measured, with_cells=True)
    assert found is not None
    assert found.value == pytest.approx(EXACT, abs=1e-5)
    del measured[wanted.corner]
    assert reference(PEAK, wanted, measured, with_cells=True) is None


# -- the assessment ----------------------------------------------------------------------------------------------------


def seconds(choice: Choice) -> float:
    return choice.cells / choice.steps * (2.0 if choice.element == "2 points" else 1.0)


def record(loop: float) -> Record:
    timings = tuple(Timing(loop + 2.0, loop, {"whole run": loop + 0.5, "set-up": 0.5}) for _ in range(3))
    return Record("done", None, timings)


def assessed(fails: Callable[[Choice], bool] = lambda choice: False) -> Assessment:
    wanted = plan(load_scene(demo("very_rough")), START, ["spin"], LAYER)
    choices = [*wanted.timed, *wanted.untimed]
    failed = Record("stopped", "it snapped", record(1.0).timings[:1])
    records = {choice: failed if fails(choice) else record(seconds(choice)) for choice in choices}
    measured = {choice: synthetic(choice) for choice in choices if records[choice].done}
    return Assessment(wanted, [PEAK, PROFILES], records, measured)


def test_no_point_of_the_front_is_beaten_and_all_others_are() -> None:
    found = assessed()
    front = found.front(["peak"])
    assert len(front) > 2
    assert all(point.choice.without is None for point in front)
    for point in (it for it in found.points if it.choice.without is None):
        error, loop = point.error(["peak"]), point.record.loop
        assert error is not None
        assert loop is not None
        better = [it for it in front if (it.record.loop or 0) <= loop and (it.error(["peak"]) or 0) <= error]
        assert better
        assert (point in front) == (better == [point])


def test_the_cheapest_meets_its_target_and_nothing_cheaper_does() -> None:
    found = assessed()
    for target in (1.0, 0.3, 0.1):
        point = found.cheapest(target, ["peak"])
        assert point is not None
        assert (point.error(["peak"]) or np.inf) <= target
        for other in found.points:
            error = other.error(["peak"])
            if other.choice.without is None and (other.record.loop or 0.0) < (point.record.loop or 0.0):
                assert error is not None
                assert error > target
    assert found.cheapest(1e-9, ["peak"]) is None


def test_the_rates_of_cells_and_steps_are_found_again() -> None:
    found = assessed()
    for knob, order in (("cells", 2.0), ("steps", 1.0)):
        fit = found.fit(knob, PEAK)  # type: ignore[arg-type]
        assert fit is not None
        assert fit.rate is not None
        assert fit.rate.order == pytest.approx(order, rel=1e-6)
        assert sum(fit.certain) >= 3


def test_points_that_failed_are_kept_with_their_reason() -> None:
    found = assessed(lambda choice: choice.steps == 2.0)
    failed = [point for point in found.points if not point.record.done]
    assert {point.choice.steps for point in failed} == {2.0}
    assert {point.record.reason for point in failed} == {"it snapped"}
    assert all(point.error(["peak"]) is None for point in failed)
    assert not any(point in failed for point in found.front(["peak"]))


def test_what_has_no_reference_is_told() -> None:
    found = assessed(lambda choice: choice.local == LAYER.tight)
    assert set(found.missing) == {"peak", "profiles"}
    assert found.quantities == []
    assert found.front([]) == []


def test_an_error_is_no_less_than_what_the_reference_can_tell() -> None:
    found = assessed()
    doubt = found.doubts["peak"]
    assert doubt > 0.0
    assert all((point.error(["peak"]) or np.inf) >= doubt for point in found.points)
    assert json.dumps(found.doubts)


# -- progress ----------------------------------------------------------------------------------------------------------


def test_the_forecast_learns_from_what_was_made() -> None:
    forecast = Forecast(START, record(1.0), dimension=1)
    finer, finest = replace(START, cells=2.0), replace(START, cells=4.0)
    assert forecast.seconds(finer) == pytest.approx(2.0 + 2.0)
    forecast.learn(Task(finer, 1), record(8.0))
    assert forecast.of(Task(finer, 2)) == pytest.approx(2.0 + 8.0)
    assert forecast.seconds(finest) == pytest.approx(2.0 + 4.0 * (1.0 + 8.0) / (1.0 + 2.0))
    assert forecast.patience(finest) == LEAST_PATIENCE


def test_what_failed_or_took_long_is_not_expected_again() -> None:
    forecast = Forecast(START, record(1.0), dimension=1)
    failed, slow = replace(START, cells=2.0), replace(START, cells=4.0)
    forecast.learn(Task(failed, 1), Record("stopped", "it snapped"))
    forecast.learn(Task(slow, 1), record(100.0))
    assert forecast.of(Task(failed, 2)) == forecast.of(Task(slow, 2)) == 0.0
    assert forecast.patience(slow) > 1000.0


def test_progress_on_a_terminal_is_a_bar_with_the_time_that_is_left() -> None:
    terminal = Console(file=io.StringIO(), force_terminal=True, width=120)
    with StudyProgress(terminal) as progress:
        progress.begin("the scene as it is")
        progress.end("the scene as it is", record(1.0), made=True)
        progress.plan([Task(START, 2)] * 3, Forecast(START, record(1.0), dimension=1))
        progress.begin("160 cells")
    assert isinstance(terminal.file, io.StringIO)
    painted = re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", terminal.file.getvalue())
    assert re.search(r"1 of 4 runs .* 160 cells .* about 9 s left", painted)
