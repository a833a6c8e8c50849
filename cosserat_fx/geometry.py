"""Meshes and their named boundaries and regions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import basix.ufl
import numpy as np
import numpy.typing as npt

from cosserat_fx._compat import MPI, dolfinx, entity_nodes
from cosserat_fx.layout import Dimension
from cosserat_fx.typing import Array, IntArray

STRAIGHT = 1e-6
"""How large the other component of a unit normal may be on a boundary that counts as aligned with an axis."""

Cell = Literal["quadrilateral", "triangle"]


@dataclass(frozen=True)
class Geometry:
    """A mesh, the dimension its fields live in, and its boundaries and regions by name.

    Attributes:
        mesh: coordinates in m; a layer's only coordinate is x2.
        dimension: "layer", "plane" or "solid".
        boundaries: facets of each named boundary (local indices of this rank); every facet is on one rank.
        regions: cells of each named region (local indices of this rank's own cells, ascending).
    """

    mesh: dolfinx.mesh.Mesh
    dimension: Dimension
    boundaries: Mapping[str, IntArray]
    regions: Mapping[str, IntArray] = field(default_factory=dict)

    def facet_tags(self, names: list[str]) -> dolfinx.mesh.MeshTags:
        """Facets of several boundaries tagged by the position of their name in the list."""
        facets = np.concatenate([self.boundaries[name] for name in names])
        tags = np.concatenate([np.full(len(self.boundaries[n]), k, dtype=np.int32) for k, n in enumerate(names)])
        order = np.argsort(facets)
        return dolfinx.mesh.meshtags(self.mesh, self.mesh.topology.dim - 1, facets[order], tags[order])

    @property
    def own_cells(self) -> IntArray:
        """This rank's own cells."""
        return np.arange(self.mesh.topology.index_map(self.mesh.topology.dim).size_local, dtype=np.int32)

    def cell_corners(self) -> Array:
        """Corners of this rank's own cells, (cells, corners, gdim), in DOLFINx's order (m)."""
        return corners(self.mesh, self.mesh.topology.dim, self.own_cells)

    def cell_sizes(self) -> Array:
        """Characteristic sizes of this rank's own cells (m): lengths in a layer, roots of the areas in the plane."""
        at = self.cell_corners()
        return np.abs(at[:, 1, 0] - at[:, 0, 0]) if self.dimension == "layer" else np.sqrt(np.abs(signed_areas(at)))

    def extent(self) -> Array:
        """Lowest and highest coordinates of the body, (2, gdim) (m). Collective."""
        at = self.mesh.geometry.x[:, : self.mesh.geometry.dim]
        low, high = at.min(axis=0, initial=np.inf), at.max(axis=0, initial=-np.inf)
        lows, highs = zip(*self.mesh.comm.allgather((low, high)), strict=True)
        return np.array([np.min(lows, axis=0), np.max(highs, axis=0)])

    @property
    def smallest_extent(self) -> float:
        """The body's extent along the axis along which it is smallest (m). Collective."""
        low, high = self.extent()
        return float(np.min(high - low))

    def facets(self, name: str) -> tuple[Array, Array]:
        """Both ends of this rank's facets of a plane body's boundary, (m, 2, 2) (m), and unit outward normals, (m, 2).

        The normals are those of the undeformed body.
        """
        mesh, facets = self.mesh, self.boundaries[name]
        mesh.topology.create_connectivity(1, 2)
        to_cells = mesh.topology.connectivity(1, 2)
        cells = np.array([to_cells.links(facet)[0] for facet in facets], dtype=np.int32)
        ends = corners(mesh, 1, facets)
        along = ends[:, 1] - ends[:, 0]
        normals = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
        outward = ends.mean(axis=1) - corners(mesh, 2, cells).mean(axis=1)
        return ends, normals * np.sign(np.sum(outward * normals, axis=1, keepdims=True))

    def is_axis_aligned(self, name: str) -> int | None:
        """The axis that a plane body's boundary is normal to all along it: 0 for x1, 1 for x2, or None. Collective."""
        _, normals = self.facets(name)
        largest = np.max(self.mesh.comm.allgather(np.abs(normals).max(axis=0, initial=0.0)), axis=0)
        return next((axis for axis in (0, 1) if largest[1 - axis] < STRAIGHT), None)


@dataclass(frozen=True)
class Grading:
    """How the cells along one side of a rectangle grow, in geometric progression.

    Attributes:
        fine: where the smallest cells are: at the start of the side ("left", "bottom"), at its end ("right", "top"),
            in its middle ("centre") or at both of its ends ("ends").
        ratio: length of the largest over that of the smallest cell, at least 1. Where all cells are alike by symmetry
            (one cell; two cells about the centre), there is nothing to grade.
    """

    fine: Literal["left", "bottom", "right", "top", "centre", "ends"]
    ratio: float

    def nodes(self, length: float, cells: int) -> Array:
        """Coordinates of the cells' ends, (cells + 1,), from 0 to the length (m)."""
        place = np.arange(cells, dtype=np.float64)
        coarse = {"left": place, "bottom": place, "centre": np.abs(2 * place - (cells - 1))}
        rank = coarse[self.fine] if self.fine in coarse else -coarse["centre" if self.fine == "ends" else "left"]
        rank = rank - rank.min()
        sizes = self.ratio ** (rank / max(rank.max(), 1.0))
        ends = np.concatenate([[0.0], np.cumsum(sizes)])
        nodes: Array = length * (ends / ends[-1])
        return nodes


def layer(height: float, cells: int, comm: MPI.Intracomm = MPI.COMM_WORLD) -> Geometry:
    """An infinite layer: a mesh of its height with the boundaries "bottom" and "top".

    Args:
        height: of the layer (m).
        cells: number of equal elements over the height.
        comm: the ranks that share it.
    """
    mesh = dolfinx.mesh.create_interval(comm, cells, [0.0, height])
    boundaries = {
        name: dolfinx.mesh.locate_entities_boundary(
            mesh, 0, lambda x, y=y: np.isclose(x[0], y, rtol=0, atol=1e-9 * height)
        )
        for name, y in (("bottom", 0.0), ("top", height))
    }
    return Geometry(mesh, "layer", boundaries)


def rectangle(
    width: float,
    height: float,
    cells: tuple[int, int],
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    *,
    grading_x: Grading | None = None,
    grading_y: Grading | None = None,
) -> Geometry:
    """A rectangle of quadrilaterals with the boundaries "bottom", "top", "left" and "right".

    Its lower left corner is the origin. All ranks hold whole cells of their own and no ghosts, as nothing is integrated
    over interior facets.

    Args:
        width: extent along x1 (m).
        height: extent along x2 (m).
        cells: numbers of cells along x1 and x2.
        comm: the ranks that share it.
        grading_x: how the cells grow along x1; None: all alike.
        grading_y: the same along x2.
    """
    even = Grading("left", 1.0)
    x = (grading_x or even).nodes(width, cells[0])
    y = (grading_y or even).nodes(height, cells[1])
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    row = len(x)
    lower_left = (row * np.arange(cells[1])[:, None] + np.arange(cells[0])).reshape(-1)
    mesh = distribute(comm, "quadrilateral", points, lower_left[:, None] + np.array([0, 1, row, row + 1]))
    planes = {"bottom": (1, 0.0), "top": (1, height), "left": (0, 0.0), "right": (0, width)}
    boundaries = {
        name: dolfinx.mesh.locate_entities_boundary(
            mesh, 1, lambda x, axis=axis, at=at: np.isclose(x[axis], at, rtol=0, atol=1e-9 * min(width, height))
        )
        for name, (axis, at) in planes.items()
    }
    return Geometry(mesh, "plane", boundaries)


def distribute(comm: MPI.Intracomm, cell: Cell, points: Array, cells: npt.NDArray[np.int64]) -> dolfinx.mesh.Mesh:
    """A plane mesh of points and cells shared out among the ranks, without ghosts.

    Args:
        comm: the ranks.
        cell: the kind of the cells.
        points: (n, 2) coordinates (m), alike on all ranks; those of the first are used.
        cells: (m, corners) indices of the corners in DOLFINx's order (a quadrilateral's row by row), the same.
    """
    element = basix.ufl.element("Lagrange", cell, 1, shape=(2,))
    mine = slice(None) if comm.rank == 0 else slice(0)
    return dolfinx.mesh.create_mesh(
        comm, cells=np.asarray(cells[mine], dtype=np.int64), x=np.ascontiguousarray(points[mine]), e=element
    )


def corners(mesh: dolfinx.mesh.Mesh, dim: int, entities: IntArray) -> Array:
    """Corners of entities of a topological dimension, (entities, corners, gdim), in DOLFINx's order (m)."""
    at: Array = mesh.geometry.x[entity_nodes(mesh, dim, entities), : mesh.geometry.dim]
    return at


def signed_areas(corners: Array) -> Array:
    """Areas of plane triangles and quadrilaterals, negative where the order of the corners is clockwise.

    Args:
        corners: (cells, 3 or 4, 2) in DOLFINx's order.
    """
    around = corners if corners.shape[1] == 3 else corners[:, [0, 1, 3, 2]]
    following = np.roll(around, -1, axis=1)
    areas: Array = np.sum(around[..., 0] * following[..., 1] - around[..., 1] * following[..., 0], axis=1) / 2
    return areas
