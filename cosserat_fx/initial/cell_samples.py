"""Samples of cells, by which something that cells are cut by is shared out to their quadrature points."""

from __future__ import annotations

from dataclasses import dataclass

import basix.ufl
import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array, eye_array, kron, vstack
from scipy.spatial.distance import cdist

from cosserat_fx.typing import Array


@dataclass(frozen=True)
class Samples:
    """Points in cells and the parts of the cells that they stand for.

    Attributes:
        positions: (cells, samples, 2) coordinates (m), x1 = 0 in a layer.
        sizes: (cells, samples, 2) extents of the parts along the axes (m).
        measures: (cells, samples) lengths of the parts (m) or areas (m2; of triangles twice that).
    """

    positions: Array
    sizes: Array
    measures: Array


def map_to_cells(cell: str, corners: Array, points: Array, parts: int = 1) -> Samples:
    """Map points of the reference cell to cells with straight sides.

    Args:
        cell: "interval", "quadrilateral" or "triangle".
        corners: (cells, corners, gdim) of the cells, in the order of DOLFINx (m).
        points: (samples, dim) of the reference cell.
        parts: number of parts of each side of the reference cell that the points are the middles of.
    """
    values, *derivatives = basix.ufl.element("Lagrange", cell, 1).tabulate(1, points)
    positions = np.einsum("sk,cki->csi", values, corners)
    sides = np.stack([np.einsum("sk,cki->csi", d, corners) for d in derivatives], axis=2) / parts
    if corners.shape[2] == 1:
        measures = np.abs(sides[:, :, 0, 0])
        across = ((0, 0), (0, 0), (1, 0))
        return Samples(np.pad(positions, across), np.pad(np.abs(sides[:, :, 0]), across), measures)
    if corners.shape[1] == 3:
        ends = np.concatenate([np.zeros_like(sides[:, :, :1]), sides], axis=2)
        sizes = np.ptp(ends, axis=2)
    else:
        sizes = np.abs(sides).sum(axis=2)
    return Samples(
        positions, sizes, np.abs(sides[:, :, 0, 0] * sides[:, :, 1, 1] - sides[:, :, 0, 1] * sides[:, :, 1, 0])
    )


def reference_samples(cell: str, parts: int) -> Array:
    """Middles of equal parts of a reference cell, (parts^dim, dim).

    Args:
        cell: "interval", "quadrilateral" or "triangle".
        parts: of each side.
    """
    steps = np.arange(parts, dtype=np.float64)
    if cell == "interval":
        return ((steps + 1 / 2) / parts)[:, None]
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    if cell == "quadrilateral":
        return (grid + 1 / 2) / parts
    level = grid.sum(axis=1)
    return np.concatenate([grid[level < parts] + 1 / 3, grid[level < parts - 1] + 2 / 3]) / parts


def share_out(samples: Array, points: Array, weights: Array) -> Array:
    """Shares of the samples that belong to each quadrature point, (points, samples), summing up to 1 in all.

    Each point gets as much as its weight, from the samples nearest to it: the plan of least mean square distance
    (optimal transport). Integrals over the samples and with the rule are then the same.

    Args:
        samples: (samples, dim) of equal parts of the reference cell.
        points: (points, dim) of the rule.
        weights: (points,), positive.
    """
    n, m = len(points), len(samples)
    from_samples = kron(np.ones((1, n)), eye_array(m))
    to_points = kron(eye_array(n), np.ones((1, m)))
    # The last condition follows from the others.
    conditions = csr_array(vstack([from_samples, to_points]))[:-1]
    amounts = np.concatenate([np.full(m, 1 / m), weights / weights.sum()])[:-1]
    plan = linprog(cdist(points, samples, "sqeuclidean").reshape(-1), A_eq=conditions, b_eq=amounts, method="highs")
    shares: Array = plan.x.reshape(n, m)
    return shares
