"""Fields of a layer for ParaView: a strip of it with nodal displacement and rotation and cell-averaged state.

``fields/layer.pvd`` lists one file per requested displacement; warp by ``displacement`` to see the layer deform.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np

from cosserat_fx.observation import Columns

_STRIP_WIDTH = 0.5
_STATE = (
    "void_ratio",
    "shear_strain",
    *("s11_Pa", "s22_Pa", "s33_Pa", "s12_Pa", "s21_Pa"),
    *("m31_N_per_m", "m32_N_per_m"),
)


class FieldWriter:
    """Writes one file per call and keeps the list of all of them up to date."""

    def __init__(self, folder: Path) -> None:
        """Make the folder.

        Args:
            folder: where to write.
        """
        folder.mkdir()
        self._folder = folder
        self._root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
        self._collection = ElementTree.SubElement(self._root, "Collection")

    def write(self, travel: float, nodes: Columns, profile: Columns) -> None:
        """Write the layer at a travel.

        Args:
            travel: along the path (m), ParaView's time.
            nodes: heights and fields of the nodes, ascending.
            profile: state at the quadrature points, ascending; equally many in every cell.
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
        name = f"layer_{len(self._collection):04d}.vtu"
        meshio.Mesh(points, [("quad", quads)], point_data=point_data, cell_data=cell_data).write(self._folder / name)
        ElementTree.SubElement(self._collection, "DataSet", timestep=repr(float(travel)), file=name)
        ElementTree.ElementTree(self._root).write(self._folder / "layer.pvd", xml_declaration=True)
