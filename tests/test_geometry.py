"""Plane bodies: rectangles, meshes from files, and what boundaries and cells of both are asked for."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest
import ufl
from meshes import Mesh, identity, quarter_ring, skewed, square, write_msh
from ranks import on_ranks

from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.geometry import Geometry, Grading, layer, rectangle, signed_areas
from cosserat_fx.meshes.file import MeshError, read
from cosserat_fx.meshes.normals import BoundaryNormals
from cosserat_fx.meshes.sizes import size_report
from cosserat_fx.typing import Array

SIDES = {"bottom": (0.0, -1.0), "top": (0.0, 1.0), "left": (-1.0, 0.0), "right": (1.0, 0.0)}


def integral(geometry: Geometry, boundary: str, what: object = 1.0) -> float:
    """Over a named boundary, by DOLFINx itself."""
    ds = ufl.Measure("ds", geometry.mesh, subdomain_data=geometry.facet_tags([boundary]))
    one = dolfinx.fem.Constant(geometry.mesh, 1.0)
    return float(dolfinx.fem.assemble_scalar(dolfinx.fem.form(one * what * ds(0))))


# -- rectangles ----------------------------------------------------------------------------------------------------


def test_rectangle_has_its_sides_and_counter_clockwise_cells() -> None:
    body = rectangle(0.04, 0.14, (3, 5), MPI.COMM_SELF)
    assert body.dimension == "plane"
    np.testing.assert_array_equal(body.extent(), [[0, 0], [0.04, 0.14]])
    assert body.smallest_extent == 0.04
    assert {name: len(facets) for name, facets in body.boundaries.items()} == {
        "bottom": 3,
        "top": 3,
        "left": 5,
        "right": 5,
    }
    areas = signed_areas(body.cell_corners())
    assert areas == pytest.approx(0.04 * 0.14 / 15)
    assert body.cell_sizes() == pytest.approx(math.sqrt(0.04 * 0.14 / 15))
    normal = ufl.FacetNormal(body.mesh)
    for name, outward in SIDES.items():
        length = 0.04 if name in ("bottom", "top") else 0.14
        assert [integral(body, name, normal[i]) for i in (0, 1)] == pytest.approx(np.multiply(outward, length))


def test_determinant_of_the_map_of_the_cells_is_positive() -> None:
    """Not so for DOLFINx's own rectangles; what is divided by it need not ask for its sign."""
    body = rectangle(2.0, 3.0, (2, 2), MPI.COMM_SELF)
    sign = ufl.JacobianDeterminant(body.mesh)
    dx = ufl.dx(body.mesh)
    form = dolfinx.fem.form(ufl.conditional(ufl.gt(sign, 0), 1.0, 0.0) * dx)
    assert dolfinx.fem.assemble_scalar(form) == pytest.approx(6.0)


@pytest.mark.parametrize("fine", ["left", "right", "centre", "ends"])
@pytest.mark.parametrize("cells", [6, 7])
def test_graded_cells_are_a_geometric_progression(fine: str, cells: int) -> None:
    nodes = Grading(fine, 4.0).nodes(3.0, cells)  # type: ignore[arg-type]
    assert (nodes[0], nodes[-1]) == (0.0, 3.0)
    sizes = np.diff(nodes)
    assert sizes.max() / sizes.min() == pytest.approx(4.0)
    ratios = np.exp(np.abs(np.diff(np.log(sizes))))
    steps = ratios[ratios > 1 + 1e-12]
    np.testing.assert_allclose(steps, steps[0])  # two cells about the centre may be alike
    mirrored = np.allclose(sizes, sizes[::-1])
    assert mirrored == (fine in ("centre", "ends"))
    smallest = {"left": [0], "right": [cells - 1], "ends": [0, cells - 1], "centre": [(cells - 1) // 2, cells // 2]}
    assert set(np.flatnonzero(np.isclose(sizes, sizes.min()))) == set(smallest[fine])


@pytest.mark.parametrize(("fine", "cells"), [("left", 1), ("centre", 2), ("ends", 1)])
def test_what_cannot_be_graded_stays_even(fine: str, cells: int) -> None:
    np.testing.assert_allclose(np.diff(Grading(fine, 4.0).nodes(1.0, cells)), 1 / cells)  # type: ignore[arg-type]


def test_graded_rectangle_keeps_its_sides() -> None:
    body = rectangle(1.0, 2.0, (4, 6), MPI.COMM_SELF, grading_x=Grading("right", 3.0), grading_y=Grading("bottom", 2.0))
    assert signed_areas(body.cell_corners()).sum() == pytest.approx(2.0)
    corner = body.cell_corners().max(axis=1)
    assert corner[:, 0].min() == pytest.approx(Grading("right", 3.0).nodes(1.0, 4)[1])
    assert integral(body, "right") == pytest.approx(2.0)
    assert [body.is_axis_aligned(name) for name in body.boundaries] == [1, 1, 0, 0]


# -- meshes from files -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["2.2", "4.1"])
@pytest.mark.parametrize("kind", ["quad", "triangle"])
def test_gmsh_file_gives_cells_boundaries_and_regions(version: str, kind: str, tmp_path: Path) -> None:
    file = write_msh(tmp_path / "body.msh", square(5, 4, kind, skewed), version)
    body = read(file, MPI.COMM_SELF, scale=1e-3)
    assert body.mesh.topology.cell_name() == {"quad": "quadrilateral", "triangle": "triangle"}[kind]
    areas = signed_areas(body.cell_corners())
    assert np.all(areas > 0)
    assert areas.sum() == pytest.approx(1e-6)
    assert sorted(body.boundaries) == sorted(SIDES)
    for name, outward in SIDES.items():
        ends, normals = body.facets(name)
        axis, at = int(outward[1] != 0), 1e-3 * (sum(outward) > 0)
        np.testing.assert_allclose(ends[..., axis], at, atol=1e-12)
        np.testing.assert_allclose(normals, np.broadcast_to(outward, normals.shape), atol=1e-9)
        assert integral(body, name) == pytest.approx(1e-3)
        assert body.is_axis_aligned(name) == axis
    both = np.concatenate([body.regions["lower"], body.regions["upper"]])
    np.testing.assert_array_equal(np.sort(both), body.own_cells)
    middles = body.cell_corners().mean(axis=1)[:, 1]
    assert middles[body.regions["lower"]].max() < middles[body.regions["upper"]].min() + 0.1e-3
    assert len(body.regions["upper"]) == len(both) // 2


def test_clockwise_cells_are_turned_and_stray_nodes_dropped(tmp_path: Path) -> None:
    mesh = square(3, 3, "quad", skewed)
    mesh.cells = mesh.cells[:, ::-1]
    mesh.points = np.concatenate([mesh.points, [[40.0, 50.0]]])
    body = read(write_msh(tmp_path / "body.msh", mesh), MPI.COMM_SELF)
    assert np.all(signed_areas(body.cell_corners()) > 0)
    np.testing.assert_allclose(body.extent(), [[0, 0], [1, 1]])
    assert body.mesh.geometry.index_map().size_global == 16


def test_groups_without_names_are_called_by_their_numbers(tmp_path: Path) -> None:
    """Also after a way through a format that knows no names."""
    mesh = square(3, 2)
    file = write_msh(tmp_path / "body.msh", mesh, "2.2", names=False)
    number = {name: str(n) for n, name in enumerate([*mesh.lines, *mesh.regions], start=1)}
    meshio.read(file).write(tmp_path / "body.vtu")
    for form in ("body.msh", "body.vtu"):
        body = read(tmp_path / form, MPI.COMM_SELF)
        assert sorted(body.boundaries) == sorted(number[name] for name in SIDES)
        assert sorted(body.regions) == [number["lower"], number["upper"]]
        assert len(body.boundaries[number["bottom"]]) == 3
        assert body.is_axis_aligned(number["left"]) == 0


def test_cell_of_two_groups_is_one_cell(tmp_path: Path) -> None:
    mesh = square(2, 2)
    mesh.regions["all"] = np.arange(4)
    body = read(write_msh(tmp_path / "body.msh", mesh, "2.2"), MPI.COMM_SELF)
    assert len(body.own_cells) == len(body.regions["all"]) == 4
    assert len(body.regions["lower"]) == 2


def test_lines_inside_the_body_are_no_boundary(tmp_path: Path) -> None:
    mesh = square(2, 2, shuffled=False)
    mesh.lines["middle"] = np.array([[3, 4], [4, 5]])
    assert sorted(read(write_msh(tmp_path / "body.msh", mesh), MPI.COMM_SELF).boundaries) == sorted(SIDES)


def _no_lines(mesh: Mesh) -> None:
    mesh.lines.clear()


def _folded(mesh: Mesh) -> None:
    mesh.points[4] = 1.2, 1.3  # the middle one of three by three


def _flat(mesh: Mesh) -> None:
    mesh.points[4] = mesh.points[1]


def _inverted(mesh: Mesh) -> None:
    mesh.points[4] = 1.6, 0.5


def _out_of_plane(mesh: Mesh) -> None:
    mesh.points = np.pad(mesh.points, ((0, 0), (0, 1)), constant_values=0.25)


def _not_finite(mesh: Mesh) -> None:
    mesh.points[4] = np.nan, 0.5


def _torn(mesh: Mesh) -> None:
    lower = [n for n in range(len(mesh.cells)) if mesh.points[mesh.cells[n], 1].max() < 0.6]
    mesh.points = np.concatenate([mesh.points, mesh.points])
    mesh.cells[lower] += 9
    mesh.lines = {"top": mesh.lines["top"]}


def _doubled_line(mesh: Mesh) -> None:
    mesh.lines["everything"] = np.concatenate(list(mesh.lines.values()))


def _partly_inside(mesh: Mesh) -> None:
    mesh.lines["top"] = np.concatenate([mesh.lines["top"], [[3, 4]]])


def _diagonal(mesh: Mesh) -> None:
    mesh.lines["top"] = np.array([[0, 8]])


@pytest.mark.parametrize(
    ("spoil", "kind", "message"),
    [
        (_no_lines, "quad", r'has no named boundaries: name them in Gmsh as Physical Curve\("top"\)'),
        (_folded, "quad", r"convex and have an area, but \d of 4 are flat or folded, the first at x = [\d.]+ m, y ="),
        (_flat, "triangle", r"convex and have an area, but 2 of 8 are flat or folded, the first at x = "),
        (_inverted, "triangle", r"must not overlap or be inverted, but \d+ sides have two cells on the same side"),
        (_out_of_plane, "quad", "must lie in the plane x3 = 0, but x3 reaches 0.25"),
        (_not_finite, "quad", "coordinates must be finite numbers"),
        (_torn, "quad", r"must form one body, joined by common sides, but they form 2 \(of 2, 2 cells\)"),
        (_doubled_line, "quad", r'must belong to one boundary only, .* belongs to "\w+" and "everything"'),
        (_partly_inside, "quad", r'"top" must be on the surface of the body, but 1 of its 3 lines are not, the first'),
        (_diagonal, "quad", r'"top" must be on the surface of the body, but 1 of its 1 lines'),
    ],
)
def test_meshes_that_cannot_be_used_are_refused(
    spoil: Callable[[Mesh], None], kind: str, message: str, tmp_path: Path
) -> None:
    mesh = square(2, 2, kind, shuffled=False)
    spoil(mesh)
    file = write_msh(tmp_path / "body.msh", mesh)
    with pytest.raises(MeshError, match=message) as caught:
        read(file, MPI.COMM_SELF)
    assert str(caught.value).startswith(f"{file}: ")
    assert "\n" not in str(caught.value)


def test_elements_without_a_group_are_refused(tmp_path: Path) -> None:
    """They are in the file on request only, and meshio does not tell which are which."""
    file = write_msh(tmp_path / "body.msh", square(2, 2))
    file.write_text(file.read_text().replace(" 1 4 0\n", " 0 0\n"))
    with pytest.raises(MeshError, match=r"elements are in no physical group: save it without .*Mesh.SaveAll = 0"):
        read(file, MPI.COMM_SELF)


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        (
            [("quad", [[0, 1, 4, 3]]), ("triangle", [[1, 2, 4], [2, 5, 4]])],
            "all of type triangle or all of type quad, but there are 1 of type quad, 2 of type triangle",
        ),
        ([("triangle6", [[0, 2, 5, 1, 4, 3]])], "first order, but there are 1 of type triangle6: save it so"),
        ([("tetra", [[0, 1, 2, 3]])], "all of type triangle or all of type quad, but there are 1 of type tetra"),
        ([("line", [[0, 1]])], "there are none"),
    ],
)
def test_other_cells_are_refused(cells: list[tuple[str, list[list[int]]]], message: str, tmp_path: Path) -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]])
    meshio.Mesh(points, cells).write(tmp_path / "body.vtu")
    with pytest.raises(MeshError, match=message):
        read(tmp_path / "body.vtu", MPI.COMM_SELF)


@pytest.mark.parametrize(("name", "content"), [("body.msh", "no mesh\n"), ("body.txt", "1 2"), ("body.vtu", "<xml")])
def test_files_that_are_no_meshes_are_refused(
    name: str, content: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(MeshError, match=rf"{name}: cannot be read as a mesh file: \S"):
        read(tmp_path / name, MPI.COMM_SELF)
    with pytest.raises(MeshError, match="cannot be read as a mesh file"):
        read(tmp_path / "nowhere.msh", MPI.COMM_SELF)
    assert capfd.readouterr() == ("", "")


# -- what boundaries and cells are asked for -------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["quad", "triangle"])
def test_normals_of_a_curved_boundary(kind: str, tmp_path: Path) -> None:
    """Chords of n equal arcs: at inner nodes exactly radial, at the ends and middles that of the chord."""
    n = 6
    body = read(write_msh(tmp_path / "ring.msh", square(3, n, kind, quarter_ring)), MPI.COMM_SELF)
    inner, outer = BoundaryNormals(body, "left"), BoundaryNormals(body, "right")
    step = math.pi / 2 / n
    nodes = step * np.arange(1, n)
    radial = np.stack([np.cos(nodes), np.sin(nodes)], axis=1)
    np.testing.assert_allclose(outer(2 * radial), radial, atol=1e-12)
    np.testing.assert_allclose(inner(radial), -radial, atol=1e-12)
    chords = step * (np.arange(n) + 0.5)
    middle = np.stack([np.cos(chords), np.sin(chords)], axis=1)
    np.testing.assert_allclose(outer(2 * math.cos(step / 2) * middle), middle, atol=1e-12)
    np.testing.assert_allclose(outer(np.array([[2.0, 0.0]])), middle[:1], atol=1e-12)
    np.testing.assert_allclose(BoundaryNormals(body, "bottom")(np.array([[1.0, 0.0]])), [[0, -1]], atol=1e-12)
    assert body.is_axis_aligned("right") is None
    assert [body.is_axis_aligned(name) for name in ("bottom", "top")] == [1, 0]


def test_normal_at_a_corner_of_one_boundary_conserves_flux(tmp_path: Path) -> None:
    """A boundary round a corner: there, the mean of its sides' normals weighted by their lengths."""
    mesh = square(2, 4)
    mesh.lines = {"wall": np.concatenate([mesh.lines["bottom"], mesh.lines["right"]])}
    body = read(write_msh(tmp_path / "body.msh", mesh), MPI.COMM_SELF)
    at = np.array([[1.0, 0.0], [0.5, 0.0], [1.0, 0.5]])
    expected = np.array([[0.25 / math.hypot(0.25, 0.5), -0.5 / math.hypot(0.25, 0.5)], [0, -1], [1, 0]])
    np.testing.assert_allclose(BoundaryNormals(body, "wall")(at), expected, atol=1e-12)
    assert body.is_axis_aligned("wall") is None


@pytest.mark.parametrize(
    ("d50", "warned", "refused"), [(0.5e-3, False, False), (0.2e-3, True, False), (0.09e-3, False, True)]
)
def test_element_size_is_compared_with_the_grains(d50: float, warned: bool, refused: bool) -> None:
    body = rectangle(0.01, 0.02, (10, 20), MPI.COMM_SELF)
    report = size_report(body, d50)
    assert report.smallest == pytest.approx(1e-3 / d50)
    assert [report.median, report.largest] == pytest.approx([report.smallest] * 2)
    assert (report.warning is not None, report.error is not None) == (warned, refused)
    told = report.warning or report.error or ""
    assert f"{1e-3 / d50:.3g} d50 = 0.001 m" in told or not told


def test_element_sizes_of_a_layer_are_their_heights() -> None:
    assert layer(0.04, 8, MPI.COMM_SELF).cell_sizes() == pytest.approx(0.005)


def test_large_elements_anywhere_are_warned_of() -> None:
    report = size_report(rectangle(1.0, 0.1, (11, 1), MPI.COMM_SELF, grading_x=Grading("left", 30.0)), 0.04)
    assert report.median < 4 < report.largest
    assert report.warning is not None


# -- on several ranks ------------------------------------------------------------------------------------------------

DESCRIBE = """
import json, sys
from pathlib import Path
import numpy as np
import ufl
from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.meshes.sizes import size_report
from cosserat_fx.geometry import Grading, rectangle
from cosserat_fx.meshes.file import MeshError, read
from cosserat_fx.meshes.normals import BoundaryNormals

comm = MPI.COMM_WORLD
def gathered(values):
    rows = np.concatenate(comm.allgather(np.asarray(values, dtype=float)))
    return rows[np.lexsort(np.round(rows, 9).T)].tolist()
def described(body):
    found = {"extent": body.extent().tolist(), "sizes": gathered(body.cell_sizes()[:, None])}
    found["size"] = list(size_report(body, 0.05).__dict__.values())[:3]
    for name in sorted(body.boundaries):
        ends, normals = body.facets(name)
        found[name] = gathered(np.hstack([ends.mean(axis=1), normals]))
        found[name + " aligned"] = body.is_axis_aligned(name)
        ds = ufl.Measure("ds", body.mesh, subdomain_data=body.facet_tags([name]))(0)
        form = dolfinx.fem.form(dolfinx.fem.Constant(body.mesh, 1.0) * ds)
        found[name + " length"] = comm.allreduce(dolfinx.fem.assemble_scalar(form))
        space = dolfinx.fem.functionspace(body.mesh, ("Lagrange", 2))
        dofs = dolfinx.fem.locate_dofs_topological(space, 1, body.boundaries[name])
        at = space.tabulate_dof_coordinates()[dofs[dofs < space.dofmap.index_map.size_local], :2]
        found[name + " normals"] = gathered(np.hstack([at, BoundaryNormals(body, name)(at)]))
    for name, cells in body.regions.items():
        found[name] = gathered(body.cell_corners()[cells].mean(axis=1))
    return found
found = [described(read(Path(name), comm, scale=0.5)) for name in sys.argv[1:-1]]
found.append(described(rectangle(1.0, 2.0, (2, 1), comm, grading_x=Grading("left", 2.0))))
try:
    read(Path(sys.argv[-1]), comm)
except MeshError as error:
    found.append(sorted(set(comm.allgather(str(error)))))
if comm.rank == 0:
    print(json.dumps(found))
"""


def test_ranks_share_one_body(tmp_path: Path) -> None:
    """Boundaries, regions, normals at the ranks' borders, sizes; more ranks than cells; an error told alike."""
    files = [
        write_msh(tmp_path / f"{kind}.msh", square(4, 6, kind, shape))
        for kind, shape in (("quad", quarter_ring), ("triangle", skewed))
    ]
    broken = square(2, 2, shape=identity)
    broken.lines.clear()
    files.append(write_msh(tmp_path / "broken.msh", broken))
    one, two, three = (json.loads(on_ranks(ranks, DESCRIBE, *files)) for ranks in (1, 2, 3))
    assert one[-1] == [f"{files[-1]}: has no named boundaries: {one[-1][0].partition('boundaries: ')[2]}"]
    assert len(one[0]["right normals"]) == 13
    assert one[0]["right length"] == pytest.approx(6 * 2 * math.sin(math.pi / 24))
    for several in (two, three):
        assert several[-1] == one[-1]
        for here, there in zip(one[:-1], several[:-1], strict=True):
            assert here.keys() == there.keys()
            for key, value in here.items():
                expected: Array = np.array(value, dtype=float)
                np.testing.assert_allclose(np.array(there[key], dtype=float), expected, atol=1e-12, err_msg=key)
