"""One boundary value problem: forms, constitutive state and boundary conditions, made into residual and Jacobian.

The unknown vector holds displacement and rotation at the end of the step. Virtual rotations are divided by the mean
grain diameter, so that every row of the residual is a force and one norm measures them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cosserat_fx import weakform
from cosserat_fx._compat import MPI, PETSc, dolfinx, evaluate
from cosserat_fx.conditions import Condition, Field, Prescribed
from cosserat_fx.geometry import Geometry
from cosserat_fx.hypoplasticity import FIRST_FAILURE, REASONS, Status
from cosserat_fx.layout import layout
from cosserat_fx.material import Material
from cosserat_fx.state import QuadratureState
from cosserat_fx.timing import Stopwatch
from cosserat_fx.typing import Array
from cosserat_fx.weakform import Numerics


@dataclass(frozen=True)
class Failure:
    """Why and where the constitutive update failed.

    Attributes:
        status: the gravest code of any point.
        where: reference coordinates of such a point (m).
    """

    status: Status
    where: tuple[float, ...]

    def __str__(self) -> str:
        """The reason with its place."""
        return f"{REASONS[self.status]} at {', '.join(f'{x:.6g}' for x in self.where)} m"


class Problem:
    """A hypoplastic Cosserat body under boundary conditions.

    Attributes:
        geometry: mesh and boundaries.
        material: constants of the law.
        numerics: effects and integration.
        unknown: displacement (and rotation) at the end of the step, trial.
        committed: the same at the start of the step.
        state: stresses and void ratio at the quadrature points.
        stopwatch: seconds by phase.
    """

    def __init__(
        self,
        geometry: Geometry,
        material: Material,
        conditions: Sequence[Condition],
        *,
        stress: float,
        void_ratio: float,
        numerics: Numerics | None = None,
    ) -> None:
        """Set up forms, fields and conditions; compiled code comes from the caches where it can.

        Args:
            geometry: mesh, dimension, named boundaries.
            material: constants of the law.
            conditions: boundary conditions; boundaries without one are free of traction and couple traction.
            stress: initial isotropic stress (Pa, tension positive).
            void_ratio: initial void ratio.
            numerics: effects and integration; a finite-strain Cosserat body by default.
        """
        self.geometry, self.material = geometry, material
        self.numerics = numerics = numerics or Numerics()
        self.stopwatch = Stopwatch()
        mesh = geometry.mesh
        self.comm: MPI.Intracomm = mesh.comm
        self.layout = layout(geometry.dimension, polar=numerics.polar)
        self.state = QuadratureState(
            mesh,
            self.layout,
            material,
            degree=numerics.degree,
            spin=numerics.spin != "none",
            void_ratio=numerics.void_ratio,
            tolerance=numerics.local_tolerance,
        )
        self.state.initialise(stress, void_ratio)

        self.space = dolfinx.fem.functionspace(mesh, weakform.element(mesh, polar=numerics.polar))
        self.unknown = dolfinx.fem.Function(self.space, name="unknown")
        self.committed = dolfinx.fem.Function(self.space, name="committed")
        self._form = weakform.build(
            geometry, numerics, self.state, conditions, self.unknown, self.committed, length=material.d50
        )
        self._increments = np.zeros((len(self.state.points), self.layout.n_inputs))

        self._prescribed = [c for c in conditions if isinstance(c, Prescribed)]
        self._dofs = [self._locate(c.boundary, c.field) for c in self._prescribed]
        self._values = [dolfinx.fem.Constant(mesh, 0.0) for _ in self._prescribed]
        self._bcs = [
            dolfinx.fem.dirichletbc(value, dofs, self._subspace(c.field))
            for c, dofs, value in zip(self._prescribed, self._dofs, self._values, strict=True)
        ]
        self.matrix = dolfinx.fem.petsc.create_matrix(self._form.jacobian)
        self.vector = dolfinx.fem.petsc.assemble_vector(self._form.residual)

    # -- fields ----------------------------------------------------------------------------------------------------

    def _subspace(self, field: Field) -> dolfinx.fem.FunctionSpace:
        """The space of one scalar field."""
        if field == "w":
            return self.space.sub(1)
        displacement = self.space.sub(0) if self.numerics.polar else self.space
        return displacement.sub(int(field[1]) - 1)

    def nodal_values(self, field: Field) -> tuple[Array, Array]:
        """This rank's own nodes and the values of a committed field there.

        Returns:
            Reference coordinates (m, gdim) in m and values (m,) in m or rad.
        """
        space = self._subspace(field)
        collapsed, dofs = space.collapse()
        own = collapsed.dofmap.index_map.size_local
        flat = np.asarray(dofs).reshape(-1)[:own]
        gdim = self.geometry.mesh.geometry.dim
        return collapsed.tabulate_dof_coordinates()[:own, :gdim], self.committed.x.array[flat]

    def boundary_mean(self, boundary: str, field: Field) -> float:
        """Mean of a committed field over the nodes of a boundary (m or rad)."""
        dofs = self._locate(boundary, field)
        own = self.space.dofmap.index_map.size_local * self.space.dofmap.index_map_bs
        values = self.committed.x.array[dofs[dofs < own]]
        total, count = self.comm.allreduce(np.array([values.sum(), len(values)]))
        return float(total / count)

    # -- set-up ----------------------------------------------------------------------------------------------------

    def _locate(self, boundary: str, field: Field) -> npt.NDArray[np.int32]:
        """Degrees of freedom of a field on a boundary."""
        dim = self.geometry.mesh.topology.dim - 1
        facets = self.geometry.boundaries[boundary]
        dofs: npt.NDArray[np.int32] = dolfinx.fem.locate_dofs_topological(self._subspace(field), dim, facets)
        return dofs

    @property
    def sizes(self) -> dict[str, int]:
        """Numbers of unknowns, cells and quadrature points over all ranks, and bytes of state at each of the latter."""
        mesh = self.geometry.mesh
        cells = mesh.topology.index_map(mesh.topology.dim).size_global
        return {
            "unknowns": self.space.dofmap.index_map.size_global * self.space.dofmap.index_map_bs,
            "cells": cells,
            "quadrature_points": cells * len(self.state.rule_points),
            "bytes_per_quadrature_point": self.state.bytes_per_point,
        }

    # -- loading ---------------------------------------------------------------------------------------------------

    def apply(self, travel: float) -> None:
        """Set tractions and prescribed values to those at a travel (m) along the path."""
        for traction, value in self._form.tractions:
            value.value[:] = traction.value(travel)
        for prescribed, constant in zip(self._prescribed, self._values, strict=True):
            constant.value = prescribed.value(travel)

    def impose(self) -> None:
        """Write the prescribed values into the unknown."""
        for dofs, constant in zip(self._dofs, self._values, strict=True):
            self.unknown.x.array[dofs] = constant.value

    # -- residual and Jacobian -------------------------------------------------------------------------------------

    def set_unknown(self, x: PETSc.Vec) -> None:
        """Take the unknown from a PETSc vector of this rank's own entries."""
        own = x.array_r
        self.unknown.x.array[: len(own)] = own
        self.unknown.x.scatter_forward()

    def update(self, *, adapt: bool) -> Failure | None:
        """Update the trial state for the unknown at hand; the same answer on every rank.

        Args:
            adapt: whether points may take more substeps where their error estimate asks for it.
        """
        with self.stopwatch("strains"):
            evaluate(self._form.increments, self.geometry.mesh, self.state.cells, self._increments)
        with self.stopwatch("constitutive update"):
            outcome = self.state.update(self._increments, adapt=adapt)
        gravest = int(self.comm.allreduce(outcome.code, op=MPI.MAX))
        if gravest < FIRST_FAILURE:
            return None
        place = tuple(self.state.coordinates[outcome.row].tolist()) if outcome.code == gravest else None
        places = [p for p in self.comm.allgather(place) if p is not None]
        return Failure(Status(gravest), places[0])

    def strain_increments(self) -> Array:
        """Strain increments of the last update, and curvature increments times d50: (m, driven), dimensionless."""
        lengths = [1.0] * len(self.layout.strain) + [self.material.d50] * len(self.layout.curvature)
        return self._increments[:, : len(lengths)] * lengths

    def assemble_residual(self, b: PETSc.Vec) -> None:
        """Assemble the out-of-balance forces; prescribed entries hold unknown minus prescribed value."""
        with self.stopwatch("residual assembly"):
            _assemble(b, self._form.residual)
            own = self.space.dofmap.index_map.size_local * self.space.dofmap.index_map_bs
            for dofs, constant in zip(self._dofs, self._values, strict=True):
                mine = dofs[dofs < own]
                b.array_w[mine] = self.unknown.x.array[mine] - constant.value

    def assemble_jacobian(self, a: PETSc.Mat) -> None:
        """Assemble the derivative of the residual, with unit rows and zero columns at prescribed entries."""
        with self.stopwatch("Jacobian assembly"):
            a.zeroEntries()
            dolfinx.fem.petsc.assemble_matrix(a, self._form.jacobian, bcs=self._bcs)
            a.assemble()

    def assemble_prediction(self, b: PETSc.Vec) -> None:
        """Right-hand side of a linear step from the unknown at hand to the prescribed values and tractions."""
        with self.stopwatch("residual assembly"):
            _assemble(b, self._form.residual, ghosts=False)
            with b.localForm() as local:
                local.scale(-1.0)
            dolfinx.fem.petsc.apply_lifting(b, [self._form.jacobian], [self._bcs], x0=[self.unknown.x.petsc_vec])
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            dolfinx.fem.petsc.set_bc(b, self._bcs, x0=self.unknown.x.petsc_vec)

    # -- forces ----------------------------------------------------------------------------------------------------

    def reactions(self) -> dict[tuple[str, Field], float]:
        """Force or couple (the latter over d50) with which each prescribed condition acts on the body.

        Per unit of area in a layer (Pa), per unit of thickness in a plane (N/m); positive along the axes.
        """
        _assemble(self.vector, self._form.residual)
        own = self.vector.array_r
        return {
            (c.boundary, c.field): float(self.comm.allreduce(own[dofs[dofs < len(own)]].sum(), op=MPI.SUM))
            for c, dofs in zip(self._prescribed, self._dofs, strict=True)
        }

    def force_scale(self) -> float:
        """Norm of the internal forces, boundaries included: what an out-of-balance force is compared with."""
        _assemble(self.vector, self._form.internal)
        return float(self.vector.norm())

    # -- commit and roll back ----------------------------------------------------------------------------------------

    def commit(self) -> None:
        """Accept the trial fields and state."""
        self.committed.x.array[:] = self.unknown.x.array
        self.state.commit()

    def roll_back(self) -> None:
        """Drop the trial fields and state."""
        self.unknown.x.array[:] = self.committed.x.array
        self.state.roll_back()


def _assemble(b: PETSc.Vec, form: dolfinx.fem.Form, *, ghosts: bool = True) -> None:
    """Assemble a vector, by default with the other ranks' contributions added."""
    with b.localForm() as local:
        local.set(0.0)
    dolfinx.fem.petsc.assemble_vector(b, form)
    if ghosts:
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
