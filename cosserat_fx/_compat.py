"""The one file that knows DOLFINx: how to get it, and what differs between its versions.

Raises:
    ImportError: On import, where DOLFINx with a real-valued PETSc cannot be imported; the message tells both ways to
        install it.
"""

import numpy as np
import numpy.typing as npt

from cosserat_fx.typing import Array

_HOW_TO_INSTALL = """\
cosserat_fx needs DOLFINx 0.9 or newer with a real-valued PETSc: {problem}.
Install it in one of two ways:
  Debian 13 or newer:    apt install python3-dolfinx python3-dolfinx-real
  Linux x86-64, wheel:   pip install "cosserat-fx[dolfinx]"
                         (Python 3.12 or newer, in a virtual environment; brings dolfinx-solver-real)"""

try:
    # MPI comes first: the wheel wants it loaded before petsc4py and dolfinx.
    from mpi4py import MPI  # isort: skip
    import dolfinx
    import dolfinx.fem.petsc
    from petsc4py import PETSc
except ImportError as error:
    raise ImportError(_HOW_TO_INSTALL.format(problem=error)) from error

if tuple(int(part) for part in dolfinx.__version__.split(".")[:2]) < (0, 9):
    raise ImportError(_HOW_TO_INSTALL.format(problem=f"this is DOLFINx {dolfinx.__version__}"))
if np.issubdtype(PETSc.ScalarType, np.complexfloating):
    raise ImportError(_HOW_TO_INSTALL.format(problem="this PETSc is complex-valued"))

__all__ = ["MPI", "PETSc", "dolfinx", "entity_nodes", "evaluate"]

_FLAT_EXPRESSIONS = tuple(int(part) for part in dolfinx.__version__.split(".")[:2]) < (0, 10)


def evaluate(
    expression: dolfinx.fem.Expression, mesh: dolfinx.mesh.Mesh, cells: npt.NDArray[np.int32], values: Array
) -> None:
    """Evaluates an expression at its points in each cell, in place.

    Args:
        expression: a vector-valued expression.
        mesh: its mesh.
        cells: the cells.
        values: (cells * points, size), contiguous, overwritten.
    """
    points, size = expression.X().shape[0], values.shape[-1]
    shape = (len(cells), points * size) if _FLAT_EXPRESSIONS else (len(cells), points, size)
    expression.eval(mesh, cells, values.reshape(shape))


def entity_nodes(mesh: dolfinx.mesh.Mesh, dim: int, entities: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Nodes at the corners of a mesh's entities, (entities, corners); DOLFINx 0.9 divides by zero where there is none.

    Args:
        mesh: of cells with straight sides.
        dim: topological dimension of the entities.
        entities: local indices.
    """
    if not len(entities):
        kind = dolfinx.cpp.mesh.cell_entity_type(mesh.topology.cell_type, dim, 0)
        return np.empty((0, dolfinx.cpp.mesh.cell_num_vertices(kind)), dtype=np.int32)
    mesh.topology.create_connectivity(dim, mesh.topology.dim)
    mesh.topology.create_connectivity(mesh.topology.dim, dim)
    nodes: npt.NDArray[np.int32] = dolfinx.mesh.entities_to_geometry(mesh, dim, entities)
    return nodes
