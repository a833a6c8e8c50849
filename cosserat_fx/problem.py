"""One boundary value problem: forms, constitutive state and boundary conditions, made into residual and Jacobian.

The unknown vector holds displacement and rotation at the end of the step. Virtual rotations are divided by the mean
grain diameter, so that every row of the residual is a force and one norm measures them all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cosserat_fx import weakform
from cosserat_fx._compat import MPI, PETSc, dolfinx, evaluate
from cosserat_fx.conditions import Condition, Field, Point, Prescribed
from cosserat_fx.dirichlet import PrescribedValues, field_spaces, nodes_of
from cosserat_fx.geometry import Geometry
from cosserat_fx.hypoplasticity import FIRST_FAILURE, REASONS, Status
from cosserat_fx.layout import layout
from cosserat_fx.material import Material
from cosserat_fx.matrix import FormMatrix
from cosserat_fx.state import QuadratureState
from cosserat_fx.timing import Stopwatch
from cosserat_fx.typing import Array, IntArray
from cosserat_fx.weakform import Numerics, Stiffness


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
        fields: the unknown's scalar fields by name.
        prescribed: displacements and rotations that are given.
        internal_work: done by the stresses (and the stabilisation) since the start (J/m2 in a layer, J/m in a plane).
        stopwatch: seconds by phase.
        before_commit: called with the problem and its trial internal forces before every step that is committed.
    """

    def __init__(
        self,
        geometry: Geometry,
        material: Material,
        conditions: Sequence[Condition],
        *,
        stress: float,
        void_ratio: float | Array,
        numerics: Numerics | None = None,
    ) -> None:
        """Set up forms, fields and conditions; compiled code comes from the caches where it can.

        Args:
            geometry: mesh, dimension, named boundaries.
            material: constants of the law.
            conditions: boundary conditions; boundaries without one are free of traction and couple traction.
            stress: initial isotropic stress (Pa, tension positive).
            void_ratio: initial void ratio, uniform or (m,) at this rank's own quadrature points, cell by cell.
            numerics: effects and integration; a finite-strain Cosserat body by default.
        """
        self.geometry, self.material = geometry, material
        self.numerics = numerics = numerics or Numerics()
        self.stopwatch = Stopwatch()
        mesh = geometry.mesh
        self.comm: MPI.Intracomm = mesh.comm
        spin = numerics.spin != "none"
        self.layout = layout(geometry.dimension, polar=numerics.polar, spin=spin)
        self.state = QuadratureState(
            mesh,
            self.layout,
            material,
            degree=numerics.degree,
            spin=spin,
            void_ratio=numerics.void_ratio,
            tolerance=numerics.local_tolerance,
        )
        self.state.initialise(stress, void_ratio)

        self.space = dolfinx.fem.functionspace(mesh, weakform.element(mesh, polar=numerics.polar, order=numerics.order))
        self.unknown = dolfinx.fem.Function(self.space, name="unknown")
        self.committed = dolfinx.fem.Function(self.space, name="committed")
        self._form = weakform.build(
            geometry,
            numerics,
            self.state,
            conditions,
            self.unknown,
            self.committed,
            self._hourglass_stiffness(stress) if numerics.hourglass else None,
            length=material.d50,
        )
        self._increments = np.zeros((len(self.state.points), self.layout.n_inputs))

        self.fields = field_spaces(self.space, polar=numerics.polar)
        self._nodes: dict[tuple[str, Field], IntArray] = {}
        self.prescribed = PrescribedValues(geometry, self.fields, [c for c in conditions if isinstance(c, Prescribed)])
        self._jacobian = FormMatrix(self._form.jacobian)
        self.matrix = self._jacobian.petsc
        self.vector = dolfinx.fem.petsc.assemble_vector(self._form.residual)
        self.internal_work = 0.0
        self._internal_forces = self.internal_forces()
        self.before_commit: Callable[[Problem, Array], None] = lambda problem, internal: None

    # -- fields ----------------------------------------------------------------------------------------------------

    def nodal_values(self, field: Field) -> tuple[Array, Array]:
        """This rank's own nodes and the values of a committed field there.

        Returns:
            Reference coordinates (m, gdim) in m and values (m,) in m or rad.
        """
        part = self.fields[field]
        return part.coordinates[: part.owned], self.committed.x.array[part.dofs[: part.owned]]

    def boundary_mean(self, boundary: str, field: Field) -> float:
        """Mean of a committed field over the nodes of a boundary (m or rad)."""
        part = self.fields[field]
        if (boundary, field) not in self._nodes:
            self._nodes[boundary, field] = nodes_of(self.geometry, part, boundary)
        nodes = self._nodes[boundary, field]
        values = self.committed.x.array[part.dofs[nodes[nodes < part.owned]]]
        total, count = self.comm.allreduce(np.array([values.sum(), len(values)]))
        return float(total / count)

    # -- set-up ----------------------------------------------------------------------------------------------------

    def _hourglass_stiffness(self, stress: float) -> Stiffness:
        """The initial elastic stiffness of every cell, times the factor of the stabilisation."""
        mesh = self.geometry.mesh
        shear = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Discontinuous Lagrange", 0)))
        initial = self.material.shear_stiffness(-stress, self.state.e_n[self.state.points])
        shear.x.array[self.state.cells] = self.numerics.hourglass * initial.reshape(len(self.state.cells), -1).mean(
            axis=1
        )
        return Stiffness(shear, shear * self.material.couple_over_shear_stiffness)

    @property
    def increments(self) -> Array:
        """Strain, curvature (1/m) and spin increments of the last update at this rank's own points, (m, inputs)."""
        return self._increments

    def owned_values(self) -> Array:
        """The committed unknown at this rank's own entries (m and rad)."""
        values: Array = self.committed.x.array[: self.vector.getLocalSize()]
        return values

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
        for load, constant in self._form.loads:
            constant.value[:] = load.value(travel)
        self.prescribed.apply(travel)

    def impose(self) -> None:
        """Write the prescribed values into the unknown."""
        self.unknown.x.array[self.prescribed.dofs] = self.prescribed.values

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

    def largest_strain(self) -> float:
        """Largest norm of the strain and curvature (times d50) increments of any point for the unknown at hand."""
        with self.stopwatch("strains"):
            evaluate(self._form.increments, self.geometry.mesh, self.state.cells, self._increments)
        largest = np.max(np.linalg.norm(self.strain_increments(), axis=1), initial=0.0)
        return float(self.comm.allreduce(largest, op=MPI.MAX))

    def strain_increments(self) -> Array:
        """Strain increments of the last update, and curvature increments times d50: (m, driven), dimensionless."""
        lengths = [1.0] * len(self.layout.strain) + [self.material.d50] * len(self.layout.curvature)
        return self._increments[:, : len(lengths)] * lengths

    def assemble_residual(self, b: PETSc.Vec) -> None:
        """Assemble the out-of-balance forces; prescribed entries hold unknown minus prescribed value."""
        with self.stopwatch("residual assembly"):
            _assemble(b, self._form.residual)
            held = self.prescribed
            dofs = held.dofs[held.owned]
            b.array_w[dofs] = self.unknown.x.array[dofs] - held.values[held.owned]

    def assemble_jacobian(self) -> None:
        """Assemble the derivative of the residual, with unit rows and zero columns at prescribed entries."""
        with self.stopwatch("Jacobian assembly"):
            self._jacobian.assemble(self.prescribed.bcs)

    def assemble_prediction(self, b: PETSc.Vec) -> None:
        """Right-hand side of a linear step from the unknown at hand to the prescribed values and tractions."""
        with self.stopwatch("residual assembly"):
            _assemble(b, self._form.residual, ghosts=False)
            with b.localForm() as local:
                local.scale(-1.0)
            dolfinx.fem.petsc.apply_lifting(
                b, [self._form.jacobian], [self.prescribed.bcs], x0=[self.unknown.x.petsc_vec]
            )
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            dolfinx.fem.petsc.set_bc(b, self.prescribed.bcs, x0=self.unknown.x.petsc_vec)

    # -- forces ----------------------------------------------------------------------------------------------------

    def internal_forces(self) -> Array:
        """Nodal forces with which the trial stresses and the stabilisation resist, at this rank's own unknowns.

        Couples over d50, as in the residual; per unit of area in a layer (Pa), per unit of thickness in a plane (N/m).
        """
        return self._assembled(self._form.internal)

    def acting(self, internal: Array) -> Array:
        """All that acts on the body at this rank's own unknowns: the loads and, where values are given, reactions.

        Args:
            internal: the :meth:`internal_forces`, which loads and reactions together balance where values are given.
        """
        acting = sum((self._assembled(form) for form in self._form.external.values()), np.zeros(len(internal)))
        held = self.prescribed.dofs[self.prescribed.owned]
        acting[held] = internal[held]
        return acting

    def reactions(self) -> dict[tuple[str | Point, Field], float]:
        """Force or couple (the latter over d50) with which each prescribed condition acts on the body.

        Per unit of area in a layer (Pa), per unit of thickness in a plane (N/m); positive along the axes. Nodes that
        two conditions claim count for the first of them.
        """
        residual = self._assembled(self._form.residual)
        sums = self.comm.allreduce(np.array([residual[dofs].sum() for dofs in self.prescribed.owned_dofs]))
        keys = [(c.boundary, c.field) for c in self.prescribed.conditions]
        total: dict[tuple[str | Point, Field], float] = dict.fromkeys(keys, 0.0)
        for key, value in zip(keys, np.atleast_1d(sums).tolist(), strict=True):
            total[key] += value
        return total

    def boundary_forces(self) -> dict[str, dict[str, float]]:
        """All that acts on the body at each boundary with conditions, by "force1", "force2" and "couple".

        Forces in N/m and the couple in N, per unit of thickness; positive along the axes, and about x3.
        """
        names = {"u1": "force1", "u2": "force2", "w": "couple"}
        acting: dict[str, dict[str, float]] = {}
        for (place, field), value in self.reactions().items():
            if isinstance(place, str):
                acting.setdefault(place, dict.fromkeys(names.values(), 0.0))[names[field]] += value
        for boundary, form in self._form.external.items():
            if boundary is None:
                continue
            forces = self._assembled(form)
            sums = [forces[f.dofs[: f.owned]].sum() for f in self.fields.values()]
            row = acting.setdefault(boundary, dict.fromkeys(names.values(), 0.0))
            for field, value in zip(self.fields, self.comm.allreduce(np.array(sums)).tolist(), strict=True):
                row[names[field]] += value
        for row in acting.values():
            row["couple"] *= self.material.d50
        return acting

    def hourglass_energy(self) -> float:
        """Elastic energy of the resistance to hourglass modes in the committed fields (J/m)."""
        if self._form.stabilisation is None:
            return 0.0
        return self._work(self._assembled(self._form.stabilisation), self.unknown.x.array) / 2

    def resistance(self, motions: Array) -> Array:
        """Stiffness with which loads and resistances (without the body itself) oppose some motions.

        Args:
            motions: (n, k) changes of this rank's unknowns, the same motions on every rank. The loads are those applied
                last.

        Returns:
            (k, k), symmetric part.
        """
        kept, columns = self.unknown.x.array.copy(), []
        for change in (np.zeros(len(motions)), *motions.T):
            self.unknown.x.array[:] = change
            columns.append(sum((self._assembled(form) for form in self._form.external.values()), np.zeros(1)))
        self.unknown.x.array[:] = kept
        opposing = columns[0][:, None] - np.stack(columns[1:], axis=1)
        stiffness: Array = self.comm.allreduce(motions[: len(opposing)].T @ opposing)
        return (stiffness + stiffness.T) / 2

    def force_scale(self) -> float:
        """Norm of the internal forces, boundaries included: what an out-of-balance force is compared with."""
        _assemble(self.vector, self._form.internal)
        return float(self.vector.norm())

    def _assembled(self, form: dolfinx.fem.Form) -> Array:
        """This rank's own entries of an assembled vector."""
        _assemble(self.vector, form)
        own: Array = self.vector.array_r.copy()
        return own

    def _work(self, forces: Array, change: Array) -> float:
        """Work of nodal forces on a change of the unknown; those of rotations are divided by d50."""
        scale = np.ones(len(forces))
        if "w" in self.fields:
            rotation = self.fields["w"]
            scale[rotation.dofs[: rotation.owned]] = self.material.d50
        return float(self.comm.allreduce(np.dot(forces * scale, change[: len(forces)])))

    # -- commit and roll back ----------------------------------------------------------------------------------------

    def commit(self) -> None:
        """Accept the trial fields and state."""
        forces = self.internal_forces()
        self.before_commit(self, forces)
        change = self.unknown.x.array - self.committed.x.array
        self.internal_work += self._work((forces + self._internal_forces) / 2, change)
        self._internal_forces = forces
        self.committed.x.array[:] = self.unknown.x.array
        self.state.commit()

    def resume(self, internal_work: float) -> None:
        """Go on from committed fields and state that were put back.

        Args:
            internal_work: up to there (J/m2 in a layer, J/m in the plane).
        """
        self.roll_back()
        self.internal_work = internal_work
        self._internal_forces = self.internal_forces()

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
