"""The constitutive state at the quadrature points: committed and trial.

The trial stresses, couple stresses and their tangent live in quadrature functions that the weak forms read; the kernel
writes straight into the arrays of these functions. The committed state changes only by :meth:`QuadratureState.commit`.
"""

from __future__ import annotations

from typing import NamedTuple

import basix
import basix.ufl
import numpy as np
import ufl

from cosserat_fx._compat import dolfinx
from cosserat_fx.layout import Layout
from cosserat_fx.material import Material
from cosserat_fx.parallel import in_turn
from cosserat_fx.typing import Array
from cosserat_fx.update import build_update, compile_update

MAX_SUBSTEPS = 200


class Outcome(NamedTuple):
    """The gravest :class:`~cosserat_fx.hypoplasticity.Status` of an update and this rank's row of it (-1: none)."""

    code: int
    row: int


class QuadratureState:
    """Stress, couple stress and void ratio at every quadrature point of this rank.

    Rows of increments and coordinates run over the rank's own cells and their points; ``points`` maps them to the
    rows of the state arrays, which follow the quadrature functions and hold ghost points too.

    Attributes:
        layout: components and their order.
        forces: quadrature function of stresses (Pa) and couple stresses (N/m), trial.
        tangent: quadrature function of the conjugate forces' derivatives, trial.
        forces_n: (N, n) committed stresses and couple stresses.
        e, e_n: (N,) trial and committed void ratio; the same array where it is frozen.
        status: (N,) code of the last update of each point.
        substeps: (N,) number of local substeps of each point.
        points: (m,) row of each of this rank's own points.
        coordinates: (m, gdim) reference coordinates of these points (m).
        bytes_per_point: memory of one point's state, tangent and bookkeeping (bytes).
    """

    def __init__(
        self,
        mesh: dolfinx.mesh.Mesh,
        layout: Layout,
        material: Material,
        *,
        degree: int,
        spin: bool,
        void_ratio: bool,
        tolerance: float,
    ) -> None:
        """Make the fields of a mesh.

        Args:
            mesh: the mesh.
            layout: components of the problem.
            material: the constants of the law.
            degree: of the quadrature rule.
            spin: whether the objective terms are integrated.
            void_ratio: whether the void ratio evolves.
            tolerance: of the local error estimate, relative to the trace of the stress.
        """
        self.layout = layout
        self.tolerance = tolerance
        self._constants = material.kernel_parameters()
        self._update = build_update(layout, spin=spin, void_ratio=void_ratio)
        in_turn(mesh.comm, lambda: compile_update(self._update, layout, self._constants))

        cell = mesh.basix_cell()
        record = point_record(layout, void_ratio=void_ratio)
        self.forces = _quadrature_function(mesh, degree, record["forces"].shape, "forces")
        self.tangent = _quadrature_function(mesh, degree, record["tangent"].shape, "tangent")
        self._forces = self.forces.x.array.reshape(-1, *record["forces"].shape)
        self._tangent = self.tangent.x.array.reshape(-1, *record["tangent"].shape)
        size = len(self._forces)
        self.forces_n = np.zeros(size, record["forces_n"])
        self.e_n = np.zeros(size, record["e_n"])
        self.e = np.zeros(size, record["e"]) if void_ratio else self.e_n
        self.substeps = np.ones(size, record["substeps"])
        self.status = np.zeros(size, record["status"])
        self._error = np.zeros(size, record["error"])
        self.bytes_per_point = record.itemsize

        self.rule_points = basix.make_quadrature(cell, degree)[0]
        self.cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
        self.points = np.ascontiguousarray(self.forces.function_space.dofmap.list[self.cells].reshape(-1))
        position = dolfinx.fem.Expression(ufl.SpatialCoordinate(mesh), self.rule_points)
        self.coordinates = position.eval(mesh, self.cells).reshape(len(self.points), mesh.geometry.dim)

    def initialise(self, stress: float, void_ratio: float | Array) -> None:
        """Set an isotropic state, committed and trial.

        Args:
            stress: of the normal components (Pa, tension positive).
            void_ratio: uniform, or (m,) at this rank's own points.
        """
        normal = [k for k, (i, j) in enumerate(self.layout.stress) if i == j]
        self.forces_n[:] = 0.0
        self.forces_n[:, normal] = stress
        self.e_n[self.points] = void_ratio
        self.roll_back()

    def update(self, increments: Array, *, adapt: bool) -> Outcome:
        """Integrate the law from the committed state over an increment into the trial state and tangent.

        Args:
            increments: (m, inputs) strain, curvature (1/m) and spin increments of this rank's own points, or of
                the first m of them.
            adapt: whether the number of substeps may grow where the error estimate asks for it.
        """
        code, row = self._update(
            increments,
            self.points[: len(increments)],
            self.forces_n,
            self.e_n,
            self._forces,
            self.e,
            self._tangent,
            self.substeps,
            self.status,
            self._error,
            self._constants,
            self.tolerance,
            MAX_SUBSTEPS,
            adapt,
            True,
        )
        return Outcome(code, row)

    def restart_substeps(self) -> None:
        """Let every point begin its next step with one local substep again."""
        self.substeps[:] = 1

    def commit(self) -> None:
        """Make the trial state the committed one."""
        self.forces_n[:] = self._forces
        self.e_n[:] = self.e

    def roll_back(self) -> None:
        """Make the trial state what the committed one is."""
        self._forces[:] = self.forces_n
        self.e[:] = self.e_n


def point_record(layout: Layout, *, void_ratio: bool) -> np.dtype[np.void]:
    """What is kept of every quadrature point, by name: state, tangent and bookkeeping.

    Args:
        layout: components of the problem.
        void_ratio: whether the void ratio evolves; a frozen one has no trial value.
    """
    n, driven = len(layout.forces), len(layout.strain_slots)
    kept = [
        ("forces", np.float64, (n,)),
        ("forces_n", np.float64, (n,)),
        ("tangent", np.float64, (driven, layout.n_inputs)),
        ("e_n", np.float64, ()),
        ("error", np.float64, ()),
        ("substeps", np.int32, ()),
        ("status", np.uint8, ()),
    ]
    return np.dtype([*kept, ("e", np.float64, ())] if void_ratio else kept)


def _quadrature_function(
    mesh: dolfinx.mesh.Mesh, degree: int, shape: tuple[int, ...], name: str
) -> dolfinx.fem.Function:
    """A function with one tensor of the given shape at every quadrature point."""
    element = basix.ufl.quadrature_element(mesh.basix_cell(), value_shape=shape, degree=degree)
    return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element), name=name)
