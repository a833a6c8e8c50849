"""Meshes and their named boundaries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.layout import Dimension


@dataclass(frozen=True)
class Geometry:
    """A mesh, the dimension its fields live in, and its boundaries by name.

    Attributes:
        mesh: coordinates in m; a layer's only coordinate is x2.
        dimension: "layer", "plane" or "solid".
        boundaries: facets of each named boundary (local indices of this rank).
    """

    mesh: dolfinx.mesh.Mesh
    dimension: Dimension
    boundaries: Mapping[str, npt.NDArray[np.int32]]

    def facet_tags(self, names: list[str]) -> dolfinx.mesh.MeshTags:
        """Facets of several boundaries tagged by the position of their name in the list."""
        facets = np.concatenate([self.boundaries[name] for name in names])
        tags = np.concatenate([np.full(len(self.boundaries[n]), k, dtype=np.int32) for k, n in enumerate(names)])
        order = np.argsort(facets)
        return dolfinx.mesh.meshtags(self.mesh, self.mesh.topology.dim - 1, facets[order], tags[order])


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
