"""A plane body at one instant: nodal fields and the mean state of its cells, for ParaView and read back from there.

No DOLFINx is needed here. Everything refers to the undeformed mesh; nodes and cells are in the order in which the mesh
was made, however many ranks there were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
import numpy.typing as npt

from cosserat_fx.output.layer_fields import Series
from cosserat_fx.results import OutputError, Table
from cosserat_fx.typing import Array

STEM = "plane"
_CELLS = {3: "triangle", 4: "quad"}


@dataclass(frozen=True)
class PlaneState:
    """A plane body at one instant.

    Attributes:
        travel: along the path, 0 at the start of its first leg (m).
        points: (n, 2) nodes of the undeformed body (m).
        cells: (m, 3) or (m, 4) nodes of each cell, going around it.
        displacement: (n, 2) of the nodes (m).
        rotation: (n,) of the grains about x3 (rad), anticlockwise positive; None without polar effects.
        means: state of the cells, each of shape (m,): ``void_ratio``, ``shear_strain``, ``pressure_Pa``,
            ``mobilised_friction_deg``, stresses and couple stresses.
    """

    travel: float
    points: Array
    cells: npt.NDArray[np.int64]
    displacement: Array
    rotation: Array | None
    means: Table

    @property
    def deformed(self) -> Array:
        """(n, 2) nodes of the deformed body (m)."""
        return self.points + self.displacement

    @cached_property
    def areas(self) -> Array:
        """(m,) areas of the undeformed cells (m2)."""
        a, b = self._corners, np.roll(self._corners, -1, axis=1)
        return np.asarray(np.abs((a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)) / 2)

    @cached_property
    def centroids(self) -> Array:
        """(m, 2) centroids of the undeformed cells (m)."""
        middle = self._corners.mean(axis=1, keepdims=True)
        a, b = self._corners - middle, np.roll(self._corners - middle, -1, axis=1)
        wedges = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        offset = np.einsum("mk,mki->mi", wedges, a + b) / (3 * wedges.sum(axis=1, keepdims=True))
        return np.asarray(middle[:, 0] + offset)

    @property
    def _corners(self) -> Array:
        """(m, k, 2) corners of the undeformed cells (m)."""
        return self.points[self.cells]


class PlaneFieldWriter:
    """Writes ``plane.pvd`` and one file per state."""

    def __init__(self, folder: Path, written: Sequence[float] = ()) -> None:
        """Make the folder, or go on in it.

        Args:
            folder: where to write.
            written: travels of the states that are there already and stay (m).

        Raises:
            OutputError: the folder cannot be made.
        """
        self._series = Series(folder, STEM, written)

    @property
    def written(self) -> list[float]:
        """Travels of the states written so far (m)."""
        return self._series.written

    def write(self, state: PlaneState) -> None:
        """Write a state.

        Args:
            state: the body.

        Raises:
            OutputError: a file cannot be written.
        """
        flat = np.zeros((len(state.points), 1))
        point_data = {"displacement": np.hstack([state.displacement, flat])}
        if state.rotation is not None:
            point_data["rotation"] = state.rotation
        mesh = meshio.Mesh(
            np.hstack([state.points, flat]),
            [(_CELLS[state.cells.shape[1]], state.cells)],
            point_data=point_data,
            cell_data={name: [mean] for name, mean in state.means.items()},
        )
        self._series.append(state.travel, mesh)


def read_states(folder: Path) -> list[PlaneState]:
    """Read the states of a run in the order of the path; none where no fields were written.

    Args:
        folder: the folder ``fields`` of a run.

    Raises:
        OutputError: a file is missing or damaged.
    """
    listing = folder / f"{STEM}.pvd"
    if not listing.exists():
        return []
    try:
        entries = [dict(entry.attrib) for entry in ElementTree.parse(listing).iter("DataSet")]
        return [_read_state(folder / entry["file"], float(entry["timestep"])) for entry in entries]
    except (OSError, KeyError, ValueError, ElementTree.ParseError, meshio.ReadError) as error:
        raise OutputError(f"{folder}: the fields cannot be read: {error}") from error


def _read_state(file: Path, travel: float) -> PlaneState:
    mesh = meshio.read(file)
    (block,) = mesh.cells
    return PlaneState(
        travel=travel,
        points=mesh.points[:, :2],
        cells=block.data,
        displacement=mesh.point_data["displacement"][:, :2],
        rotation=mesh.point_data.get("rotation"),
        means={name: data[0] for name, data in mesh.cell_data.items()},
    )
