"""What a plane body shows after a step: the row of its history and its fields. Every rank takes part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import basix
import numpy as np
import numpy.typing as npt
import ufl

from cosserat_fx._compat import dolfinx, evaluate
from cosserat_fx.output.layer_observation import COUPLES, STRESSES, Columns, Row, largest
from cosserat_fx.output.plane_fields import PlaneState
from cosserat_fx.problem import Problem
from cosserat_fx.results import BOUNDARY_COLUMNS, PLANE_COLUMNS
from cosserat_fx.scenes.plane import Column
from cosserat_fx.stepping import Step
from cosserat_fx.typing import Array
from cosserat_fx.weakform import split

_AROUND = {3: [0, 1, 2], 4: [0, 1, 3, 2]}
"""From DOLFINx's order of a cell's corners to one that goes around it."""


class _Mesh(NamedTuple):
    """The whole mesh, on the first rank.

    Attributes:
        points: (n, 2) (m).
        nodes: position in ``points`` of each corner of the cells, as they are gathered from the ranks.
        cells: (m, k) nodes around each cell, in the order of the mesh.
        order: (m,) which of the gathered cells comes when.
    """

    points: Array
    nodes: npt.NDArray[np.int64]
    cells: npt.NDArray[np.int64]
    order: npt.NDArray[np.int64]


class PlaneObserver:
    """Reads the committed state of a plane body.

    The shear strain is the difference of the principal stretches,

        sqrt(tr(F^T F) - 2 det F) = sqrt((u1,1 - u2,2)^2 + (u1,2 + u2,1)^2),

    and the second form is also the difference of the principal small strains. It is |du1/dx2| in simple shear and the
    same for every observer.

    Attributes:
        columns: names of the history's columns, in order.
    """

    def __init__(
        self, problem: Problem, boundaries: Sequence[str], own_columns: Mapping[str, Column], *, start: float
    ) -> None:
        """Compile what is evaluated in the cells.

        Args:
            problem: the body.
            boundaries: the named boundaries with conditions, in the order of their columns.
            own_columns: what the scene adds to the history.
            start: travel at which the path's first leg begins, behind a leg that brings up loads (m).
        """
        self._problem, self._own, self._start = problem, dict(own_columns), start
        self._names = {
            name: [f"{name}_{ending}" for ending in BOUNDARY_COLUMNS.values()] for name in dict.fromkeys(boundaries)
        }
        self.columns: tuple[str, ...] = (
            *PLANE_COLUMNS,
            *(it for own in self._names.values() for it in own),
            *self._own,
        )
        state, mesh, cell = problem.state, problem.geometry.mesh, problem.geometry.mesh.basix_cell()
        u, w = split(problem.committed, polar=problem.layout.polar)
        gradient = ufl.grad(u)
        strains = ufl.as_vector([gradient[0, 0] - gradient[1, 1], gradient[0, 1] + gradient[1, 0]])
        self._strains = dolfinx.fem.Expression(strains, state.rule_points)
        nodal = ufl.as_vector([u[0], u[1], *([] if w is None else [w])])
        self._nodal = dolfinx.fem.Expression(nodal, basix.geometry(cell))
        volume = dolfinx.fem.Expression(ufl.as_vector([ufl.JacobianDeterminant(mesh)]), state.rule_points)
        rule = basix.make_quadrature(cell, problem.numerics.degree)[1]
        weights = np.abs(self._at(volume, 1)[..., 0]) * rule
        self._weights = weights / weights.sum(axis=1, keepdims=True)
        self._mesh = self._gather_mesh()

    def row(self, step: Step) -> Row:
        """The history's row of a step just committed."""
        problem = self._problem
        state = problem.state
        e = state.e_n[state.points]
        row: Row = {
            "step": step.number,
            "travel_m": self.travel(step),
            "step_size_m": step.size,
            "newton_iterations": step.iterations,
            "cutbacks": step.cutbacks,
            "branch_passages": step.passages,
            "jumps": step.jumps,
            "substeps_max": int(largest(problem, state.substeps[state.points])),
            "void_ratio_max": largest(problem, e),
            "void_ratio_min": -largest(problem, -e),
            "max_shear_strain": largest(problem, self._shear_strains()),
            "internal_work_J_per_m": problem.internal_work,
            "hourglass_energy_J_per_m": problem.hourglass_energy(),
        }
        boundaries = dict.fromkeys([*self._names, *(column.boundary for column in self._own.values())])
        forces = problem.boundary_forces()
        values = {name: forces.get(name, {}) | self._means(name) for name in boundaries}
        for name, columns in self._names.items():
            row |= {column: values[name].get(it, 0.0) for it, column in zip(BOUNDARY_COLUMNS, columns, strict=True)}
        own = {
            name: column.factor * values[column.boundary].get(column.quantity, 0.0)
            for name, column in self._own.items()
        }
        return row | own

    def travel(self, step: Step) -> float:
        """Travel of a step along the path, 0 at the start of its first leg (m)."""
        return step.travel - self._start

    def state(self, travel: float) -> PlaneState | None:
        """The committed state of the whole body, on rank 0; None on the others.

        Args:
            travel: along the path (m), 0 at the start of its first leg.
        """
        problem = self._problem
        nodal = self._at(self._nodal, 3 if problem.layout.polar else 2)
        gathered = problem.comm.gather((nodal, self._means_of_cells()))
        if gathered is None or self._mesh is None:
            return None
        points, nodes, cells, order = self._mesh
        fields = np.zeros((len(points), nodal.shape[-1]))
        fields[nodes] = np.concatenate([part.reshape(-1, nodal.shape[-1]) for part, _ in gathered])
        means = {name: np.concatenate([part[name] for _, part in gathered])[order] for name in gathered[0][1]}
        rotation = fields[:, 2] if problem.layout.polar else None
        return PlaneState(travel, points, cells, fields[:, :2], rotation, means)

    def boundaries(self) -> dict[str, Array]:
        """Both ends of the facets of every named boundary of the undeformed body, (m, 2, 2) (m); on rank 0."""
        geometry = self._problem.geometry
        gathered = {name: geometry.mesh.comm.gather(geometry.facets(name)[0]) for name in geometry.boundaries}
        return {name: np.concatenate(ends) for name, ends in gathered.items() if ends is not None}

    def _gather_mesh(self) -> _Mesh | None:
        """The whole mesh on rank 0; None on the others."""
        mesh, own = self._problem.geometry.mesh, self._problem.state.cells
        corners = dolfinx.mesh.entities_to_geometry(mesh, 2, own)
        identity = mesh.geometry.input_global_indices[corners]
        parts = self._problem.comm.gather(
            (identity, mesh.geometry.x[corners, :2], mesh.topology.original_cell_index[: len(own)])
        )
        if parts is None:
            return None
        identities, places, numbers = (np.concatenate(part) for part in zip(*parts, strict=True))
        _, first, nodes = np.unique(identities.reshape(-1), return_index=True, return_inverse=True)
        order = np.argsort(numbers)
        cells = nodes.reshape(identities.shape)[:, _AROUND[identities.shape[1]]]
        return _Mesh(places.reshape(-1, 2)[first], nodes.reshape(-1), cells[order].astype(np.int64), order)

    def _means(self, boundary: str) -> dict[str, float]:
        """Mean displacement (m) and rotation (rad) of a boundary."""
        return {field: self._problem.boundary_mean(boundary, field) for field in self._problem.fields}

    def _means_of_cells(self) -> Columns:
        """The state of this rank's own cells, averaged over their undeformed area, each of shape (cells,)."""
        state, layout = self._problem.state, self._problem.layout
        forces = state.forces_n[state.points]
        values = {"void_ratio": state.e_n[state.points], "shear_strain": self._shear_strains().reshape(-1)}
        values |= {name: forces[:, layout.stress_index(*c)] for name, c in STRESSES.items()}
        for name, component in COUPLES.items():
            slot = len(layout.stress) + layout.couple.index(component) if layout.polar else None
            values[name] = np.zeros(len(forces)) if slot is None else forces[:, slot]
        means = {
            name: (column.reshape(self._weights.shape) * self._weights).sum(axis=1) for name, column in values.items()
        }
        pressure = -(means["s11_Pa"] + means["s22_Pa"] + means["s33_Pa"]) / 3
        return means | {"pressure_Pa": pressure, "mobilised_friction_deg": mobilised_friction(means)}

    def _shear_strains(self) -> Array:
        """(cells, points) shear strain at this rank's quadrature points."""
        return np.asarray(np.linalg.norm(self._at(self._strains, 2), axis=-1))

    def _at(self, expression: dolfinx.fem.Expression, size: int) -> Array:
        """(cells, points, size) values of an expression in this rank's own cells."""
        cells = self._problem.state.cells
        values = np.zeros((len(cells), expression.X().shape[0], size))
        evaluate(expression, self._problem.geometry.mesh, cells, values)
        return values


def mobilised_friction(stress: Columns) -> Array:
    """Friction angle of the Matsuoka-Nakai cone through the symmetric part of a stress (degrees).

    The invariants of the cone satisfy I1 I2 / I3 = (9 - sin^2 phi) / (1 - sin^2 phi) (Matsuoka and Nakai 1974), so that
    the angle is phi_c in the critical state whatever the direction. It is 90 where a principal stress is not
    compressive.

    Args:
        stress: ``s11_Pa``, ``s22_Pa``, ``s33_Pa``, ``s12_Pa`` and ``s21_Pa`` (tension positive), each of shape (n,).
    """
    p11, p22, p33 = (-stress[f"s{ii}_Pa"] for ii in ("11", "22", "33"))
    p12 = -(stress["s12_Pa"] + stress["s21_Pa"]) / 2
    plane = p11 * p22 - p12**2
    first, second, third = p11 + p22 + p33, plane + p33 * (p11 + p22), plane * p33
    compressive = (plane > 0) & (p11 + p22 > 0) & (p33 > 0)
    ratio = np.divide(first * second, third, out=np.full_like(first, np.inf), where=compressive)
    with np.errstate(invalid="ignore"):
        sine = np.sqrt(np.clip((ratio - 9) / (ratio - 1), 0, 1))
    return np.asarray(np.where(compressive, np.degrees(np.arcsin(sine)), 90.0))
