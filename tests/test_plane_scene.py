import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st
from scenes import (
    ABSENT,
    RECTANGLE,
    Mutation,
    assert_scene_or_clear_refusal,
    changed,
    mutations,
    parse_plane,
    to_toml,
)

from cosserat_fx.scene import PlaneScene, SceneError, load_scene, parse_scene
from cosserat_fx.scenes.histories import HistoryTable
from cosserat_fx.scenes.plane import MeshGeometry, RectangleGeometry

BIAXIAL = """
title = "Biaxial compression"
[geometry]
kind = "rectangle"
width = 0.04
height = 0.14
cells = [16, 56]
[material]
d50 = 1e-3
[initial]
stress = -100e3
void_ratio = 0.6
[[initial.zones]]
x = [0.0, 0.0025]
y = [0.075, 0.0775]
void_ratio = 0.7
[boundaries.bottom]
u2 = 0.0
[boundaries.top]
u2 = -0.01
[boundaries.left]
pressure = 100e3
[boundaries.right]
pressure = 100e3
[points.pin]
at = [0.0, 0.0]
u1 = 0.0
[output]
fields_at = [0.003, 0.005]
[output.columns.axial_stress_Pa]
boundary = "top"
quantity = "force2"
factor = -25.0
"""
D50 = 0.5e-3
FRACTIONS = {"f_u": 0.8, "f_r": 0.15, "f_s": 0.05}


@pytest.fixture
def mesh_file(tmp_path: Path) -> Path:
    path = tmp_path / "body.msh"
    path.touch()
    return path


def mesh_scene(file: object, changes: Mapping[str, object] | None = None) -> dict[str, Any]:
    """The least scene of a mesh with some keys changed."""
    return changed({"geometry": {"kind": "mesh", "file": str(file)}, **(changes or {})})


# -- what a scene says -------------------------------------------------------------------------------------------------


def test_a_plane_scene_reads_as_written(tmp_path: Path) -> None:
    path = tmp_path / "biaxial.toml"
    path.write_text(BIAXIAL)
    scene = load_scene(path)
    assert isinstance(scene, PlaneScene)
    assert isinstance(scene.geometry, RectangleGeometry)
    assert (scene.geometry.width, scene.geometry.height, scene.geometry.cells) == (0.04, 0.14, (16, 56))
    (zone,) = scene.initial.zones
    assert (zone.x, zone.y, zone.void_ratio) == ((0.0, 0.0025), (0.075, 0.0775), 0.7)
    assert {name: boundary.model_dump(exclude_none=True) for name, boundary in scene.boundaries.items()} == {
        "bottom": {"u2": 0.0, "symmetry": False},
        "top": {"u2": -0.01, "symmetry": False},
        "left": {"pressure": 100e3, "symmetry": False},
        "right": {"pressure": 100e3, "symmetry": False},
    }
    assert (scene.points["pin"].at, scene.points["pin"].u1, scene.points["pin"].u2) == ((0.0, 0.0), 0.0, None)
    assert scene.output.fields_at == (0.003, 0.005)
    column = scene.output.columns["axial_stress_Pa"]
    assert (column.boundary, column.quantity, column.factor) == ("top", "force2", -25.0)


def test_what_a_plane_scene_leaves_out_is_filled_in() -> None:
    scene = parse_plane(RECTANGLE)
    assert isinstance(scene.geometry, RectangleGeometry)
    assert (scene.geometry.grading.x, scene.geometry.grading.y) == (None, None)
    assert (scene.initial.zones, scene.initial.random, scene.initial.field) == ((), None, None)
    assert (scene.weight, scene.stepping.branch) == (None, None)
    assert (scene.solver.element, scene.solver.hourglass) == ("auto", 0.005)
    output = scene.output
    assert (output.fields_at, output.frames, output.columns) == ((0.01,), 40, {})
    assert (output.fields, output.figures, output.animation) == (True, True, True)


EVERYTHING: dict[str, object] = {
    "geometry.grading": {"x": {"fine": "ends", "ratio": 2}, "y": {"fine": "bottom", "ratio": 4.0}},
    "initial.zones": [
        {"x": [0.0, 0.01], "y": [0.0, 0.01], "void_ratio": 0.7},
        {"centre": [0.02, 0.07], "radius": 0.01, "void_ratio": 0.65},
    ],
    "initial.random": {"standard_deviation": 0.01, "correlation_length_d50": 4.0, "seed": 1},
    "boundaries.top": {"u2": {"travel": [0, 0.01, 0.02], "value": [0, -0.01, 0]}, "t1": [10.0, 20.0], "couple": 1.0},
    "boundaries.bottom": {"wall": {"rolling": 0.1, "u1": [0.0, 0.01]}},
    "boundaries.left": {"symmetry": True},
    "boundaries.right": {"pressure": 100e3, "rotational_resistance": 10.0},
    "points.pin": {"at": [0.02, 0.07], "w": 0.0},
    "weight.density": 1600,
    "stepping.branch": "primary",
    "solver.element": "Q2Q1",
    "output": {"frames": 0, "columns": {"shear_Pa": {"boundary": "top", "quantity": "force1"}}},
}


@pytest.mark.parametrize("changes", [{}, EVERYTHING, {"boundaries.left": {"wall": {**FRACTIONS, "free": True}}}])
def test_a_plane_scene_survives_a_round_trip_through_toml_and_json(changes: dict[str, object], tmp_path: Path) -> None:
    scene = parse_scene(changed(changes))
    path = tmp_path / "again.toml"
    path.write_text(to_toml(scene.as_dict()))
    assert load_scene(path) == scene
    assert parse_scene(json.loads(json.dumps(scene.as_dict()))) == scene


@pytest.mark.parametrize(
    ("given", "read"),
    [
        (1, 1.0),
        ([1], (1.0,)),
        ({"travel": [0, 1], "value": [0, 2]}, HistoryTable(travel=(0.0, 1.0), value=(0.0, 2.0))),
    ],
)
def test_histories_keep_their_spelling(given: object, read: object) -> None:
    assert parse_plane(changed({"boundaries.top.u2": given})).boundaries["top"].u2 == read


# -- the path ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "lengths"),
    [
        ({}, [0.01]),
        ({"boundaries.top.u2": [-0.01, 0.005]}, [0.01, 0.015]),
        ({"boundaries.top.u2": [-0.01, -0.01, 0.0]}, [0.01, D50, 0.01]),
        ({"boundaries.top.u2": [-0.01, -0.02], "boundaries.bottom.u1": 0.03}, [0.03, 0.01]),
        ({"boundaries.top.u2": 0.0, "boundaries.top.w": 0.5}, [D50]),
        ({"boundaries.top": {"pressure": [200e3, 300e3]}}, [D50, D50]),
        ({"boundaries.top": {"wall": {"u2": -0.01, "u1": 0.02}}}, [0.02]),
        ({"points.tip": {"at": [0, 0], "u1": [0.02, 0.05]}}, [0.02, 0.03]),
        ({"boundaries.top.u2": {"travel": [0, 1, 3], "value": [0, -0.01, 0.01]}}, [1, 2]),
        (
            {
                "boundaries.top.u2": {"travel": [0, 1, 3], "value": [0, -0.01, 0.01]},
                "boundaries.right.pressure": {"travel": [0, 2], "value": [1e5, 2e5]},
            },
            [1, 1, 1],
        ),
        ({"boundaries.top.u2": {"travel": [0, 1, 1 + 1e-12], "value": [0, -0.01, 0.01]}}, [1]),
    ],
)
def test_a_leg_is_as_long_as_its_largest_change_or_as_tables_say(
    changes: dict[str, object], lengths: Sequence[float]
) -> None:
    scene = parse_plane(changed(changes))
    assert scene.legs == len(lengths)
    assert scene.leg_lengths == pytest.approx(lengths)
    assert scene.travel == pytest.approx(sum(lengths))
    assert scene.output.fields_at == pytest.approx([sum(lengths[: leg + 1]) for leg in range(len(lengths))])


@settings(max_examples=50, deadline=None)
@drawn(st.lists(st.integers(-500, 500).filter(bool).map(lambda it: 1e-4 * it), min_size=1, max_size=5, unique=True))
def test_a_list_and_the_table_of_its_targets_over_the_travel_are_one_path(targets: list[float]) -> None:
    by_list = parse_plane(changed({"boundaries.top.u2": targets}))
    travel = [0.0]
    for length in by_list.leg_lengths:
        travel.append(travel[-1] + length)
    by_table = parse_plane(changed({"boundaries.top.u2": {"travel": travel, "value": [0.0, *targets]}}))
    assert by_table.leg_lengths == pytest.approx(by_list.leg_lengths)
    assert by_table.largest_displacement == pytest.approx(by_list.largest_displacement)
    assert by_list.largest_displacement == max(abs(target) for target in targets)


@pytest.mark.parametrize(
    ("changes", "largest"),
    [
        ({}, 0.01),
        ({"boundaries.bottom.u2": 0.01}, 0.02),
        ({"boundaries.bottom.u2": -0.01}, 0.0),
        ({"boundaries.bottom": ABSENT}, 0.01),
        ({"boundaries.bottom": {"symmetry": True}}, 0.01),
        ({"boundaries.top.u2": [-0.01, 0.0]}, 0.01),
        ({"boundaries.top.u1": 0.03}, 0.03),
        ({"boundaries.top": {"wall": {"u1": 0.03}}}, 0.03),
        ({"points.tip": {"at": [0, 0], "u2": 0.03}}, 0.04),
        ({"boundaries.top.u2": {"travel": [0, 1, 2], "value": [0, -0.04, 0]}}, 0.04),
    ],
)
def test_the_largest_displacement_is_relative(changes: dict[str, object], largest: float) -> None:
    assert parse_plane(changed(changes)).largest_displacement == pytest.approx(largest)


def test_rounding_does_not_keep_a_field_from_the_end_of_a_leg() -> None:
    scene = parse_plane(changed({"boundaries.top.u2": [0.1, 0.3], "output.fields_at": [0.1 * 3 - 0.2, 0.1 + 0.2]}))
    assert scene.output.fields_at == (0.1, sum(scene.leg_lengths))


# -- files -------------------------------------------------------------------------------------------------------------


def test_files_are_found_from_the_folder_of_the_scene(mesh_file: Path) -> None:
    (mesh_file.parent / "field.csv").touch()
    path = mesh_file.parent / "scene.toml"
    path.write_text(to_toml(mesh_scene("body.msh", {"geometry.scale": 1e-3, "initial.field": {"file": "field.csv"}})))
    scene = load_scene(path)
    assert isinstance(scene.geometry, MeshGeometry)
    assert (scene.geometry.file, scene.geometry.scale) == (str(mesh_file), 1e-3)
    assert scene.initial.field is not None
    assert scene.initial.field.file == str(mesh_file.parent / "field.csv")
    assert parse_scene(scene.as_dict()) == scene


def test_a_boundary_whose_name_no_column_could_have_is_refused(mesh_file: Path) -> None:
    with pytest.raises(SceneError, match="must be named by characters that can be printed"):
        parse_scene(mesh_scene(mesh_file) | {"boundaries": {"to\np": {"u2": -0.001}}})


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(to_toml(mesh_scene("body.msh", {"initial.field": {"file": "no\0where"}})))
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    mesh, field = str(caught.value).splitlines()
    assert mesh.startswith('geometry.file = "body.msh": must be a file, relative to the folder of the scene')
    assert mesh.endswith(f"there is none at {tmp_path / 'body.msh'}")
    assert field.startswith(r'initial.field.file = "no\u0000where": must be a file')


def test_what_only_the_mesh_knows_is_left_to_it(mesh_file: Path) -> None:
    changes = {
        "boundaries.skin": {"u1": 0.0, "pressure": 100e3},
        "initial.zones": [{"region": "core", "void_ratio": 0.7}, {"x": [7, 8], "void_ratio": 0.7}],
        "points.far": {"at": [70.0, -70.0], "w": 0.0},
        "solver.element": "P2P1",
        "output.columns.force_N": {"boundary": "hull", "quantity": "force1"},
    }
    assert set(parse_plane(mesh_scene(mesh_file, changes)).boundaries) == {*RECTANGLE["boundaries"], "skin"}


# -- refusals ----------------------------------------------------------------------------------------------------------

HISTORY = "must be a finite number, a list of 1 to 100000 finite numbers or a table with the keys travel, value (m)"
BAD_INPUT: list[tuple[dict[str, object], str, str]] = [
    # keys of other kinds, and of none
    (
        {"walls": {"top": {}}},
        "walls = {top = {...}}",
        'only geometry.kind = "layer" has this key; plane bodies have bou',
    ),
    (
        {"solver.integration_points": 2},
        "solver.integration_points = 2",
        'only geometry.kind = "layer" has this key. The',
    ),
    ({"output.profiles_at": 0.1}, "output.profiles_at = 0.1", 'only geometry.kind = "layer" has this key. The keys he'),
    ({"geometry.file": "a"}, 'geometry.file = "a"', 'must be left out, as only geometry.kind = "mesh" has this key'),
    (
        {"boundaries.top.u3": 1},
        "boundaries.top.u3 = 1",
        "unknown key. The keys here are u1, u2, w, t1, t2, couple",
    ),
    ({"boundaries.top.wall": {"roling": 0}}, "boundaries.top.wall.roling = 0", "did you mean rolling?"),
    ({"points.pin": {"at": [0, 0], "t1": 0}}, "points.pin.t1 = 0", "unknown key"),
    (
        {"boundaries.tøp.u2": 1},
        'boundaries."t\\u00f8p" = {u2 = 1.0}',
        "must name a boundary of the rectangle: bottom, to",
    ),
    # types and ranges
    ({"geometry.cells": 80}, "geometry.cells = 80", "a list of 2 whole numbers of at least 1 and at most 10000000"),
    ({"geometry.cells": [80]}, "geometry.cells[1] is missing", "a list of 2 whole numbers"),
    ({"geometry.cells": [80, 0]}, "geometry.cells[1] = 0", "a list of 2 whole numbers of at least 1"),
    ({"geometry.cells": [4000, 4000]}, "geometry.cells = [4000, 4000]", "at most 10000000 cells in all"),
    ({"geometry.width": ABSENT}, "geometry.width is missing", "must be a finite number greater than 0 (m)"),
    ({"geometry.grading": {"x": {"fine": "left", "ratio": 0.5}}}, "geometry.grading.x.ratio = 0.5", "of at least 1"),
    (
        {"geometry.grading": {"x": {"fine": "top", "ratio": 2}}},
        'geometry.grading.x.fine = "top"',
        '"left", "right", "c',
    ),
    ({"geometry.grading": {"y": {"fine": "left", "ratio": 2}}}, 'geometry.grading.y.fine = "left"', '"bottom", "top"'),
    ({"boundaries": 3}, "boundaries = 3", "must be a table"),
    ({"boundaries.top": 3}, "boundaries.top = 3", "must be a table with the keys u1, u2, w, t1, t2, couple, pressure"),
    ({"boundaries.top.u2": "far"}, 'boundaries.top.u2 = "far"', HISTORY),
    ({"boundaries.top.u2": True}, "boundaries.top.u2 = true", HISTORY),
    ({"boundaries.top.u2": [1, "far"]}, 'boundaries.top.u2[1] = "far"', HISTORY),
    ({"boundaries.top.u2": []}, "boundaries.top.u2 = []", HISTORY),
    ({"boundaries.top": {"pressure": "a"}}, 'boundaries.top.pressure = "a"', "(Pa, compression positive)"),
    (
        {"boundaries.top.rotational_resistance": -1},
        "boundaries.top.rotational_resistance = -1",
        "of at least 0 (N/m per",
    ),
    ({"weight": {"density": 0}}, "weight.density = 0", "greater than 0 (kg/m3)"),
    ({"solver.element": "Q3"}, 'solver.element = "Q3"', '"auto", "Q1R", "Q1", "Q2Q1", "P1" or "P2P1"'),
    ({"solver.hourglass": -1}, "solver.hourglass = -1", "of at least 0"),
    ({"stepping.branch": "any"}, 'stepping.branch = "any"', 'must be "stable" or "primary"'),
    ({"solver.element": "P1"}, 'solver.element = "P1"', '"Q1R", "Q1", "Q2Q1" or "auto" on a mesh of quad'),
    # histories
    (
        {"boundaries.top.u2": {"travel": [0, 1]}},
        "boundaries.top.u2.value is missing",
        "a list of 2 to 100000 finite num",
    ),
    (
        {"boundaries.top.u2": {"travel": 1, "value": [0, 1]}},
        "boundaries.top.u2.travel = 1",
        "a list of 2 to 100000 finite n",
    ),
    ({"boundaries.top.u2": {"travel": [1, 2], "value": [0, 1]}}, "boundaries.top.u2.travel[0] = 1.0", "must be 0"),
    (
        {"boundaries.top.u2": {"travel": [0, 2, 2], "value": [0, 1, 2]}},
        "boundaries.top.u2.travel[2] = 2.0",
        "greater th",
    ),
    (
        {"boundaries.top.u2": {"travel": [0, 2], "value": [0, 1, 2]}},
        "boundaries.top.u2.value = [",
        "as many entries as",
    ),
    (
        {"boundaries.top.u2": {"travel": [0, 2], "value": [1, 2]}},
        "boundaries.top.u2.value[0] = 1.0",
        "starts undeformed",
    ),
    (
        {"boundaries.top.u2": {"travel": [0, 2], "value": [0, 2], "travels": 3}},
        "boundaries.top.u2.travels = 3",
        "unknown key, did you mean travel? The keys here are travel, value",
    ),
    (
        {"boundaries.top.u2": [1, 2], "boundaries.right.pressure": [1, 2, 3]},
        "boundaries.right.pressure = [1.0, 2.0, 3.0]",
        "one entry for each leg of the path: boundaries.top.u2 has 2, and not 3",
    ),
    (
        {"boundaries.top.u2": {"travel": [0, 1, 2], "value": [0, 1, 2]}, "boundaries.top.u1": [1, 2, 3]},
        "boundaries.top.u1 = [1.0, 2.0, 3.0]",
        "the travels of the tables make 2, and not 3",
    ),
    ({"boundaries.top.u2": [1e308, -1e308]}, "boundaries.top.u2 = [1e+308, -1e+308]", "no finite length"),
    (
        {"boundaries.top.u2": 0},
        "boundaries = {bottom = {...}, top = {...}, left = {...}, right = {...",
        "nothing would happen",
    ),
    ({"boundaries": ABSENT}, "boundaries is missing", "nothing would happen"),
    ({"boundaries": {"top": {"pressure": 100e3}}}, "boundaries = {top = {...}}", "does not balance initial.stress"),
    # contradictions
    ({"boundaries.top.t2": 1}, "boundaries.top.t2 = 1.0", "left out where u2 is given"),
    ({"boundaries.top": {"u1": 0, "t1": 1}}, "boundaries.top.t1 = 1.0", "left out where u1 is given"),
    (
        {"boundaries.top.symmetry": True},
        "boundaries.top.symmetry = true",
        "left out where u2 is given, as symmetry says",
    ),
    ({"boundaries.top": {"t1": 0, "symmetry": True}}, "boundaries.top.symmetry = true", "left out where t1 is given"),
    ({"boundaries.top": {"t1": 0, "pressure": 1}}, "boundaries.top.pressure = 1.0", "left out where t1 is given"),
    (
        {"boundaries.top": {"u1": 0, "u2": 0, "pressure": 1}},
        "boundaries.top.pressure = 1.0",
        "where u1 and u2 are given",
    ),
    ({"boundaries.top.pressure": 1}, "boundaries.top.pressure = 1.0", "where u2 is given, the displacement normal to"),
    ({"boundaries.left": {"u1": 0, "pressure": 1}}, "boundaries.left.pressure = 1.0", "where u1 is given"),
    ({"boundaries.top": {"w": 0, "couple": 0}}, "boundaries.top.couple = 0.0", "left out where w is given"),
    (
        {"boundaries.top": {"w": 0, "rotational_resistance": 1}},
        "boundaries.top.rotational_resistance = 1",
        "where w is",
    ),
    ({"boundaries.top.wall": {}}, "boundaries.top.wall = {", "left out where u2 is given, as a wall says all"),
    ({"boundaries.top": {"wall": {}, "symmetry": True}}, "boundaries.top.wall = {", "left out where symmetry is given"),
    ({"boundaries.top": {"wall": {"rolling": 1, **FRACTIONS}}}, "boundaries.top.wall.rolling = 1", "must be left out"),
    (
        {"boundaries.top": {"wall": {"f_u": 1}}},
        "boundaries.top.wall.f_r is missing",
        "the other two of f_u, f_r and f_s",
    ),
    ({"boundaries.top": {"wall": {"u2": 1, "pressure": 1}}}, "boundaries.top.wall.u2 = 1.0", "must be 0"),
    ({"boundaries.top": {"wall": {"u1": 1, "free": True}}}, "boundaries.top.wall.u1 = 1.0", "must be 0"),
    ({"points.pin": {"at": [0, 0]}}, "points.pin.u1 is missing", "unless u2 or w is"),
    # without rotations
    ({"effects.polar": False, "boundaries.top.w": 1}, "boundaries.top.w = 1.0", "where effects.polar = false"),
    (
        {"effects.polar": False, "boundaries.top.couple": 1},
        "boundaries.top.couple = 1.0",
        "where effects.polar = false",
    ),
    ({"effects.polar": False, "points.a": {"at": [0, 0], "w": 1}}, "points.a.w = 1.0", "where effects.polar = false"),
    (
        {"effects.polar": False, "boundaries.left": {"wall": {"rolling": 1}}},
        "boundaries.left.wall.rolling = 1",
        "where effects.polar = false",
    ),
    (
        {"effects.polar": False, "output.columns.a": {"boundary": "top", "quantity": "w"}},
        'output.columns.a.quantity = "w"',
        "where effects.polar = false",
    ),
    # places
    (
        {"points.pin": {"at": [0, 0.15], "u1": 0}},
        "points.pin.at = [0.0, 0.15]",
        "must lie in the rectangle, [0, 0] to [0",
    ),
    ({"points.pin": {"at": [0, 0, 0], "u1": 0}}, "points.pin.at = [0, 0, 0]", "must be a list of 2 finite numbers (m)"),
    ({"initial.zones": {"x": [0, 1]}}, "initial.zones = {x = [...]}", "must be a list of tables with the keys x, y, c"),
    (
        {"initial.zones": [{"void_ratio": 0.7}]},
        "initial.zones[0] = {void_ratio = 0.7}",
        "must say where: x and/or y, cen",
    ),
    ({"initial.zones": [{"x": [1, 0], "void_ratio": 0.7}]}, "initial.zones[0].x = [1.0, 0.0]", "ascending"),
    (
        {"initial.zones": [{"x": [0.05, 1], "void_ratio": 0.7}]},
        "initial.zones[0].x = [0.05, 1.0]",
        "reach into the body",
    ),
    ({"initial.zones": [{"x": [0, 1]}]}, "initial.zones[0].void_ratio is missing", "greater than 0"),
    (
        {"initial.zones": [{"x": [0, 1], "void_ratio": 1.2}]},
        "initial.zones[0].void_ratio = 1.2",
        "less than e_i = 1.112",
    ),
    (
        {"initial.zones": [{"region": "a", "void_ratio": 0.7}]},
        'initial.zones[0].region = "a"',
        "only meshes from files",
    ),
    (
        {"initial.zones": [{"radius": 1, "void_ratio": 0.7}]},
        "initial.zones[0].centre is missing",
        "a centre and a radi",
    ),
    (
        {"initial.zones": [{"centre": [0, 0], "void_ratio": 0.7}]},
        "initial.zones[0].radius is missing",
        "a centre and a",
    ),
    (
        {"initial.zones": [{"x": [0, 1], "radius": 1, "void_ratio": 0.7}]},
        "initial.zones[0].radius = 1",
        "left out where x is given",
    ),
    (
        {"initial.zones": [{"centre": [-1, -1], "radius": 1.4, "void_ratio": 0.7}]},
        "initial.zones[0].centre = [-1.0, -1.0]",
        "must make a circle that reaches into the rectangle, 0.04 by 0.14 m",
    ),
    (
        {"initial.random": {"standard_deviation": 0, "correlation_length_d50": 1, "seed": 1}},
        "initial.random.standard_deviation = 0",
        "greater than 0",
    ),
    (
        {"initial.random": {"standard_deviation": 1, "correlation_length_d50": 1, "seed": -1}},
        "initial.random.seed = -1",
        "at least 0",
    ),
    # output
    (
        {"output.fields_at": [0.005, 0.011]},
        "output.fields_at[1] = 0.011",
        "must lie on the path, whose travel is 0 to 0.01",
    ),
    ({"output.fields_at": [-0.001]}, "output.fields_at[0] = -0.001", "must lie on the path"),
    ({"output.fields_at": [0.002, 0.002]}, "output.fields_at[1] = 0.002", "greater than the entry before"),
    ({"output.frames": -1}, "output.frames = -1", "at least 0"),
    ({"output.columns.a": {"quantity": "u1"}}, "output.columns.a.boundary is missing", "must be a string"),
    (
        {"output.columns.a": {"boundary": "top", "quantity": "u3"}},
        'output.columns.a.quantity = "u3"',
        '"force1", "force2"',
    ),
    (
        {"output.columns.a": {"boundary": "tip", "quantity": "u1"}},
        'output.columns.a.boundary = "tip"',
        "must name a boundary of the rectangle: bottom, top, left, right",
    ),
    ({"output.columns.2a": {"boundary": "top", "quantity": "u1"}}, "output.columns.2a = {", "beginning with a letter"),
    (
        {"output.columns.a b": {"boundary": "top", "quantity": "u1"}},
        'output.columns."a b" = {',
        "letters, digits and un",
    ),
    (
        {"output.columns.step": {"boundary": "top", "quantity": "u1"}},
        "output.columns.step = {",
        "must have another name",
    ),
    ({"output.columns.top_u1_m": {"boundary": "top", "quantity": "u1"}}, "output.columns.top_u1_m = {", "another name"),
]


@pytest.mark.parametrize(
    ("changes", "subject", "allowed"), BAD_INPUT, ids=[subject[:50] for _, subject, _ in BAD_INPUT]
)
def test_bad_input_is_refused_in_one_line(changes: dict[str, object], subject: str, allowed: str) -> None:
    with pytest.raises(SceneError) as caught:
        parse_scene(changed(changes))
    (line,) = str(caught.value).splitlines()
    assert line.startswith(subject)
    assert allowed in line
    assert "pydantic" not in line


def test_a_wall_that_passes_no_motion_on_may_not_move(mesh_file: Path) -> None:
    with pytest.raises(SceneError, match=r"boundaries.top.wall.u2 = 1.0: must be 0"):
        parse_scene(mesh_scene(mesh_file, {"boundaries.top": {"wall": {"u2": 1.0, "free": True, "pressure": 1.0}}}))


@pytest.mark.parametrize(
    "changes",
    [
        {"boundaries.top": {"u1": 0.01, "t2": -50e3}},
        {"boundaries.top": {"u1": 0.01, "pressure": 50e3}},
        {"boundaries.top": {"u2": 0.0, "couple": 1.0, "rotational_resistance": 5.0}},
        {"boundaries.top": {"wall": {"u1": 0.01, "pressure": 50e3, "rolling": 0.1}}},
        {"boundaries.top": {"wall": {"u2": -0.01, "free": True, **FRACTIONS}}},
        {"boundaries.top.u2": 0.0, "weight.density": 1600.0},
        {"boundaries": {"top": {"pressure": 200e3}}},
        {"boundaries.top": {"pressure": [100e3, 200e3]}},
        {"boundaries.left": {}},
        {"effects.polar": False, "boundaries.top.w": 0.0, "boundaries.left": {"symmetry": True}},
        {"initial.zones": [{"x": [-1.0, 1e-6], "void_ratio": 0.7}]},
        {"points.corner": {"at": [0.04, 0.1 + 0.04], "u1": 0.0}},
    ],
)
def test_what_goes_together_is_taken(changes: dict[str, object]) -> None:
    parse_scene(changed(changes))


COMPLETE = parse_scene(changed(EVERYTHING)).as_dict()


@settings(max_examples=300, deadline=None)
@drawn(chosen=mutations(COMPLETE))
def test_whatever_comes_in_a_scene_or_a_clear_refusal_comes_out(chosen: list[Mutation]) -> None:
    assert_scene_or_clear_refusal(COMPLETE, chosen)
