"""Plane meshes read from files, with their named groups as boundaries and regions.

meshio reads; what it finds is checked on the first rank, then shared out. Gmsh's physical groups keep their names, and
groups without a name (as where a mesh went through a format that drops names) are called by their numbers. Groups of
lines on the body's surface become boundaries, groups of cells become regions; lines inside the body are left out.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from cosserat_fx._compat import MPI, dolfinx, entity_nodes
from cosserat_fx.geometry import Cell, Geometry, distribute
from cosserat_fx.guard import bounded
from cosserat_fx.meshes.checks import Indices, MeshError, counter_clockwise, pair_keys, surface_groups, surface_sides
from cosserat_fx.meshes.examination import examine
from cosserat_fx.parallel import on_first_rank
from cosserat_fx.typing import Array, IntArray

__all__ = ["MeshError", "PlaneMesh", "load", "read", "read_with_meshio"]

FLAT = 1e-9
"""Largest x3 of a plane mesh over its extent."""

_LONGEST_REASON = 200
"""Characters of what a reader says that are passed on."""
_CELLS: Mapping[str, Cell] = {"triangle": "triangle", "quad": "quadrilateral"}
_CORNERS = {"line": 2, "triangle": 3, "quad": 4}


@dataclass(frozen=True)
class PlaneMesh:
    """What a file holds, checked, before it is shared out.

    Attributes:
        cell: the kind of all cells.
        points: (n, 2) coordinates of the nodes (m), each the corner of a cell.
        cells: (m, corners) nodes of each cell, counter-clockwise.
        boundaries: (k, 2) nodes of each boundary's sides, the lower one first.
        regions: cells of each region.
    """

    cell: Cell
    points: Array
    cells: Indices
    boundaries: Mapping[str, Indices]
    regions: Mapping[str, Indices]


def read(file: Path, comm: MPI.Intracomm = MPI.COMM_WORLD, *, scale: float = 1.0) -> Geometry:
    """A plane body from a file. Collective.

    Args:
        file: of a format that meshio reads, with triangles or quadrilaterals (not both) of first order in the plane of
            x1 and x2. Cells whose corners run clockwise are turned round, nodes of no cell are dropped.
        comm: the ranks that share it.
        scale: m per unit of the file.

    Raises:
        MeshError: on every rank, where the file cannot be read or its mesh cannot be used.
    """
    found = on_first_rank(comm, lambda: load(file, scale))
    tensor_order = [0, 1, 2] if found.cell == "triangle" else [0, 1, 3, 2]
    mesh = distribute(comm, found.cell, found.points, found.cells[:, tensor_order])

    mesh.topology.create_connectivity(1, 2)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    sides = pair_keys(mesh.geometry.input_global_indices[entity_nodes(mesh, 1, facets)], len(found.points))
    boundaries = {
        name: facets[np.isin(sides, pair_keys(lines, len(found.points)))].astype(np.int32)
        for name, lines in found.boundaries.items()
    }
    number = mesh.topology.original_cell_index[: mesh.topology.index_map(2).size_local]
    regions: dict[str, IntArray] = {
        name: np.flatnonzero(np.isin(number, cells)).astype(np.int32) for name, cells in found.regions.items()
    }
    return Geometry(mesh, "plane", boundaries, regions)


def load(file: Path, scale: float) -> PlaneMesh:
    """Read and check a file on this rank alone.

    Args:
        file: as for :func:`read`.
        scale: m per unit of the file.

    Raises:
        MeshError: the file cannot be read or its mesh cannot be used.
    """
    raw = read_with_meshio(file)
    kind = _only_kind(file, raw)
    with np.errstate(all="ignore"):  # what comes of numbers too large or too small is refused
        points = _plane_points(file, raw, scale)
        cells, cell_groups = _gather(raw, kind)
        lines, line_groups = _gather(raw, "line")
        cells = counter_clockwise(file, points, cells)
    # A cell of several groups may be in the file once for each.
    _, first, same = np.unique(np.sort(cells, axis=1), axis=0, return_index=True, return_inverse=True)
    cells, regions = cells[first], {name: np.unique(same.reshape(-1)[them]) for name, them in cell_groups.items()}
    surface = surface_sides(file, points, cells)
    named = {name: np.sort(lines[them], axis=1) for name, them in line_groups.items()}
    boundaries = surface_groups(file, points, named, cells, surface)

    used, renumbered = np.unique(cells, return_inverse=True)
    return PlaneMesh(
        _CELLS[kind],
        np.ascontiguousarray(points[used]),
        renumbered.reshape(cells.shape),
        {name: np.searchsorted(used, sides) for name, sides in boundaries.items()},
        regions,
    )


def read_with_meshio(file: Path) -> meshio.Mesh:
    """The content of a mesh file.

    Raises:
        MeshError: meshio cannot read it.
    """
    reason, said = "", io.StringIO()
    try:
        size = examine(file)
        with bounded(size) as said:
            return meshio.read(file)
    except MeshError:
        raise
    except OSError as error:
        reason = error.strerror or str(error)
    except MemoryError:
        reason = "reading it would take more memory than a file of its size should or this machine has"
    except ModuleNotFoundError as error:
        reason = f"its format needs the Python package {error.name}, which is not installed"
    except SystemExit:  # some of meshio's readers print what is wrong and leave the program
        reason = said.getvalue().partition("Error: Couldn't read file")[0]
    except Exception as error:  # readers fail on malformed files in every way there is
        reason = str(error) if isinstance(error, meshio.ReadError | ValueError) else ""
    reason = " ".join(reason.split())[:_LONGEST_REASON] or "its content is malformed"
    if "gmsh:physical" in reason:
        reason = "some of its elements are in no physical group: save it without them (in Gmsh, Mesh.SaveAll = 0)"
    raise MeshError(f"{file}: cannot be read as a mesh file: {reason}")


def _only_kind(file: Path, raw: meshio.Mesh) -> str:
    """Returns meshio's name of the one kind of cells that the mesh has."""
    counts: dict[str, int] = {}
    for block in raw.cells:
        if block.dim > 1 or block.type not in ("line", "vertex"):
            counts[block.type] = counts.get(block.type, 0) + len(block.data)
    found = ", ".join(f"{count} of type {kind}" for kind, count in counts.items()) or "none"
    higher = [kind for kind in counts if kind not in _CELLS and kind.startswith(("line", "triangle", "quad"))]
    if higher:
        raise MeshError(
            f"{file}: cells must be of first order, but there are {found}: save it so (in Gmsh, Mesh.ElementOrder = 1)"
        )
    if len(counts) != 1 or not counts.keys() <= _CELLS.keys():
        raise MeshError(f"{file}: cells must be all of type triangle or all of type quad, but there are {found}")
    return next(iter(counts))


def _plane_points(file: Path, raw: meshio.Mesh, scale: float) -> Array:
    """Coordinates in the plane, (n, 2) (m).

    Raises:
        MeshError: they are no numbers or leave the plane, or cells have nodes that are not in the file.
    """
    for block in raw.cells:
        if len(block.data) and not (np.min(block.data) >= 0 and np.max(block.data) < len(raw.points)):
            raise MeshError(f"{file}: cells must have nodes that are in the file")
    points: Array = np.asarray(raw.points, dtype=np.float64) * scale
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise MeshError(f"{file}: must have two or three coordinates of each node")
    if not np.isfinite(points).all():
        raise MeshError(f"{file}: coordinates must be finite numbers")
    out = np.abs(points[:, 2:]).max(initial=0.0)
    if out > FLAT * np.ptp(points[:, :2], axis=0).max(initial=0.0):
        raise MeshError(f"{file}: must lie in the plane x3 = 0, but x3 reaches {out:g} m")
    return points[:, :2]


def _gather(raw: meshio.Mesh, kind: str) -> tuple[Indices, dict[str, Indices]]:
    """All cells of a kind, (m, corners), and those of each group by its name."""
    blocks, groups, count = [np.empty((0, _CORNERS[kind]), dtype=np.int64)], dict[str, list[Indices]](), 0
    for number, block in enumerate(raw.cells):
        if block.type == kind:
            for name, members in _groups(raw, number).items():
                groups.setdefault(name, []).append(members + count)
            blocks.append(np.asarray(block.data, dtype=np.int64))
            count += len(block.data)
    return np.concatenate(blocks), {name: np.concatenate(members) for name, members in groups.items()}


def _groups(raw: meshio.Mesh, number: int) -> dict[str, Indices]:
    """Members of the groups of a block of cells by name, or by number where a group has no name; without empty ones."""
    dimension = raw.cells[number].dim
    named = {name: sets[number] for name, sets in raw.cell_sets.items() if not name.startswith("gmsh:")}
    names = {int(tag): name for name, (tag, dim) in raw.field_data.items() if dim == dimension}
    tags = raw.cell_data["gmsh:physical"][number] if "gmsh:physical" in raw.cell_data else np.zeros(0, dtype=np.int64)
    for tag in np.unique(tags[tags > 0]):
        named.setdefault(names.get(int(tag), str(tag)), np.flatnonzero(tags == tag))
    return {name: np.asarray(them, dtype=np.int64) for name, them in named.items() if them is not None and len(them)}
