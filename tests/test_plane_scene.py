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
    FRACTIONS,
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


def test_a_wall_that_passes_no_motion_on_may_not_move(mesh_file: Path) -> None:
    with pytest.raises(SceneError, match=r"boundaries.top.wall.u2 = 1.0: must be 0"):
        parse_scene(mesh_scene(mesh_file, {"boundaries.top": {"wall": {"u2": 1.0, "free": True, "pressure": 1.0}}}))


COMPLETE = parse_scene(changed(EVERYTHING)).as_dict()


@settings(max_examples=300, deadline=None)
@drawn(chosen=mutations(COMPLETE))
def test_whatever_comes_in_a_scene_or_a_clear_refusal_comes_out(chosen: list[Mutation]) -> None:
    assert_scene_or_clear_refusal(COMPLETE, chosen)
