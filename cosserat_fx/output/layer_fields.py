"""Fields for ParaView: one file per state, and a list of them whose times are travels along the path.

A layer is a strip with nodal displacement and rotation and cell-averaged state; warp by ``displacement`` to see it
deform.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np

from cosserat_fx.output.tables import OutputError, Table, discard

_STRIP_WIDTH = 0.5
_STATE = (
    "void_ratio",
    "shear_strain",
    *("s11_Pa", "s22_Pa", "s33_Pa", "s12_Pa", "s21_Pa"),
    *("m31_N_per_m", "m32_N_per_m"),
)


class Series:
    """Writes one mesh per call and keeps the list of all of them up to date: ``stem.pvd``, ``stem_0000.vtu``, ..."""

    def __init__(self, folder: Path, stem: str, written: Sequence[float] = ()) -> None:
        """Make the folder, or go on in it.

        Args:
            folder: where to write.
            stem: how the names of the files begin.
            written: travels of the meshes that are there already and stay, in the order of the path (m).

        Raises:
            OutputError: the folder cannot be made.
        """
        try:
            folder.mkdir(exist_ok=bool(written))
        except OSError as error:
            raise OutputError(f"{folder}: cannot be made: {error.strerror or error}") from error
        self._folder, self._stem = folder, stem
        self._root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
        self._collection = ElementTree.SubElement(self._root, "Collection")
        for travel in written:
            self._list(travel, self._next_name)

    @property
    def written(self) -> list[float]:
        """Travels of the meshes written so far (m)."""
        return [float(entry.attrib["timestep"]) for entry in self._collection]

    def append(self, travel: float, mesh: meshio.Mesh) -> None:
        """Write a mesh with its data.

        Args:
            travel: along the path (m), ParaView's time.
            mesh: what to write.

        Raises:
            OutputError: a file cannot be written.
        """
        name = self._next_name
        part = self._folder / f"{self._stem}.pvd.part"
        try:
            mesh.write(self._folder / name)
            self._list(travel, name)
            ElementTree.ElementTree(self._root).write(part, xml_declaration=True)
            part.replace(self._folder / f"{self._stem}.pvd")
        except OSError as error:
            discard(part)
            raise OutputError(f"{self._folder / name}: cannot be written: {error.strerror or error}") from error

    @property
    def _next_name(self) -> str:
        return f"{self._stem}_{len(self._collection):04d}.vtu"

    def _list(self, travel: float, name: str) -> None:
        ElementTree.SubElement(self._collection, "DataSet", timestep=repr(float(travel)), file=name)


class FieldWriter:
    """Writes the fields of a layer."""

    def __init__(self, folder: Path, written: Sequence[float] = ()) -> None:
        """Make the folder, or go on in it.

        Args:
            folder: where to write.
            written: travels of the states that are there already and stay (m).

        Raises:
            OutputError: the folder cannot be made.
        """
        self._series = Series(folder, "layer", written)

    @property
    def written(self) -> list[float]:
        """Travels of the states written so far (m)."""
        return self._series.written

    def write(self, travel: float, nodes: Table, profile: Table) -> None:
        """Write the layer at a travel.

        Args:
            travel: along the path (m), ParaView's time.
            nodes: heights and fields of the nodes, ascending.
            profile: state at the quadrature points, ascending; equally many in every cell.

        Raises:
            OutputError: a file cannot be written.
        """
        y = nodes["y_m"]
        count = len(y)
        width = _STRIP_WIDTH * (y[-1] - y[0])
        points = np.concatenate([np.column_stack([np.full(count, x), y, np.zeros(count)]) for x in (0.0, width)])
        lower = np.arange(count - 1)
        quads = np.column_stack([lower, lower + count, lower + count + 1, lower + 1])
        displacement = np.column_stack([nodes["u1_m"], nodes["u2_m"], np.zeros(count)])
        point_data = {"displacement": np.tile(displacement, (2, 1))}
        if "omega_rad" in nodes:
            point_data["rotation"] = np.tile(nodes["omega_rad"], 2)
        cell_data = {name: [profile[name].reshape(count - 1, -1).mean(axis=1)] for name in _STATE}
        self._series.append(travel, meshio.Mesh(points, [("quad", quads)], point_data=point_data, cell_data=cell_data))
