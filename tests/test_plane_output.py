"""What the run of a plane body writes: its history, its fields, its summary; on any number of ranks."""

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from layers import difference
from ranks import on_ranks
from scenes import RECTANGLE, change, to_toml

from cosserat_fx import geometry
from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.elements import ELEMENTS
from cosserat_fx.material import Material
from cosserat_fx.output.plane_fields import PlaneFieldWriter, PlaneState, read_states
from cosserat_fx.output.plane_observation import PlaneObserver, mobilised_friction
from cosserat_fx.problem import Problem
from cosserat_fx.results import BOUNDARY_COLUMNS, PLANE_COLUMNS, OutputError, Run, read_run
from cosserat_fx.run import run
from cosserat_fx.scene import parse_scene
from cosserat_fx.scenes.plane import Column
from cosserat_fx.stepping import Step
from cosserat_fx.typing import Array
from cosserat_fx.weakform import Numerics

WIDTH, HEIGHT = 0.04, 0.14
BIAXIAL = change(
    RECTANGLE,
    {
        "material.d50": 3e-3,
        "boundaries.top.u2": -2e-3,
        "boundaries.left": {"pressure": 120e3},
        "boundaries.right": {"pressure": 120e3},
        "points.pin": {"at": [0.0, 0.0], "u1": 0.0},
        "output.fields_at": [7e-4, 2e-3],
        "output.frames": 4,
        "output.figures": False,
        "output.columns.shortening_m": {"boundary": "top", "quantity": "u2", "factor": -1.0},
        "output.columns.axial_stress_Pa": {"boundary": "top", "quantity": "force2", "factor": -1.0 / WIDTH},
    },
)
"""Loads that differ from the initial stress, and so a leg in which they are brought up."""
COLUMN = Column(boundary="top", quantity="u1", factor=-2.0)


def body(element: str = "Q1", *, polar: bool = True, cells: tuple[int, int] = (3, 4)) -> Problem:
    chosen = ELEMENTS[element]
    rectangle = geometry.rectangle(WIDTH, HEIGHT, cells)
    if chosen.cell == "triangle":
        points = rectangle.mesh.geometry.x[:, :2]
        corners = dolfinx.mesh.entities_to_geometry(rectangle.mesh, 2, rectangle.own_cells)
        halves = corners[:, [[0, 1, 2], [1, 2, 3]]].reshape(-1, 3)
        mesh = geometry.distribute(MPI.COMM_WORLD, "triangle", points, halves)
        rectangle = geometry.Geometry(mesh, "plane", {})
    numerics = Numerics(polar=polar, order=chosen.order, degree=chosen.degree)
    return Problem(rectangle, Material.named("paper-sand"), [], stress=-100e3, void_ratio=0.6, numerics=numerics)


def move(problem: Problem, gradient: Array) -> None:
    """Give a body a uniform displacement gradient, and rotations that grow with x1 (0.1 rad per cm)."""
    for name, field in problem.fields.items():
        at = field.coordinates
        values = 10.0 * at[:, 0] if name == "w" else at @ gradient[int(name[1]) - 1]
        problem.committed.x.array[field.dofs] = values


def state_of(observer: PlaneObserver) -> PlaneState:
    state = observer.state(0.001)
    assert state is not None
    return state


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_shear_strain_is_that_of_simple_shear_for_every_observer(turn: float) -> None:
    problem = body()
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    move(problem, rotation @ np.array([[1.0, -1.7], [0.0, 1.0]]) - np.eye(2))
    state = state_of(PlaneObserver(problem, (), {}, start=0.0))
    np.testing.assert_allclose(state.means["shear_strain"], 1.7, rtol=1e-12)


@pytest.mark.parametrize("element", list(ELEMENTS))
def test_nodes_and_cells_show_their_fields(element: str) -> None:
    problem = body(element)
    gradient = np.array([[0.01, 0.3], [0.02, -0.05]])
    move(problem, gradient)
    at = problem.state.coordinates
    problem.state.e_n[problem.state.points] = 0.6 + at[:, 0] + 2.0 * at[:, 1]
    state = state_of(PlaneObserver(problem, (), {}, start=0.0))
    corners = 3 if ELEMENTS[element].cell == "triangle" else 4
    assert (len(state.points), state.cells.shape) == (20, (12 * (5 - corners), corners))
    np.testing.assert_allclose(state.displacement, state.points @ gradient.T, atol=1e-15)
    assert state.rotation is not None
    np.testing.assert_allclose(state.rotation, 10.0 * state.points[:, 0], atol=1e-14)
    np.testing.assert_allclose(state.means["void_ratio"], 0.6 + state.centroids @ [1.0, 2.0], rtol=1e-12)
    np.testing.assert_allclose(state.means["shear_strain"], np.hypot(0.06, 0.32), rtol=1e-12)
    np.testing.assert_allclose(state.means["pressure_Pa"], 100e3, rtol=1e-12)
    np.testing.assert_allclose(state.means["mobilised_friction_deg"], 0.0, atol=1e-5)
    assert state.areas.sum() == pytest.approx(WIDTH * HEIGHT, rel=1e-12)
    if corners == 4:
        np.testing.assert_array_equal(state.points[:4, 1], 0.0)
        np.testing.assert_allclose(state.centroids[:3, 0], WIDTH * np.array([1, 3, 5]) / 6)


def test_without_polar_effects_there_is_no_rotation_and_no_couple() -> None:
    problem = body(polar=False)
    move(problem, np.array([[0.0, 0.1], [0.0, 0.0]]))
    observer = PlaneObserver(problem, ("top",), {"minus_twice_u1_m": COLUMN}, start=0.02)
    state, row = state_of(observer), observer.row(Step(1, 0.015, 0.001, 3, 0, 0))
    assert state.rotation is None
    assert not np.any([state.means["m31_N_per_m"], state.means["m32_N_per_m"]])
    assert tuple(row) == observer.columns == (*PLANE_COLUMNS, *column_names("top"), "minus_twice_u1_m")
    assert row["travel_m"] == pytest.approx(-0.005)
    assert row["top_w_rad"] == row["top_couple_N"] == 0.0
    assert row["top_u1_m"] == pytest.approx(0.1 * HEIGHT)
    assert row["minus_twice_u1_m"] == pytest.approx(-0.2 * HEIGHT)


def column_names(*boundaries: str) -> list[str]:
    return [f"{name}_{ending}" for name in boundaries for ending in BOUNDARY_COLUMNS.values()]


def test_the_mobilised_friction_is_that_of_the_matsuoka_nakai_cone() -> None:
    """In triaxial compression the cone of phi_c meets that of Mohr and Coulomb; with a tension there is none."""
    sine = np.sin(np.radians(30.0))
    large = -1e5 * (1 + sine) / (1 - sine)
    middle, radius = (large - 1e5) / 2, (large + 1e5) / 2
    s11 = np.array([large, -1e5, middle, 1e3])
    s22 = np.array([-1e5, large, middle, -1e5])
    stress = {"s11_Pa": s11, "s22_Pa": s22, "s33_Pa": np.full(4, -1e5)}
    stress |= {"s12_Pa": np.array([0.0, 0.0, 1.2 * radius, 0.0]), "s21_Pa": np.array([0.0, 0.0, 0.8 * radius, 0.0])}
    np.testing.assert_allclose(mobilised_friction(stress), [30.0, 30.0, 30.0, 90.0], rtol=1e-9)


# -- a run -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def biaxial(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("biaxial") / "run"
    ledger = run(parse_scene(BIAXIAL), folder)
    assert ledger.reason is None
    return read_run(folder)


def test_the_history_has_the_columns_in_order(biaxial: Run) -> None:
    own = ("shortening_m", "axial_stress_Pa")
    assert tuple(biaxial.history) == (*PLANE_COLUMNS, *column_names("bottom", "top", "left", "right"), *own)
    assert not (biaxial.path / "profiles.csv").exists()
    assert biaxial.kind == "rectangle"


def test_travel_begins_with_the_first_leg(biaxial: Run) -> None:
    """Before it the pressure is brought up from the 100 kPa of the initial stress."""
    travel, pushed = biaxial.history["travel_m"], biaxial.history["left_force1_N_per_m"] / HEIGHT
    assert travel[0] < 0
    start = int(np.flatnonzero(travel == 0.0)[0])
    assert np.all(np.diff(travel) > 0)
    assert np.all((pushed[:start] > 100e3) & (pushed[:start] < 120e3))
    assert pushed[start] == pytest.approx(120e3, rel=1e-3)
    np.testing.assert_allclose(biaxial.history["shortening_m"], np.maximum(travel, 0.0), atol=1e-12)


def test_forces_on_the_body_balance(biaxial: Run) -> None:
    history = biaxial.history
    for axis in (1, 2):
        forces = np.array([history[f"{name}_force{axis}_N_per_m"] for name in ("bottom", "top", "left", "right")])
        assert np.abs(forces.sum(axis=0)).max() < 1e-6 * np.abs(forces).max()
    np.testing.assert_array_equal(history["axial_stress_Pa"], -1.0 / WIDTH * history["top_force2_N_per_m"])


def test_fields_are_written_where_asked(biaxial: Run) -> None:
    states = read_states(biaxial.path / "fields")
    travels, rows = [state.travel for state in states], biaxial.history["travel_m"]
    assert travels == sorted({*travels})
    assert travels[0] == pytest.approx(-3e-3)
    assert {0.0, *biaxial.summary["stations_m"]} <= {*travels}
    assert biaxial.summary["stations_m"] == pytest.approx([7e-4, 2e-3])
    assert set(travels[1:]) <= {*rows.tolist()}
    for part in range(1, 5):
        assert rows[rows >= part * 5e-4 * (1 - 1e-9)].min() in travels
    assert len(states) <= 1 + 1 + 2 + 4
    last = states[-1]
    assert last.displacement[last.points[:, 1] == HEIGHT, 1] == pytest.approx(-2e-3)
    assert last.means["shear_strain"].max() <= biaxial.history["max_shear_strain"][-1]


def test_the_summary_says_why_there_is_no_band(biaxial: Run) -> None:
    assert "nearly even" in biaxial.summary["no_band"]
    assert "band" not in biaxial.summary
    assert biaxial.summary["branch_passages"] == biaxial.history["branch_passages"].sum() == 0


def test_without_frames_and_with_none_of_it(tmp_path: Path) -> None:
    run(parse_scene(change(BIAXIAL, {"output.frames": 0})), tmp_path / "stations")
    _, *travels = [state.travel for state in read_states(tmp_path / "stations" / "fields")]
    assert travels == pytest.approx([0.0, 7e-4, 2e-3])
    run(parse_scene(change(BIAXIAL, {"output.fields": False, "output.figures": True})), tmp_path / "little")
    assert not (tmp_path / "little" / "fields").exists()
    assert [file.name for file in (tmp_path / "little" / "figures").iterdir()] == ["history.png"]


def test_a_run_that_stops_early_shows_its_last_state(tmp_path: Path) -> None:
    ledger = run(parse_scene(change(BIAXIAL, {"stepping.max_steps": 3, "output.frames": 1})), tmp_path / "run")
    assert ledger.reason is not None
    stopped = read_run(tmp_path / "run")
    assert read_states(stopped.path / "fields")[-1].travel == stopped.history["travel_m"][-1]


PROGRAM = """
import sys
from pathlib import Path
from cosserat_fx.run import run
from cosserat_fx.scene import load_scene
assert run(load_scene(Path(sys.argv[1])), Path(sys.argv[2])).reason is None
"""


@pytest.mark.parametrize("ranks", [2, 3])
def test_files_do_not_depend_on_the_number_of_ranks(biaxial: Run, tmp_path: Path, ranks: int) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(to_toml(BIAXIAL))
    on_ranks(ranks, PROGRAM, scene, tmp_path / "run")
    several = read_run(tmp_path / "run")
    assert list(several.history) == list(biaxial.history)
    scales = {"force": 1e4, "couple": 1.0, "_m": 1e-3, "_rad": 1e-3}
    for name, column in biaxial.history.items():
        scale = max([np.abs(column).max(), *(size for part, size in scales.items() if part in name)])
        assert np.abs(several.history[name] - column).max() <= 1e-8 * scale, name
    assert several.summary["no_band"] == biaxial.summary["no_band"]
    files = sorted((biaxial.path / "fields").glob("*.vtu"))
    assert [file.name for file in files] == [file.name for file in sorted((tmp_path / "run" / "fields").glob("*.vtu"))]
    for file in files:
        here, there = meshio.read(file), meshio.read(tmp_path / "run" / "fields" / file.name)
        np.testing.assert_array_equal(here.points, there.points)
        np.testing.assert_array_equal(here.cells[0].data, there.cells[0].data)
        assert difference(here.point_data["displacement"] + 1e-3, there.point_data["displacement"] + 1e-3) < 1e-8
        for name in ("void_ratio", "pressure_Pa"):
            assert difference(here.cell_data[name][0], there.cell_data[name][0]) < 1e-8


# -- files -------------------------------------------------------------------------------------------------------------


def some_state(**changes: Any) -> PlaneState:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 1.0], [0.0, 1.0], [3.0, 0.0]]) / 3
    given: dict[str, Any] = {
        "travel": 0.1 + 0.2,
        "points": points,
        "cells": np.array([[0, 1, 2, 3], [2, 1, 4, 4]])[:1],
        "displacement": np.pi * points,
        "rotation": np.exp(points[:, 0]),
        "means": {"void_ratio": np.array([2 / 3]), "shear_strain": np.array([1e-300])},
    }
    return PlaneState(**given | changes)


@pytest.mark.parametrize("cells", [[[0, 1, 2, 3]], [[2, 1, 0]]])
def test_every_bit_of_a_state_comes_back(tmp_path: Path, cells: list[list[int]]) -> None:
    states = [some_state(cells=np.array(cells)), some_state(cells=np.array(cells), travel=1.0, rotation=None)]
    writer = PlaneFieldWriter(tmp_path / "fields")
    for state in states:
        writer.write(state)
    for state, found in zip(states, read_states(tmp_path / "fields"), strict=True):
        assert found.travel == state.travel
        assert (found.rotation is None) == (state.rotation is None)
        for name in ("points", "cells", "displacement"):
            np.testing.assert_array_equal(getattr(found, name), getattr(state, name))
        assert found.means == state.means


def test_areas_and_centroids() -> None:
    """Of the trapezium with sides 1 and 2 and height 1, in thirds, in either sense."""
    for cells in ([[0, 1, 2, 3]], [[3, 2, 1, 0]]):
        state = some_state(cells=np.array(cells))
        assert state.areas == pytest.approx(1.5 / 9)
        np.testing.assert_allclose(state.centroids, [[7 / 27, 5 / 27]])


def test_fields_that_are_missing_or_damaged(tmp_path: Path) -> None:
    assert read_states(tmp_path) == []
    PlaneFieldWriter(tmp_path / "fields").write(some_state())
    (tmp_path / "fields" / "plane_0000.vtu").unlink()
    with pytest.raises(OutputError, match="fields cannot be read"):
        read_states(tmp_path / "fields")
    with pytest.raises(OutputError, match="cannot be made: File exists"):
        PlaneFieldWriter(tmp_path / "fields")
