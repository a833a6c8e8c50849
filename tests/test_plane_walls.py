"""Walls and curved planes of symmetry of a plane body, each against a number of its own."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meshes import Mesh, quarter_ring, square
from plane_sides import (
    FIELDS,
    HELD,
    LOCALLY_EXACT,
    RADIUS,
    SIDES,
    STEPS,
    UNDER_PRESSURE,
    WIDTH,
    at,
    forces,
    on_boundary,
)
from planes import PRESSURE, build, on_file, run, visits

from cosserat_fx.plane import Plane
from cosserat_fx.scenes.refusals import SceneError


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
