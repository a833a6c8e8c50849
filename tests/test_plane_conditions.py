"""Conditions that a scene puts on the boundaries and points of a plane body, each against a number of its own."""

from typing import Any

import numpy as np
import pytest
from plane_sides import (
    FIELDS,
    HELD,
    SIDES,
    STEPS,
    UNDER_PRESSURE,
    WIDTH,
    at,
    compressed,
    forces,
    on_boundary,
)
from planes import D50, PRESSURE, build, run, stress, visits

from cosserat_fx.problem import Problem
from cosserat_fx.scenes.refusals import SceneError

# -- loads -------------------------------------------------------------------------------------------------------------


def test_a_dead_traction_keeps_its_force_and_a_pressure_its_stress() -> None:
    """After a fifth of shortening: p times the height at first, and as it is now."""
    height = 0.8 * WIDTH
    dead, follower = compressed({"t1": -PRESSURE}), compressed(UNDER_PRESSURE)
    assert forces(dead)["right"] == pytest.approx([-PRESSURE * WIDTH, 0.0], rel=1e-9, abs=1e-6)
    assert stress(dead, 0, 0) == pytest.approx(-PRESSURE / 0.8, rel=1e-7)
    assert forces(follower)["right"] == pytest.approx([-PRESSURE * height, 0.0], rel=1e-9, abs=1e-6)
    assert stress(follower, 0, 0) == pytest.approx(-PRESSURE, rel=1e-7)
    axial = stress(follower, 1, 1)[0]
    width = WIDTH + follower.boundary_mean("right", "u1")
    assert width > WIDTH
    assert forces(follower)["top"][1] == pytest.approx(axial * width, rel=1e-7)


def test_a_pressure_turns_with_its_boundary() -> None:
    """The force on a side that has turned is p times its chord, at right angles to it."""
    problem = run(
        {
            "boundaries": {
                "bottom": HELD,
                "top": {"u1": 0.004, "u2": 0.0, "w": 0.0},
                "left": UNDER_PRESSURE,
                "right": UNDER_PRESSURE,
            }
        }
    )
    lower, upper = (np.array([WIDTH, y]) for y in (0.0, WIDTH))
    chord = upper - lower + np.array([at(problem, field, upper) for field in FIELDS[:2]])
    assert chord[0] == pytest.approx(0.004)
    assert forces(problem)["right"] == pytest.approx(PRESSURE * np.array([-chord[1], chord[0]]), rel=1e-9)


def test_a_couple_traction_does_the_work_that_the_body_stores() -> None:
    """Nothing else works where all displacements of the boundary are held: the sum of mean couples times d(int w)."""
    couple, work, before = 5.0, 0.0, (0.0, 0.0)
    sides = dict.fromkeys(SIDES, HELD) | {"top": HELD | {"couple": [couple]}}
    for travel, problem in visits(build({"boundaries": sides})):
        places, fields = on_boundary(problem, "top")
        after = couple * travel / D50, float(np.trapezoid(fields[:, 2], places[:, 0]))
        work += (after[0] + before[0]) / 2 * (after[1] - before[1])
        before = after
    assert before[0] == pytest.approx(couple)
    assert before[1] > 0
    assert problem.boundary_forces()["top"]["couple"] == pytest.approx(couple * WIDTH, rel=1e-9)
    assert problem.internal_work == pytest.approx(work, rel=1e-6)


def test_rotational_resistance_leads_from_free_grains_to_held_ones() -> None:
    """A couple of -c w; sheared by a twentieth under a pressure on the sides."""

    def sheared(top: dict[str, float]) -> Problem:
        sides = {"bottom": HELD | {"w": 0.0}, "top": {"u1": 0.001, "u2": 0.0} | top}
        return run({"boundaries": sides | {"left": UNDER_PRESSURE, "right": UNDER_PRESSURE}})

    free, none, some, stiff, held = (
        sheared(top)
        for top in (
            {},
            {"rotational_resistance": 0.0},
            {"rotational_resistance": 100.0},
            {"rotational_resistance": 1e8},
            {"w": 0.0},
        )
    )
    shear = [forces(problem)["top"][0] for problem in (free, none, some, stiff, held)]
    assert shear[1] == pytest.approx(shear[0], rel=1e-9)
    assert shear[3] == pytest.approx(shear[4], rel=1e-5)
    assert shear[0] < shear[2] < shear[4]
    places, fields = on_boundary(some, "top")
    couple = -100.0 * np.trapezoid(fields[:, 2], places[:, 0])
    assert some.boundary_forces()["top"]["couple"] == pytest.approx(couple, rel=1e-9)


def test_weight_is_carried_by_the_bottom_and_stress_grows_with_depth() -> None:
    """s22 = -p - density g (h - y) at each level; density and height are those of the body before it settles."""
    density, gravity = 20000.0, 9.81
    body = build(
        {
            "geometry.cells": [2, 8],
            "weight": {"density": density, "gravity": gravity},
            "boundaries": {
                "bottom": {"u2": 0.0},
                "top": UNDER_PRESSURE,
                "left": {"symmetry": True},
                "right": {"symmetry": True},
            },
        }
    )
    *_, (_, problem) = visits(body)
    weight = density * gravity * WIDTH**2
    acting = forces(problem)
    assert acting["bottom"] == pytest.approx([0.0, weight + PRESSURE * WIDTH], rel=1e-8, abs=1e-6)
    assert sum(acting.values()) == pytest.approx([0.0, weight], abs=1e-7 * PRESSURE * WIDTH)
    depth = WIDTH - problem.state.coordinates[:, 1]
    assert stress(problem, 1, 1) == pytest.approx(-PRESSURE - density * gravity * depth, rel=1e-7)
    assert body.path.start == D50


@pytest.mark.parametrize("load", ["pressure", "t1"])
def test_loads_that_do_not_balance_the_initial_stress_are_brought_up_first(load: str) -> None:
    """Over d50 of travel, while displacements rest."""
    value = {"pressure": 1.5 * PRESSURE, "t1": -1.5 * PRESSURE}[load]
    sides = {"bottom": {"u2": 0.0}, "top": {"u2": -0.001}, "left": {"u1": 0.0}, "right": {load: value}}
    body = build({"boundaries": sides})
    assert body.path.corners == pytest.approx([0.0, D50, D50 + 0.001])
    states = {}
    for travel, problem in visits(body):
        states[round(travel, 12)] = problem.boundary_mean("top", "u2"), stress(problem, 0, 0).mean()
        if travel <= 0:
            expected = -PRESSURE * (1.5 + 0.5 * travel / D50)
            assert forces(problem)["right"][0] == pytest.approx(expected * WIDTH, rel=1e-8)
            assert stress(problem, 0, 0) == pytest.approx(expected, rel=1e-7)
    assert states[-D50][0] == states[0.0][0] == 0.0
    assert [states[-D50][1], states[0.0][1]] == pytest.approx([-PRESSURE, -1.5 * PRESSURE])
    assert states[0.001][0] == pytest.approx(-0.001)


# -- histories and points ----------------------------------------------------------------------------------------------


def test_histories_of_displacements() -> None:
    """A number is reached linearly in the first leg and held; a list at the ends of the legs."""
    sides = {
        "bottom": HELD,
        "top": {"u2": [-0.0004, 0.0, -0.0002], "u1": 0.0003},
        "left": UNDER_PRESSURE,
        "right": UNDER_PRESSURE,
    }
    body = build({"boundaries": sides})
    assert body.path.corners == pytest.approx([0.0, 0.0004, 0.0008, 0.001])
    for travel, problem in visits(body):
        expected = np.interp(travel, [0, 0.0004, 0.0008, 0.001], [0, -0.0004, 0, -0.0002])
        assert problem.boundary_mean("top", "u2") == pytest.approx(expected, abs=1e-15)
        assert problem.boundary_mean("top", "u1") == pytest.approx(min(1, travel / 0.0004) * 0.0003, abs=1e-15)


def test_histories_of_loads_and_tables() -> None:
    """A list of loads begins at what balances the body; a table's last value holds."""
    table = {"travel": [0.0, 0.0002, 0.0006], "value": [0.0, -0.0002, -0.0001]}
    sides = {
        "bottom": {"u2": 0.0},
        "top": {"u2": table},
        "left": {"u1": 0.0},
        "right": {"pressure": [1.2 * PRESSURE, 0.9 * PRESSURE]},
    }
    body = build({"boundaries": sides})
    assert body.path.corners == pytest.approx([0.0, 0.0002, 0.0006])
    for travel, problem in visits(body):
        height = WIDTH + problem.boundary_mean("top", "u2")
        assert height == pytest.approx(WIDTH + np.interp(travel, table["travel"], table["value"]), abs=1e-15)
        pressure = np.interp(travel, [0.0, 0.0002, 0.0006], [1.0, 1.2, 0.9]) * PRESSURE
        assert forces(problem)["right"][0] == pytest.approx(-pressure * height, rel=1e-9)


@pytest.mark.parametrize(("key", "axis"), [("t2", 1), ("t1", 0)])
def test_a_list_of_tractions_begins_at_what_balances_the_body(key: str, axis: int) -> None:
    """The normal one at the initial stress, the tangential one at nought."""
    end = -1.3 * PRESSURE if axis else 0.1 * PRESSURE
    top = {"t2": -PRESSURE} | {key: [end]}
    body = build({"boundaries": {"bottom": HELD, "top": top, "left": {"u1": 0.0}, "right": UNDER_PRESSURE}})
    start = -PRESSURE if axis else 0.0
    assert body.path.start == 0.0
    for travel, problem in visits(body):
        expected = (start + (end - start) * travel / D50) * WIDTH
        assert forces(problem)["top"][axis] == pytest.approx(expected, rel=1e-8, abs=1e-6)


def test_a_point_holds_the_node_next_to_it() -> None:
    points = {"pin": {"at": [0.0048, 0.0102], "u1": 0.0, "u2": 1e-4, "w": -0.02}}
    sides = dict.fromkeys(SIDES, UNDER_PRESSURE) | {"bottom": HELD}
    problem = run({"boundaries": sides, "points": points})
    assert [at(problem, field, (0.005, 0.01)) for field in FIELDS] == pytest.approx([0.0, 1e-4, -0.02], abs=1e-15)
    assert all(abs(at(problem, "u2", (x, 0.01))) < 5e-5 for x in (0.0, 0.01))


@pytest.mark.parametrize("first", ["top", "right"])
def test_where_boundaries_contradict_each_other_the_first_one_holds(first: str) -> None:
    sides = {"top": {"u1": 2e-4, "u2": 0.0}, "right": {"u1": 1e-4}}
    second = "right" if first == "top" else "top"
    others = {"bottom": HELD, "left": UNDER_PRESSURE}
    problem = run({"boundaries": {first: sides[first], second: sides[second], **others}})
    assert at(problem, "u1", (WIDTH, WIDTH)) == pytest.approx(sides[first]["u1"])
    assert at(problem, "u1", (WIDTH, WIDTH / 2)) == pytest.approx(1e-4)


# -- symmetry ----------------------------------------------------------------------------------------------------------


def platens(**sides: dict[str, Any]) -> dict[str, Any]:
    """Between rough platens."""
    return {"bottom": HELD | {"w": 0.0}, "top": {"u1": 0.0, "u2": -0.0006, "w": 0.0}, **sides}


def test_half_of_a_symmetric_body_is_as_good_as_the_whole() -> None:
    sides = platens(left=UNDER_PRESSURE, right=UNDER_PRESSURE)
    whole = run({"geometry.cells": [6, 6], "boundaries": sides, "stepping": STEPS})
    half = run(
        {
            "geometry.cells": [3, 6],
            "geometry.width": WIDTH / 2,
            "boundaries": platens(left={"symmetry": True}, right=UNDER_PRESSURE),
            "stepping": STEPS,
        }
    )
    assert 2 * forces(half)["top"][1] == pytest.approx(forces(whole)["top"][1], rel=1e-7)
    places, fields = on_boundary(half, "right")
    expected = np.array([[at(whole, field, (place[0] + WIDTH / 2, place[1])) for field in FIELDS] for place in places])
    assert np.abs(fields - expected).max() < 1e-7 * np.abs(expected).max()
    assert np.abs(expected[:, 2]).max() > 1e-3


# -- refusals ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("right", "refused"),
    [({}, True), ({"u2": 0.0}, True), ({"w": 0.0}, True), ({"t2": 0.0}, False), ({"u1": 0.0}, False)],
    ids=["nothing", "tangential", "rotation", "traction", "normal"],
)
def test_a_boundary_without_support_is_refused(right: dict[str, float], refused: bool) -> None:
    sides = {"bottom": HELD, "top": {"u2": -0.001}, "left": UNDER_PRESSURE, "right": right}
    if refused:
        with pytest.raises(SceneError, match=r"boundaries\.right is missing a condition normal to it"):
            build({"boundaries": sides})
    else:
        assert build({"boundaries": sides}).warnings


PUSHED = {name: {"pressure": [1.1 * PRESSURE]} for name in SIDES}
ALL_MOTIONS = "displacement along x1 and displacement along x2 and rotation"
LOOSE: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    ({}, {}, ALL_MOTIONS),
    ({"bottom": {"u2": 0.0}}, {}, "displacement along x1"),
    ({"left": {"u1": 0.0}}, {}, "displacement along x2"),
    ({}, {"pin": {"at": [0.0, 0.0], "u1": 0.0, "u2": 0.0}}, ALL_MOTIONS),
]
"""Nothing at all; what a smooth side leaves; a pin, about which a body turns, which is all three about its middle."""


@pytest.mark.parametrize(("sides", "points", "motions"), LOOSE, ids=["nothing", "smooth", "upright", "pin"])
def test_a_body_that_can_move_rigidly_is_refused(sides: dict[str, Any], points: dict[str, Any], motions: str) -> None:
    with pytest.raises(SceneError, match=f"nothing holds its {motions}: "):
        build({"boundaries": PUSHED | sides, "points": points})


@pytest.mark.parametrize("center", [False, True])
def test_springs_may_hold_a_body(center: bool) -> None:
    """A resistance to the rotation of grains keeps a pinned body from turning."""
    pin = {"at": [0.01, 0.01] if center else [0.0, 0.0], "u1": 0.0, "u2": 0.0}
    sides = PUSHED | {"left": {"pressure": [1.1 * PRESSURE], "rotational_resistance": 100.0}}
    body = build({"boundaries": sides, "points": {"pin": pin}})
    *_, (_, problem) = visits(body)
    assert stress(problem, 0, 0) == pytest.approx(-1.1 * PRESSURE, rel=1e-3)
