"""Prescribed displacements and rotations: which unknowns they hold, at which values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.conditions import Field, Point, Prescribed
from cosserat_fx.geometry import Geometry
from cosserat_fx.typing import Array, IntArray


class FieldSpace(NamedTuple):
    """One scalar field of the unknown.

    Attributes:
        view: the field's part of the whole space.
        space: the same on its own.
        dofs: unknown of the whole space for each one of ``space``, ghosts included.
    """

    view: dolfinx.fem.FunctionSpace
    space: dolfinx.fem.FunctionSpace
    dofs: IntArray

    @property
    def owned(self) -> int:
        """How many of its unknowns are this rank's own; they come first."""
        return int(self.space.dofmap.index_map.size_local)

    @property
    def coordinates(self) -> Array:
        """Reference coordinates (m, gdim) of its nodes, in m."""
        places: Array = self.space.tabulate_dof_coordinates()
        return places[:, : self.space.mesh.geometry.dim]


def field_spaces(space: dolfinx.fem.FunctionSpace, *, polar: bool) -> dict[Field, FieldSpace]:
    """The scalar fields of a problem's space by name; in a solid the rotation is left out, it is a vector."""
    displacement = space.sub(0) if polar else space
    names: tuple[Field, ...] = ("u1", "u2", "u3")
    views = {names[i]: displacement.sub(i) for i in range(displacement.num_sub_spaces)}
    if polar and not space.sub(1).num_sub_spaces:
        views["w"] = space.sub(1)
    fields = {}
    for name, view in views.items():
        collapsed, dofs = view.collapse()
        fields[name] = FieldSpace(view, collapsed, np.asarray(dofs, dtype=np.int32).reshape(-1))
    return fields


class PrescribedValues:
    """The prescribed conditions of a problem on its spaces.

    Attributes:
        bcs: DOLFINx's conditions, one for each field that has any.
        dofs: every unknown that is held, ghosts included.
        values: what each of them is held at.
        owned: which of them are this rank's own.
        owned_dofs: this rank's own unknowns of each condition.
    """

    def __init__(self, geometry: Geometry, fields: dict[Field, FieldSpace], conditions: Sequence[Prescribed]) -> None:
        """Find the unknowns of every condition; of two for the same unknown the first one has it.

        Args:
            geometry: mesh and boundaries.
            fields: of the problem.
            conditions: in the order of their precedence.
        """
        self.conditions = tuple(conditions)
        self._values = {name: dolfinx.fem.Function(field.space) for name, field in fields.items()}
        taken = {name: np.zeros(len(field.dofs), dtype=bool) for name, field in fields.items()}
        self._local: list[IntArray] = []
        for condition in conditions:
            found = nodes_of(geometry, fields[condition.field], condition.boundary)
            found = found[~taken[condition.field][found]]
            taken[condition.field][found] = True
            self._local.append(found)
        self._profiles = [
            None if c.profile is None else c.profile(fields[c.field].coordinates[local])
            for c, local in zip(self.conditions, self._local, strict=True)
        ]
        held = {name: np.flatnonzero(mask).astype(np.int32) for name, mask in taken.items()}
        self.bcs = [
            dolfinx.fem.dirichletbc(self._values[name], [fields[name].dofs[local], local], fields[name].view)
            for name, local in held.items()
            if fields[name].space.mesh.comm.allreduce(len(local))
        ]
        self.dofs = np.concatenate([fields[name].dofs[local] for name, local in held.items()])
        self.owned = np.concatenate([local < fields[name].owned for name, local in held.items()])
        self.values: Array = np.zeros(len(self.dofs))
        self.owned_dofs = [
            fields[c.field].dofs[local[local < fields[c.field].owned]]
            for c, local in zip(self.conditions, self._local, strict=True)
        ]
        self._held = held

    def apply(self, travel: float) -> None:
        """Set the values to those at a travel (m) along the path."""
        for condition, local, profile in zip(self.conditions, self._local, self._profiles, strict=True):
            value = condition.value(travel)
            self._values[condition.field].x.array[local] = value if profile is None else profile @ np.asarray(value)
        self.values[:] = np.concatenate([self._values[name].x.array[local] for name, local in self._held.items()])


def nodes_of(geometry: Geometry, field: FieldSpace, place: str | Point) -> IntArray:
    """Nodes of a field (in its own space, ghosts included) on a boundary, or nearest to a point."""
    if isinstance(place, str):
        found: IntArray = dolfinx.fem.locate_dofs_topological(
            field.space, geometry.mesh.topology.dim - 1, geometry.boundaries[place]
        )
        return found
    coordinates = field.coordinates
    away = np.linalg.norm(coordinates - place, axis=1)
    nearest = int(np.argmin(away[: field.owned])) if field.owned else -1
    offer = (float(away[nearest]), *coordinates[nearest].tolist()) if field.owned else (np.inf,)
    comm = geometry.mesh.comm
    offers = sorted(comm.allgather(offer))
    extent = comm.allreduce(float(np.ptp(coordinates)) if len(coordinates) else 0.0, op=MPI.MAX)
    # Of nodes equally near, as in the middle of a cell, every rank takes the same one.
    best = min((o for o in offers if o[0] <= offers[0][0] + 1e-9 * extent), key=lambda o: o[1:])
    same = np.linalg.norm(coordinates - best[1:], axis=1) <= 1e-9 * extent
    return np.flatnonzero(same).astype(np.int32)
