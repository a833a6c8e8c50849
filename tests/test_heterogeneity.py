"""The initial void ratio: zones have their area on every mesh, the random field its law, files their values."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import basix
import meshio
import numpy as np
import pytest
from meshes import quarter_ring, skewed, square, write_msh
from ranks import on_ranks

from cosserat_fx._compat import MPI
from cosserat_fx.geometry import Geometry, Grading, layer, rectangle
from cosserat_fx.initial.cell_samples import map_to_cells, reference_samples, share_out
from cosserat_fx.initial.measured_field import FieldFileError, MeasuredField, read_field
from cosserat_fx.initial.random_field import RandomField as Waves
from cosserat_fx.initial.void_ratio import MARGIN, VoidRatio, initial_void_ratio
from cosserat_fx.material import AdmissibilityError
from cosserat_fx.meshes.file import read
from cosserat_fx.scenes.initial import FieldFile, Initial, RandomField, Zone
from cosserat_fx.typing import Array

BASE = 0.6
BOUNDS = (0.5, 1.0)
D50 = 1e-3


def evaluate(geometry: Geometry, *zones: Zone, degree: int = 1, **rest: Any) -> VoidRatio:
    points, weights = basix.make_quadrature(geometry.mesh.basix_cell(), degree)
    initial = Initial.model_construct(stress=-100e3, void_ratio=BASE, zones=zones, **rest)
    return initial_void_ratio(initial, geometry, points, weights, d50=D50, bounds=BOUNDS)


def excess(geometry: Geometry, *zones: Zone, degree: int = 1) -> float:
    """The integral of the void ratio less its base, with the quadrature rule."""
    points, weights = basix.make_quadrature(geometry.mesh.basix_cell(), degree)
    measures = map_to_cells(geometry.mesh.basix_cell().name, geometry.cell_corners(), points).measures
    values = evaluate(geometry, *zones, degree=degree).values.reshape(measures.shape)
    return float(np.sum((values - BASE) * measures * weights))


def from_file(folder: Path, kind: str, shape: Callable[[Array], Array]) -> Geometry:
    return read(write_msh(folder / "body.msh", square(6, 6, kind, shape)), MPI.COMM_SELF)


# -- zones -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [1, 3, 5])
@pytest.mark.parametrize("cells", [(16, 56), (7, 9), (2, 3)])
def test_rectangular_zone_has_its_area_on_every_mesh(cells: tuple[int, int], degree: int) -> None:
    """Exactly: aligned with the cells (the first mesh), not aligned, and within a single cell (the last)."""
    body = rectangle(0.04, 0.14, cells, MPI.COMM_SELF)
    zone = Zone(x=(0.0, 0.0025), y=(0.075, 0.0775), void_ratio=0.7)
    assert excess(body, zone, degree=degree) == pytest.approx(0.1 * 0.0025**2, rel=1e-9)


def test_aligned_zone_is_its_cells_and_no_others() -> None:
    body = rectangle(0.04, 0.14, (16, 56), MPI.COMM_SELF)
    values = evaluate(body, Zone(x=(0.0, 0.0025), y=(0.075, 0.0775), void_ratio=0.7)).values
    inside = np.isclose(values, 0.7, rtol=0, atol=1e-12)
    assert body.cell_corners()[inside].mean(axis=1).tolist() == [pytest.approx([0.00125, 0.07625])]
    np.testing.assert_array_equal(values[~inside], BASE)


def test_zone_keeps_its_area_on_graded_cells() -> None:
    body = rectangle(1.0, 1.0, (9, 8), MPI.COMM_SELF, grading_x=Grading("centre", 5.0), grading_y=Grading("top", 3.0))
    assert excess(body, Zone(x=(0.31, 0.62), void_ratio=0.8), degree=3) == pytest.approx(0.2 * 0.31, rel=1e-9)


@pytest.mark.parametrize("kind", ["quad", "triangle"])
@pytest.mark.parametrize("degree", [1, 2])
def test_zones_keep_their_area_on_distorted_cells(kind: str, degree: int, tmp_path: Path) -> None:
    """A rectangle of two cells' width and a circle of one cell's radius: to half a per cent."""
    body = from_file(tmp_path, kind, skewed)
    h = 1 / 6
    assert excess(body, Zone(x=(0.3, 0.3 + 2 * h), y=(0.4, 0.8), void_ratio=0.7), degree=degree) == pytest.approx(
        0.1 * 2 * h * 0.4, rel=5e-3
    )
    circle = Zone(centre=(0.45, 0.57), radius=h, void_ratio=0.7)
    assert excess(body, circle, degree=degree) == pytest.approx(0.1 * math.pi * h**2, rel=5e-3)


def test_circle_within_a_cell_has_its_area() -> None:
    """A quarter of the cell's size in radius, that is two samples: to two per cent, wherever it is."""
    body = rectangle(1.0, 1.0, (2, 2), MPI.COMM_SELF)
    for centre in ((0.25, 0.25), (0.28, 0.71), (0.5, 0.33)):
        area = excess(body, Zone(centre=centre, radius=0.125, void_ratio=0.7)) / 0.1
        assert area == pytest.approx(math.pi * 0.125**2, rel=0.02)


def test_later_zones_win_where_zones_overlap() -> None:
    """On cells that both cut: the first keeps what the second, and a third exactly on it, leave."""
    body = rectangle(1.0, 1.0, (4, 4), MPI.COMM_SELF)
    first, second = Zone(x=(0.1, 0.65), void_ratio=0.8), Zone(x=(0.375, 0.9), y=(0.0, 0.4375), void_ratio=0.7)
    expected = 0.2 * (0.55 - 0.275 * 0.4375) + 0.1 * 0.525 * 0.4375
    assert excess(body, first, second) == pytest.approx(expected, rel=1e-9)
    over = Zone(x=second.x, y=second.y, void_ratio=0.9)
    result = evaluate(body, second, over)
    np.testing.assert_allclose(result.values, evaluate(body, over).values, atol=0.1 / 8)


def test_zone_that_nothing_is_left_of_is_told() -> None:
    body = rectangle(1.0, 1.0, (4, 4), MPI.COMM_SELF)
    zones = (
        Zone(x=(0.25, 0.5), void_ratio=0.7),
        Zone(x=(0.0, 0.5), void_ratio=0.8),
        Zone(y=(2.0, 3.0), void_ratio=0.8),
    )
    result = evaluate(body, *zones)
    assert [text.split()[0] for text in result.warnings] == ["initial.zones[0]", "initial.zones[2]"]


@pytest.mark.parametrize("degree", [1, 3])
def test_zone_of_a_layer_has_its_height(degree: int) -> None:
    assert excess(layer(1.0, 7, MPI.COMM_SELF), Zone(y=(0.2, 0.55), void_ratio=0.7), degree=degree) == pytest.approx(
        0.1 * 0.35, rel=1e-9
    )


def test_regions_are_whole_cells(tmp_path: Path) -> None:
    body = from_file(tmp_path, "triangle", quarter_ring)
    values = evaluate(body, Zone(region="upper", void_ratio=0.7), degree=2).values.reshape(len(body.own_cells), -1)
    upper = np.isin(body.own_cells, body.regions["upper"])
    np.testing.assert_allclose(values[upper], 0.7, atol=1e-12)
    np.testing.assert_array_equal(values[~upper], BASE)
    with pytest.raises(AdmissibilityError, match=r"initial.zones\[0\].region = 'uper': .*\(lower, upper\)"):
        evaluate(body, Zone(region="uper", void_ratio=0.7))


@pytest.mark.parametrize(("cell", "degree"), [("interval", 5), ("quadrilateral", 5), ("triangle", 4)])
def test_each_point_gets_the_samples_around_it_by_its_weight(cell: str, degree: int) -> None:
    points, weights = basix.make_quadrature(getattr(basix.CellType, cell), degree)
    samples = reference_samples(cell, 8)
    shares = share_out(samples, points, weights)
    assert shares.min() >= 0
    np.testing.assert_allclose(shares.sum(axis=0), 1 / len(samples), atol=1e-12)
    np.testing.assert_allclose(shares.sum(axis=1), weights / weights.sum(), atol=1e-12)
    centres = (shares @ samples) / shares.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(centres, points, atol=0.05)
    np.testing.assert_allclose(samples.mean(axis=0), 1 / 3 if cell == "triangle" else 1 / 2)


# -- the random field ------------------------------------------------------------------------------------------------


def test_random_field_has_its_variance_and_correlation() -> None:
    """Over 2000 seeds, s^2 exp(-(r/l)^2) in two directions, to four standard errors; and the moments of a Gaussian."""
    s, length, seeds = 0.05, 2.0, 2000
    r = length * np.array([0.0, 0.25, 0.5, 1.0, 1.5, 3.0])
    points = np.concatenate([np.stack([r, 0 * r], axis=1), np.stack([0 * r, r], axis=1)]) + 40.0
    values = np.array([Waves(s, length, seed)(points) for seed in range(seeds)])
    error = 4 / math.sqrt(seeds)
    np.testing.assert_allclose(values.mean(axis=0) / s, 0.0, atol=error)
    for along in (values[:, :6], values[:, 6:]):
        covariance = (along * along[:, :1]).mean(axis=0) / s**2
        np.testing.assert_allclose(covariance, np.exp(-((r / length) ** 2)), atol=error * math.sqrt(2))
    assert np.mean((values / s) ** 4) == pytest.approx(3.0, abs=error * math.sqrt(96))


def test_random_field_has_its_variance_and_correlation_in_one_body() -> None:
    """On a square of 100 correlation lengths one realisation tells the law, to about its own scatter."""
    step = np.arange(0, 100, 0.5)
    points = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    values = Waves(1.0, 1.0, 3)(points).reshape(len(step), -1)
    assert values.mean() == pytest.approx(0.0, abs=0.05)
    assert values.var() == pytest.approx(1.0, abs=0.1)
    for shift in (1, 2):
        for field in (values, values.T):
            assert (field[shift:] * field[:-shift]).mean() == pytest.approx(math.exp(-((shift / 2) ** 2)), abs=0.1)


def test_random_field_of_a_seed_never_changes() -> None:
    """Recorded once: whoever repeats a published run with another NumPy has to find the same body."""
    points = np.array([[0.0, 0.0], [0.3, -0.2], [100.0, 7.0]])
    recorded = [-1.0841886835982768, -0.6020380530939359, -0.2640103280736772]
    np.testing.assert_allclose(Waves(1.0, 0.5, 42)(points), recorded, atol=1e-10)
    assert np.abs(Waves(1.0, 0.5, 43)(points) - recorded).min() > 1e-3


def test_random_field_is_the_same_on_every_mesh() -> None:
    """Added to base and zones, at the points: of these two meshes each third point of the finer one coincides."""
    random = RandomField(standard_deviation=0.01, correlation_length_d50=50.0, seed=7)
    zone = Zone(x=(0.0, 0.5), void_ratio=0.7)
    found = []
    for cells in (4, 12):
        body = rectangle(1.0, 1.0, (cells, cells), MPI.COMM_SELF)
        result = evaluate(body, zone, random=random)
        at = np.round(body.cell_corners().mean(axis=1), 9)
        found.append({tuple(place): value for place, value in zip(at.tolist(), result.values, strict=True)})
    shared = found[0].keys() & found[1].keys()
    assert len(shared) == 16
    assert [found[0][place] for place in shared] == pytest.approx([found[1][place] for place in shared], abs=1e-14)
    noise = Waves(0.01, 0.05, 7)(np.array(sorted(shared)))
    assert np.ptp(noise) > 0.01
    expected = noise + np.where(np.array(sorted(shared))[:, 0] < 0.5, 0.7, BASE)
    assert [found[1][place] for place in sorted(shared)] == pytest.approx(expected, abs=1e-14)


def test_layer_is_the_section_of_the_plane() -> None:
    random = RandomField(standard_deviation=0.01, correlation_length_d50=50.0, seed=7)
    values = evaluate(layer(1.0, 50, MPI.COMM_SELF), random=random).values
    heights = (np.arange(50) + 0.5) / 50
    expected = BASE + Waves(0.01, 0.05, 7)(np.stack([0 * heights, heights], axis=1))
    np.testing.assert_allclose(np.sort(values), np.sort(expected), atol=1e-14)


def test_unresolved_random_field_is_warned_of() -> None:
    body = rectangle(0.01, 0.01, (5, 5), MPI.COMM_SELF)
    short, long = (
        evaluate(body, random=RandomField(standard_deviation=0.01, correlation_length_d50=length, seed=0)).warnings
        for length in (1.9, 2.1)
    )
    assert len(short) == 1
    assert short[0].startswith("initial.random.correlation_length_d50 = 1.9 is less than")
    assert long == ()


def test_void_ratios_out_of_bounds_are_brought_inside_and_counted() -> None:
    body = rectangle(1.0, 1.0, (20, 20), MPI.COMM_SELF)
    random = RandomField(standard_deviation=0.1, correlation_length_d50=200.0, seed=1)
    result = evaluate(body, random=random)
    low, high = BOUNDS
    wild = BASE + Waves(0.1, 0.2, 1)(body.cell_corners().mean(axis=1))
    assert result.clipped == np.sum((wild <= low) | (wild >= high)) > 0
    assert result.values.min() == pytest.approx(low + MARGIN * (high - low))
    assert f"{result.clipped} of 400 points" in result.warnings[-1]
    within = (wild > low) & (wild < high)
    np.testing.assert_allclose(result.values[within], wild[within], atol=1e-14)


# -- from files --------------------------------------------------------------------------------------------------------


def plane(points: Array) -> Array:
    found: Array = 0.6 + 0.1 * points[:, 0] - 0.05 * points[:, 1]
    return found


def csv(file: Path, points: Array, values: Array) -> Path:
    rows = [f"{x!r},{n},{y!r},{e!r}" for n, (x, y, e) in enumerate(np.column_stack([points, values]).tolist())]
    file.write_text("\n".join(["x_m, number, y_m, void_ratio", *rows]) + "\n")
    return file


def test_table_is_interpolated_linearly_and_continued_by_the_nearest_point(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(0.2, 0.9, (60, 2))
    corners = np.array([[0.1, 0.1], [0.95, 0.1], [0.1, 0.95], [0.95, 0.95]])
    points = np.concatenate([points, corners])
    file = csv(tmp_path / "e.csv", points, plane(points))
    body = rectangle(1.0, 1.0, (10, 10), MPI.COMM_SELF)
    values = evaluate(body, field=FieldFile.model_construct(file=str(file))).values
    at = body.cell_corners().mean(axis=1)
    within = np.all((at > 0.1) & (at < 0.95), axis=1)
    np.testing.assert_allclose(values[within], plane(at[within]), atol=1e-12)
    corner = np.argmin(at.sum(axis=1))
    assert values[corner] == pytest.approx(plane(corners[:1])[0])


@pytest.mark.parametrize("direction", [(0.0, 1.0), (1.0, 0.0), (0.6, 0.8)])
def test_points_on_a_line_are_interpolated_along_it(direction: tuple[float, float]) -> None:
    stations = np.array([0.0, 0.5, 0.2, 1.0])
    field = MeasuredField(stations[:, None] * np.array(direction), 0.6 + 0.1 * stations**2)
    across = 3.0 * np.array([-direction[1], direction[0]])
    at = np.array([[0.35], [2.0], [-1.0]]) * np.array(direction) + across
    np.testing.assert_allclose(field(at), [0.6 + 0.1 * (0.04 + 0.25) / 2, 0.7, 0.6])


def test_one_point_and_points_given_twice() -> None:
    at = np.array([[3.0, 4.0], [0.0, 0.0]])
    np.testing.assert_allclose(MeasuredField(np.array([[1.0, 1.0]]), np.array([0.6]))(at), 0.6)
    np.testing.assert_allclose(MeasuredField(np.array([[1.0, 1.0]] * 2), np.array([0.6, 0.7]))(at), 0.65)


@pytest.mark.parametrize("data", ["point", "cell"])
def test_mesh_file_gives_the_base(data: str, tmp_path: Path) -> None:
    mesh = square(8, 8, "triangle", skewed)
    middles = mesh.points[mesh.cells].mean(axis=1)
    point_data = {"void_ratio": plane(mesh.points)} if data == "point" else {}
    cell_data = {"void_ratio": [plane(middles)]} if data == "cell" else {}
    points = np.pad(mesh.points, ((0, 0), (0, 1)))
    meshio.Mesh(points, [("triangle", mesh.cells)], point_data, cell_data).write(tmp_path / "e.vtu")
    at = np.array([[0.3, 0.4], [0.55, 0.5], [0.8, 0.3]])
    np.testing.assert_allclose(read_field(tmp_path / "e.vtu", MPI.COMM_SELF)(at), plane(at), atol=1e-12)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "must name the columns x_m,y_m,void_ratio, but x_m, y_m, void_ratio is missing"),
        ("x_m,y,void_ratio\n", "must name the columns x_m,y_m,void_ratio, but y_m is missing"),
        ("x_m,y_m,void_ratio\n", "must hold one void ratio at each of one or more points"),
        ("x_m,y_m,void_ratio\n0,0,0.6\n\n1,0\n", "line 4 must hold a number in each column"),
        ("x_m,y_m,void_ratio\n0,zero,0.6\n", "line 2 must hold a number in each column"),
        ("x_m,y_m,void_ratio\n0,0,nan\n", "must be finite numbers"),
        ("x_m,y_m,void_ratio\n0,0,-0.1\n", "must be greater than 0"),
    ],
)
def test_tables_that_cannot_be_used_are_refused(content: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "e.csv").write_text(content)
    with pytest.raises(FieldFileError, match=message) as caught:
        read_field(tmp_path / "e.csv", MPI.COMM_SELF)
    assert str(caught.value).startswith(f"{tmp_path / 'e.csv'}: ")


def test_mesh_file_without_void_ratio_is_refused(tmp_path: Path) -> None:
    mesh = square(2, 2)
    points = np.pad(mesh.points, ((0, 0), (0, 1)))
    meshio.Mesh(points, [("quad", mesh.cells)], {"porosity": np.ones(9)}).write(tmp_path / "e.vtu")
    with pytest.raises(FieldFileError, match=r'must have point data or cell data "void_ratio"; .*: porosity'):
        read_field(tmp_path / "e.vtu", MPI.COMM_SELF)


# -- on several ranks --------------------------------------------------------------------------------------------------

DESCRIBE = """
import json, sys
from pathlib import Path
import basix
import numpy as np
from cosserat_fx._compat import MPI
from cosserat_fx.initial.cell_samples import map_to_cells
from cosserat_fx.initial.void_ratio import initial_void_ratio
from cosserat_fx.scenes.initial import Initial
from cosserat_fx.meshes.file import read

comm = MPI.COMM_WORLD
body = read(Path(sys.argv[1]), comm)
initial = Initial(
    stress=-100e3,
    void_ratio=0.6,
    zones=[dict(region="upper", void_ratio=0.7), dict(centre=[0.4, 0.3], radius=0.13, void_ratio=0.9),
           dict(x=[9.0, 10.0], void_ratio=0.8)],
    random=dict(standard_deviation=0.1, correlation_length_d50=20.0, seed=5),
    field=dict(file=sys.argv[2]),
)
points, weights = basix.make_quadrature(body.mesh.basix_cell(), 2)
result = initial_void_ratio(initial, body, points, weights, d50=1e-3, bounds=(0.5, 1.0))
at = map_to_cells(body.mesh.basix_cell().name, body.cell_corners(), points).positions
rows = np.column_stack([at.reshape(-1, 2), result.values])
rows = np.concatenate(comm.allgather(rows))
rows = rows[np.lexsort(np.round(rows[:, :2], 9).T)]
warnings = set(comm.allgather(result.warnings))
if comm.rank == 0:
    print(json.dumps([rows.tolist(), result.clipped, sorted(warnings)]))
"""


def test_ranks_share_one_field(tmp_path: Path) -> None:
    """Base from a file, zones and random field: the same at each place; counts and warnings of all, told by all."""
    file = write_msh(tmp_path / "body.msh", square(5, 6, "triangle", skewed))
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    table = csv(tmp_path / "e.csv", points, plane(points))
    one, two, three = (json.loads(on_ranks(ranks, DESCRIBE, file, table)) for ranks in (1, 2, 3))
    assert one[1] > 0
    assert [len(w) for w in one[2]] == [3]
    for several in (two, three):
        assert several[1:] == one[1:]
        np.testing.assert_allclose(np.array(several[0]), np.array(one[0]), atol=1e-12)
