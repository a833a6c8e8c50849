"""What has to hold of the cells and named lines of a plane mesh, and what follows from them: surface and boundaries."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cosserat_fx.text import printable
from cosserat_fx.typing import Array

Indices = npt.NDArray[np.int64]

SHARP = 1e-6
"""Smallest sine of a corner's angle."""

_HOW_TO_NAME = 'name them in Gmsh as Physical Curve("top") = {3}; and save the mesh with these groups'


class MeshError(ValueError):
    """A mesh file that cannot be used; the message names the file and what is allowed."""

    def __init__(self, message: str) -> None:
        """Keeps the message in one line, though names in it may come from a file."""
        super().__init__(printable(message))


def counter_clockwise(file: Path, points: Array, cells: Indices) -> Indices:
    """The cells with their corners in counter-clockwise order.

    Raises:
        MeshError: a cell is flat or, having corners of both turns, folded or not convex.
    """
    at = points[cells]
    back, ahead = np.roll(at, 1, axis=1) - at, np.roll(at, -1, axis=1) - at
    turns = ahead[..., 0] * back[..., 1] - ahead[..., 1] * back[..., 0]
    sides = np.linalg.norm(back, axis=2) * np.linalg.norm(ahead, axis=2)
    left, right = np.all(turns > SHARP * sides, axis=1), np.all(turns < -SHARP * sides, axis=1)
    if bad := np.flatnonzero(~left & ~right).tolist():
        x, y = at[bad[0]].mean(axis=0)
        raise MeshError(
            f"{file}: cells must be convex and have an area, but {len(bad)} of {len(cells)} are flat or folded, the "
            f"first at x = {x:.6g} m, y = {y:.6g} m"
        )
    turned: Indices = np.where(right[:, None], cells[:, ::-1], cells)
    return turned


def _cell_sides(cells: Indices) -> Indices:
    """The sides of cells, (cells * sides, 2), along the order of the corners."""
    return np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)


def surface_sides(file: Path, points: Array, cells: Indices) -> Indices:
    """The sides that belong to one cell only, (m, 2).

    Raises:
        MeshError: cells overlap, or form several bodies.
    """
    directed = _cell_sides(cells)
    ways, cells_left = np.unique(directed, axis=0, return_counts=True)
    if np.any(cells_left > 1):
        x, y = points[ways[cells_left > 1][0]].mean(axis=0)
        raise MeshError(
            f"{file}: cells must not overlap or be inverted, but {np.sum(cells_left > 1)} sides have two cells on the "
            f"same side of them, the first at x = {x:.6g} m, y = {y:.6g} m"
        )
    sides, whose, count = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    owner = np.repeat(np.arange(len(cells)), cells.shape[1])
    touches = coo_array((np.ones(len(owner)), (owner, whose.reshape(-1))), shape=(len(cells), len(sides)))
    bodies, member = connected_components(touches @ touches.T, directed=False)
    if bodies > 1:
        sizes = ", ".join(str(size) for size in np.sort(np.bincount(member))[::-1][:5])
        raise MeshError(
            f"{file}: cells must form one body, joined by common sides, but they form {bodies} (of {sizes}"
            f"{', ...' if bodies > 5 else ''} cells): merge the nodes where they touch (in Gmsh, Coherence)"
        )
    alone: Indices = sides[count == 1]
    return alone


def surface_groups(
    file: Path, points: Array, named: Mapping[str, Indices], cells: Indices, surface: Indices
) -> dict[str, Indices]:
    """Those groups of lines that are on the body's surface.

    Args:
        file: for messages.
        points: (n, 2) coordinates (m).
        named: lines of each group, the lower node first.
        cells: the cells.
        surface: sides of the body's surface.

    Raises:
        MeshError: there is none, one is partly inside the body or none of its sides, or two have a side in common.
    """
    on_surface, on_cells = pair_keys(surface, len(points)), pair_keys(_cell_sides(cells), len(points))
    boundaries: dict[str, Indices] = {}
    taken: dict[int, str] = {}
    for name, lines in named.items():
        keys = pair_keys(lines, len(points))
        good = np.isin(keys, on_surface)
        if not good.any() and np.isin(keys, on_cells).all():
            continue  # a line inside the body
        if not good.all():
            x, y = points[lines[~good][0]].mean(axis=0)
            raise MeshError(
                f'{file}: boundary "{name}" must be on the surface of the body, but {np.sum(~good)} of its '
                f"{len(lines)} lines are not, the first at x = {x:.6g} m, y = {y:.6g} m"
            )
        for key, line in zip(keys.tolist(), lines, strict=True):
            other = taken.setdefault(key, name)
            if other != name:
                x, y = points[line].mean(axis=0)
                raise MeshError(
                    f"{file}: a side must belong to one boundary only, but that at x = {x:.6g} m, y = {y:.6g} m "
                    f'belongs to "{other}" and "{name}"'
                )
        boundaries[name] = np.unique(lines, axis=0)
    if not boundaries:
        raise MeshError(f"{file}: has no named boundaries: {_HOW_TO_NAME}")
    return boundaries


def pair_keys(pairs: Indices, nodes: int) -> Indices:
    """One number for each pair of nodes, whatever their order."""
    return pairs.min(axis=1) * nodes + pairs.max(axis=1)
