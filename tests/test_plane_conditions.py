"""Conditions that a scene puts on the boundaries and points of a plane body, each against a number of its own."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meshes import Mesh, quarter_ring, square
from planes import D50, PRESSURE, build, on_file, run, stress, visits

from cosserat_fx.conditions import Field
from cosserat_fx.plane import Plane
from cosserat_fx.problem import Problem
from cosserat_fx.scenes.refusals import SceneError
from cosserat_fx.typing import Array

WIDTH = 0.02
RADIUS = D50 / 2
SIDES = ("bottom", "top", "left", "right")
FIELDS: tuple[Field, ...] = ("u1", "u2", "w")
UNDER_PRESSURE = {"pressure": PRESSURE}
HELD = {"u1": 0.0, "u2": 0.0}
LOCALLY_EXACT = {"solver.local_tolerance": 1e-7}
STEPS = {"first_step": 5e-5, "max_step": 5e-5}


def on_boundary(problem: Problem, name: str) -> tuple[Array, Array]:
    """Reference coordinates (n, 2) of a boundary's nodes of linear elements, ordered along it, and their fields (n, 3).

    The mesh is the unit square's, mapped: nodes are found by the facets.
    """
    ends = np.unique(np.round(problem.geometry.facets(name)[0].reshape(-1, 2), 9), axis=0)
    values = [np.array([at(problem, field, place) for place in ends]) for field in FIELDS]
    return ends, np.stack(values, axis=1)


def at(problem: Problem, field: Field, place: Array | tuple[float, float]) -> float:
    """A field at the node of a place (m)."""
    nodes, values = problem.nodal_values(field)
    away = np.linalg.norm(nodes - place, axis=1)
    assert away.min() < 1e-8
    return float(values[away.argmin()])


def forces(problem: Problem) -> dict[str, Array]:
    """Both components of the force at each boundary (N/m)."""
    return {name: np.array([it["force1"], it["force2"]]) for name, it in problem.boundary_forces().items()}


def compressed(right: dict[str, Any], travel: float = 0.2 * WIDTH) -> Problem:
    """Shortened by a fifth between smooth plates; the right side moves under a load."""
    sides = {"bottom": {"u2": 0.0}, "top": {"u2": -travel}, "left": {"u1": 0.0}, "right": right}
    return run({"boundaries": sides})


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


# -- walls -------------------------------------------------------------------------------------------------------------


def between_walls(wall: dict[str, Any], bottom: dict[str, Any] | None = None) -> dict[str, Any]:
    """A wall at the top, and by default a very rough one at rest at the bottom."""
    return {
        "bottom": {"wall": bottom or {"rolling": 0.0}},
        "top": {"wall": wall},
        "left": UNDER_PRESSURE,
        "right": UNDER_PRESSURE,
    }


def test_grains_at_a_wall_follow_it_turn_and_lag_behind() -> None:
    """f_u u_b along the wall, w = -(f_r u_b)/(d50/2) above the grains and the opposite below."""
    wall = {"f_u": 0.8, "f_r": 0.05, "f_s": 0.15}
    problem = run({"boundaries": between_walls(wall | {"u1": 4e-4, "u2": -1e-4}, wall | {"u1": -2e-4})})
    _, top = on_boundary(problem, "top")
    _, bottom = on_boundary(problem, "bottom")
    assert top == pytest.approx(np.tile([0.8 * 4e-4, -1e-4, -0.05 * 4e-4 / RADIUS], (5, 1)))
    assert bottom == pytest.approx(np.tile([-0.8 * 2e-4, 0.0, -0.05 * 2e-4 / RADIUS], (5, 1)))


@pytest.mark.parametrize(("side", "outward"), [("left", -1), ("right", 1)])
def test_upright_walls_turn_grains_the_other_way(side: str, outward: int) -> None:
    """t = (n2, -n1): a right wall that moves down turns the grains beside it to the right."""
    sides = dict.fromkeys(SIDES, UNDER_PRESSURE) | {"bottom": HELD}
    problem = run({"boundaries": sides | {side: {"wall": {"rolling": 0.1, "u2": -2e-4}}}})
    places, fields = on_boundary(problem, side)
    above = fields[places[:, 1] > 0]
    assert above[:, 0] == pytest.approx(0.0)
    assert above[:, 1] == pytest.approx(-2e-4)
    assert above[:, 2] == pytest.approx(-outward * 0.1 * 2e-4 / RADIUS)


def test_a_wall_under_pressure_shears_a_body_that_may_swell() -> None:
    """The pressure acts on the width; what holds the wall tangentially is the shear force at the bottom."""
    wall = {"rolling": 0.02, "u1": 6e-4, "pressure": PRESSURE}
    problem = run({"boundaries": between_walls(wall)})
    acting = forces(problem)
    places, fields = on_boundary(problem, "top")
    chord = places[-1] + fields[-1, :2] - places[0] - fields[0, :2]
    assert np.ptp(fields[:, 1]) > 0
    assert acting["top"][1] == pytest.approx(-PRESSURE * chord[0], rel=1e-8)
    assert fields[:, 0] == pytest.approx(6e-4)
    assert fields[:, 2] == pytest.approx(-0.02 * 6e-4 / RADIUS)
    assert sum(acting.values()) == pytest.approx([0.0, 0.0], abs=1e-6 * PRESSURE * WIDTH)


def test_grains_roll_with_their_own_displacement_at_a_free_wall() -> None:
    """w = -rolling u_t/(d50/2), and the tie does no work: its force is rolling/(d50/2) times its couple."""
    rolling = 0.05
    sides = between_walls({"rolling": rolling, "u2": -4e-4, "free": True}) | {"right": {"t1": -0.9 * PRESSURE}}
    problem = run({"boundaries": sides})
    _, fields = on_boundary(problem, "top")
    assert fields[:, 1] == pytest.approx(-4e-4)
    assert np.ptp(fields[:, 0]) > 1e-5
    tied = -rolling * fields[:, 0] / RADIUS
    assert fields[:, 2] == pytest.approx(tied, abs=1e-4 * np.abs(tied).max())
    acting = problem.boundary_forces()["top"]
    assert acting["force1"] == pytest.approx(rolling / RADIUS * acting["couple"], rel=1e-9)


INCLINED: dict[str, dict[str, Any]] = {
    "held": {"rolling": 0.05, "u1": 3e-4, "u2": -2e-4},
    "sliding": {"f_u": 0.7, "f_r": 0.1, "f_s": 0.2, "u1": 4e-4, "u2": -1e-4},
    "pressure": {"rolling": 0.05, "u1": 4e-4, "pressure": PRESSURE},
    "free": {"rolling": 0.05, "u2": -3e-4, "free": True},
}
TILT = np.array([[np.sqrt(3), -1], [1, np.sqrt(3)]]) / 2
"""By 30 degrees to the left."""


@pytest.mark.parametrize(
    ("name", "element"), [*((name, "Q1R") for name in INCLINED), ("pressure", "Q2Q1"), ("free", "Q2Q1")]
)
def test_an_inclined_scene_has_the_inclined_answer(name: str, element: str, tmp_path: Path) -> None:
    """Ties and prescribed values that mix the components do what the components alone do.

    What springs hold gives way a little. The law's own error is measured component by component.
    """
    problems = []
    for turn in (np.eye(2), TILT):
        wall = INCLINED[name]
        moves = turn @ [wall.get("u1", 0.0), wall.get("u2", 0.0)]
        top = wall | {f"u{i + 1}": {"travel": [0.0, 4e-4], "value": [0.0, move]} for i, move in enumerate(moves)}
        mesh = square(4, 4)
        mesh.points = mesh.points @ turn.T
        loaded = between_walls(top) | {"right": {"pressure": [0.9 * PRESSURE]}}
        scene = {"boundaries": loaded, "stepping": STEPS, **LOCALLY_EXACT, "solver.element": element}
        problems.append(run(on_file(tmp_path / "mesh.msh", mesh) | scene))
    upright, inclined = problems
    places = upright.nodal_values("w")[0]
    fields = np.array([[at(upright, field, place) for field in FIELDS] for place in places])
    found = np.array([[at(inclined, field, TILT @ place) for field in FIELDS] for place in places])
    expected = np.column_stack([fields[:, :2] @ TILT.T, fields[:, 2]])
    error = np.abs(found - expected).max(axis=0) / ([np.abs(fields[:, :2]).max()] * 2 + [np.abs(fields[:, 2]).max()])
    assert error.max() < (1e-4 if name in ("pressure", "free") else 1e-6)
    for side in SIDES:
        assert forces(inclined)[side] == pytest.approx(TILT @ forces(upright)[side], abs=1e-4 * PRESSURE * WIDTH)


def ring(tmp_path: Path, boundaries: dict[str, Any], **others: Any) -> Plane:
    """A quarter of a ring between the radii 2 cm and 4 cm: "left" is its inner side."""
    mesh: Mesh = square(5, 9, shape=quarter_ring)
    return build(on_file(tmp_path / "ring.msh", mesh) | {"boundaries": boundaries, **others})


def test_a_curved_wall_carries_its_grains_along_its_normal_and_turns_them(tmp_path: Path) -> None:
    """u = (n n + f_u t t) u_b and w = -f_r t u_b/(d50/2) with n = -(cos, sin) on a hole's side."""
    moves = np.array([2e-4, 1e-4])
    wall = {"f_u": 0.6, "f_r": 0.1, "f_s": 0.3, "u1": moves[0], "u2": moves[1]}
    sides = {"left": {"wall": wall}, "right": UNDER_PRESSURE, "bottom": UNDER_PRESSURE, "top": UNDER_PRESSURE}
    body = ring(tmp_path, sides)
    *_, (_, problem) = visits(body)
    places, fields = on_boundary(problem, "left")
    normals = -places / np.linalg.norm(places, axis=1, keepdims=True)
    tangents = np.stack([normals[:, 1], -normals[:, 0]], axis=1)
    along, across = tangents @ moves, normals @ moves
    expected = np.column_stack([across[:, None] * normals + 0.6 * along[:, None] * tangents, -0.1 * along / RADIUS])
    inner = np.all(places > 1e-6, axis=1)  # the nodes at the ends have the normals of one facet
    assert inner.sum() == len(places) - 2
    assert fields[inner] == pytest.approx(expected[inner], rel=1e-6, abs=1e-12)


def test_a_curved_plane_of_symmetry_lets_grains_slide_along_it_but_not_through(tmp_path: Path) -> None:
    """Pressure on one end pushes a ring around a smooth core; its facets' own normals would hold each of its nodes."""
    sides = {
        "left": {"symmetry": True},
        "right": UNDER_PRESSURE,
        "bottom": {"u2": 0.0},
        "top": {"pressure": [1.5 * PRESSURE]},
    }
    *_, (_, problem) = visits(ring(tmp_path, sides))
    places, fields = on_boundary(problem, "left")
    inner = np.all(places > 1e-6, axis=1)
    radial = places / np.linalg.norm(places, axis=1, keepdims=True)
    through, slip = (np.sum(fields[:, :2] * n, axis=1) for n in (radial, radial[:, ::-1] * [1, -1]))
    assert np.abs(through[inner]).max() < 1e-4 * slip.max()
    assert np.all(fields[:, 2] == 0.0)
    assert np.all(np.diff(slip) < 0)
    assert np.all(np.abs(np.diff(slip)) < 0.3 * slip.max())
    assert abs(slip[-1]) < 1e-12


def annulus(cells: int) -> Mesh:
    """A ring between the radii 1 and 2, as many cells around."""
    angles = 2 * np.pi * np.arange(cells) / cells
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    here = np.arange(cells)
    there = np.roll(here, -1)
    sides = {"core": np.stack([here, there], axis=1), "shell": np.stack([here, there], axis=1) + cells}
    around = np.stack([here, here + cells, there + cells, there], axis=1)
    return Mesh(np.concatenate([circle, 2 * circle]), around, sides, {"all": here})


@pytest.mark.parametrize("element", ["Q1R", "Q2Q1"])
@pytest.mark.parametrize("side", ["core", "shell"])
@pytest.mark.parametrize(
    "smooth", [{"symmetry": True}, {"wall": {"rolling": 0.0, "free": True}}], ids=["symmetry", "wall"]
)
def test_a_smooth_core_or_shell_lets_a_ring_turn(
    element: str, side: str, smooth: dict[str, Any], tmp_path: Path
) -> None:
    """It holds all but the rotation, which grains without rotations of their own do not resist."""
    sides = {name: {"pressure": [1.1 * PRESSURE]} for name in ("core", "shell")} | {side: smooth}
    mesh = on_file(tmp_path / "annulus.msh", annulus(12), 0.005)
    with pytest.raises(SceneError, match="nothing holds its rotation: "):
        build(mesh | {"boundaries": sides, "effects.polar": False, "solver.element": element})


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
