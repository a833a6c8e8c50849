"""Normals of a boundary at its nodes, wherever on a curved boundary they are asked for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from cosserat_fx.geometry import Geometry
from cosserat_fx.typing import Array

_OPPOSED = 1e-6
"""Length of the mean of unit normals below which they cancel."""


class BoundaryNormals:
    """Unit outward normals at the nodes of one boundary of a plane body, alike on every rank.

    At a corner of cells it is the mean of the normals of those of the boundary's facets that meet there, weighted by
    their lengths (the normal that conserves flux: Engelman, Sani and Gresho, Int. J. Numer. Methods Fluids 2 (1982),
    225-238), and on a facet's middle the facet's own. Other points take the normal of the nearest of these, which is
    exact on straight boundaries.
    """

    def __init__(self, geometry: Geometry, name: str) -> None:
        """Gather a boundary's facets. Collective.

        Args:
            geometry: of the undeformed body.
            name: of the boundary.

        Raises:
            ValueError: the boundary has no facets, or some that face each other at a node.
        """
        gathered = geometry.mesh.comm.allgather(geometry.facets(name))
        ends, normals = (np.concatenate(parts) for parts in zip(*gathered, strict=True))
        if not len(ends):
            raise ValueError(f'boundary "{name}" has no facets')
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        nodes, of_end = _merge(ends.reshape(-1, 2), within=1e-6 * float(lengths.min()))
        sums, total = np.zeros_like(nodes), np.zeros(len(nodes))
        np.add.at(sums, of_end, np.repeat(normals * lengths[:, None], 2, axis=0))
        np.add.at(total, of_end, np.repeat(lengths, 2))
        size = np.linalg.norm(sums, axis=1)
        if np.any(size < _OPPOSED * total):
            x, y = nodes[size < _OPPOSED * total][0]
            raise ValueError(f'boundary "{name}" has sides that face each other at x = {x:.6g} m, y = {y:.6g} m')
        self._normals: Array = np.concatenate([sums / size[:, None], normals])
        self._places = KDTree(np.concatenate([nodes, ends.mean(axis=1)]))

    def __call__(self, coordinates: Array) -> Array:
        """Normals at points of the boundary.

        Args:
            coordinates: (m, 2), of the undeformed body (m).

        Returns:
            (m, 2) unit vectors.
        """
        _, nearest = self._places.query(np.asarray(coordinates, dtype=np.float64).reshape(-1, 2))
        found: Array = self._normals[nearest]
        return found


def _merge(points: Array, within: float) -> tuple[Array, npt.NDArray[np.int64]]:
    """Distinct points, in an order of their own, and for each given point the number of the distinct one."""
    neighbours = KDTree(points).query_ball_point(points, within, return_sorted=True)
    first = np.array([them[0] for them in neighbours], dtype=np.int64)
    distinct, number = np.unique(first, return_inverse=True)
    return points[distinct], number.reshape(-1)
