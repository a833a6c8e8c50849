"""What a scene says about boundaries and points of a plane body, as conditions of the problem."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import basix.ufl
import numpy as np
import ufl
from ufl.core.expr import Expr

from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.conditions import Condition, Field, Load, Prescribed, Work, fixed
from cosserat_fx.forms import ties
from cosserat_fx.forms.couple import couple_work, rotational_resistance_work
from cosserat_fx.forms.pressure import pressure_work
from cosserat_fx.forms.traction import balancing_work, traction_work
from cosserat_fx.forms.weight import weight_work
from cosserat_fx.geometry import Geometry
from cosserat_fx.meshes.normals import BoundaryNormals
from cosserat_fx.plane_path import Function, PlanePath, initial_load
from cosserat_fx.scene import PlaneScene
from cosserat_fx.scenes.histories import History
from cosserat_fx.scenes.plane import Boundary, BoundaryWall, Point
from cosserat_fx.scenes.refusals import SceneError
from cosserat_fx.scenes.registry import BoundaryContext, MakesConditions
from cosserat_fx.typing import Array

TIE_STIFFNESS = 1e4
"""Stiffness of the ties, over that of the smallest cell; they give way by some 1e-6 of its size."""
_BALANCED = 1e-9
_COMPONENTS: tuple[Field, Field] = ("u1", "u2")


def needs_loading(scene: PlaneScene, geometry: Geometry) -> bool:
    """Whether loads at the start of the path differ from what balances the initial stress, or there is weight."""
    return scene.weight is not None or any(
        _unbalanced(name, boundary, scene.initial.stress, geometry) for name, boundary in scene.boundaries.items()
    )


def _unbalanced(name: str, boundary: Boundary, stress: float, geometry: Geometry) -> bool:
    pressures = [boundary.pressure, boundary.wall.pressure if boundary.wall else None]
    asked: list[tuple[History | None, float | None]] = [(pressure, -stress) for pressure in pressures]
    asked.append((boundary.couple, 0.0))
    if boundary.t1 is not None or boundary.t2 is not None:
        balance = _balance(name, stress, geometry)
        asked += [
            (0.0 if history is None else history, None if balance is None else balance[axis])
            for axis, history in enumerate((boundary.t1, boundary.t2))
            if getattr(boundary, _COMPONENTS[axis]) is None
        ]
    return any(_differs(history, balance, stress) for history, balance in asked if history is not None)


def _differs(history: History, balance: float | None, stress: float) -> bool:
    first = initial_load(history)
    return first is not None and (balance is None or abs(first - balance) > _BALANCED * abs(stress))


def _balance(name: str, stress: float, geometry: Geometry) -> Array | None:
    """The traction (Pa) that balances an isotropic stress on a straight boundary along an axis, None on any other."""
    axis = geometry.is_axis_aligned(name)
    if axis is None:
        return None
    _, normals = geometry.facets(name)
    sign = geometry.mesh.comm.allreduce(float(np.sign(normals[:, axis].sum())))
    return np.array([stress * np.sign(sign) if i == axis else 0.0 for i in range(2)])


@dataclass(frozen=True)
class BoundaryMaker:
    """Makes the conditions of the boundaries and points of one scene.

    Attributes:
        scene: the scene.
        geometry: its mesh.
        path: its loading path.
        finite: whether pressures follow the deformed boundary.
        order: polynomial degree of the displacement.
    """

    scene: PlaneScene
    geometry: Geometry
    path: PlanePath
    finite: bool
    order: int

    def conditions(self) -> list[Condition]:
        """All of them, in the order of the scene; points come first, and so hold where boundaries meet them.

        Raises:
            SceneError: a boundary has nothing that could balance the initial stress.
        """
        made: list[Condition] = []
        for point in self.scene.points.values():
            made += self._point(point)
        for name in self.geometry.boundaries:
            if not self._holds(name):
                raise SceneError(
                    f"boundaries.{name} is missing a condition normal to it: must have a displacement, symmetry, "
                    "a wall, a pressure or a traction, as grains under no pressure have no strength"
                )
        for name, boundary in self.scene.boundaries.items():
            made += self._boundary(name, boundary)
        return made + self._weight()

    def _holds(self, name: str) -> bool:
        """Whether a boundary has a condition normal to it."""
        boundary = self.scene.boundaries.get(name)
        if boundary is None:
            return False
        axis = self.geometry.is_axis_aligned(name)
        normal = [boundary.u1, boundary.u2] if axis is None else [(boundary.u1, boundary.u2)[axis]]
        loads_given = (boundary.pressure, boundary.t1, boundary.t2, boundary.wall)
        return bool(boundary.symmetry or boundary.extensions) or any(it is not None for it in (*normal, *loads_given))

    def _point(self, point: Point) -> Iterator[Condition]:
        for field in ("u1", "u2", "w"):
            history = getattr(point, field)
            if history is not None:
                yield Prescribed(point.at, field, self.path.function(history, 0.0))

    def _boundary(self, name: str, boundary: Boundary) -> Iterator[Condition]:
        for field in ("u1", "u2", "w"):
            history = getattr(boundary, field)
            if history is not None:
                yield Prescribed(name, field, self.path.function(history, 0.0))
        if boundary.t1 is not None or boundary.t2 is not None:
            yield self._traction(name, boundary)
        if boundary.couple is not None:
            couple = self.path.load(boundary.couple, 0.0)
            yield Load(lambda m, u, w, v, q, ds: couple_work(m[0], q, ds), lambda t: (couple(t),), name)
        if boundary.pressure is not None:
            yield self._pressure(name, boundary.pressure)
        if boundary.symmetry:
            yield from self._symmetry(name)
        if boundary.rotational_resistance:
            resistance = self._constant(boundary.rotational_resistance)
            yield Work(lambda u, w, v, q, ds: rotational_resistance_work(resistance, w, q, ds), name)
        if boundary.wall is not None:
            yield from self._wall(name, boundary.wall)
        context = BoundaryContext(
            self.path.function, self.scene.material, self.scene.effects.polar, self.scene.material.d50
        )
        for table in boundary.extensions.values():
            assert isinstance(table, MakesConditions)
            yield from table.conditions(name, context)

    # -- loads -----------------------------------------------------------------------------------------------------

    def _traction(self, name: str, boundary: Boundary) -> Load:
        """Components of a dead traction; what they do not give is that of a boundary free of traction.

        Each is a factor of the traction that balances the initial stress, which goes from 1 to 0, and a value beside.
        """
        stress = self.scene.initial.stress
        histories = [0.0 if history is None else history for history in (boundary.t1, boundary.t2)]
        values = [self.path.load(history, 0.0) for history in histories]
        fade = self.path.function((0.0,), 1.0)
        balances: list[Function] = [
            fade if initial_load(history) is None else lambda travel: 1.0 - self.path.loaded(travel)
            for history in histories
        ]

        def value(travel: float) -> list[float]:
            return [stress * b(travel) for b in balances] + [f(travel) for f in values]

        return Load(
            lambda t, u, w, v, q, ds: balancing_work(_part(t, 0), v, ds) + traction_work(_part(t, 2), v, ds),
            value,
            name,
        )

    def _pressure(self, name: str, history: History) -> Load:
        pressure, finite = self.path.load(history, -self.scene.initial.stress), self.finite
        return Load(
            lambda p, u, w, v, q, ds: pressure_work(p[0], u, v, ds, "plane", finite=finite),
            lambda travel: (pressure(travel),),
            name,
        )

    def _weight(self) -> list[Condition]:
        weight = self.scene.weight
        if weight is None:
            return []
        full = weight.density * weight.gravity
        return [Load(lambda g, u, w, v, q, dx: weight_work(g[0], v, dx), lambda t: (full * self.path.loaded(t),))]

    # -- symmetry and walls ----------------------------------------------------------------------------------------

    def _symmetry(self, name: str) -> Iterator[Condition]:
        """No displacement normal to the boundary and no rotation; nothing along it."""
        axis = self.geometry.is_axis_aligned(name)
        if axis is None:
            yield self._normal_tie(name, lambda travel: (0.0, 0.0))
        else:
            yield from fixed(name, _COMPONENTS[axis])
        if self.scene.effects.polar:
            yield from fixed(name, "w")

    def _wall(self, name: str, wall: BoundaryWall) -> Iterator[Condition]:
        """Displacement of the particles at a wall, and their rotation, on a straight or curved boundary."""
        axis = self.geometry.is_axis_aligned(name)
        along, across = self.path.function(wall.u1, 0.0), self.path.function(wall.u2, 0.0)
        part, turn = wall.displacement_factor, wall.rolling_rotation_factor(self.scene.material.d50)

        def move(travel: float) -> tuple[float, float]:
            return along(travel), across(travel)

        if wall.pressure is not None:
            yield self._pressure(name, wall.pressure)
        normal_held, tangent_held = wall.pressure is None, not wall.free
        if axis is not None:
            held = [normal_held, tangent_held] if axis == 0 else [tangent_held, normal_held]
            for i, field in enumerate(_COMPONENTS):
                if held[i]:
                    yield Prescribed(name, field, _scaled((along, across)[i], 1.0 if i == axis else part))
        elif normal_held and tangent_held:
            normals = BoundaryNormals(self.geometry, name)
            for i, field in enumerate(_COMPONENTS):
                yield Prescribed(name, field, move, partial(_carried, normals, part, i))
        elif normal_held:
            yield self._normal_tie(name, move)
        elif tangent_held:
            yield self._tangential_tie(name, lambda t: tuple(part * m for m in move(t)))
        if not self.scene.effects.polar:
            return
        if tangent_held:
            normals = BoundaryNormals(self.geometry, name)
            yield Prescribed(name, "w", move, lambda at: -turn * _tangents(normals(at)))
        else:
            yield self._rolling_tie(name, turn / part)

    def _normal_tie(self, name: str, move: Callable[[float], Sequence[float]]) -> Load:
        stiffness, normal, order = self._tie_stiffness(), self._normal_field(name, self.order), self.order
        return Load(
            lambda d, u, w, v, q, ds: ties.normal_tie_work(d, stiffness, normal, u, v, ties.at_nodes(ds, order)),
            move,
            name,
        )

    def _tangential_tie(self, name: str, move: Callable[[float], Sequence[float]]) -> Load:
        stiffness, normal, order = self._tie_stiffness(), self._normal_field(name, self.order), self.order
        return Load(
            lambda d, u, w, v, q, ds: ties.tangential_tie_work(d, stiffness, normal, u, v, ties.at_nodes(ds, order)),
            move,
            name,
        )

    def _rolling_tie(self, name: str, turn: float) -> Work:
        rotation, normal = self._constant(turn), self._normal_field(name, 1)
        couple = self._tie_stiffness(self.scene.material.couple_over_shear_stiffness)
        return Work(
            lambda u, w, v, q, ds: ties.rolling_tie_work(rotation, couple, normal, u, w, v, q, ties.at_nodes(ds, 1)),
            name,
        )

    def _normal_field(self, name: str, order: int) -> dolfinx.fem.Function:
        """Unit outward normals at the nodes of one boundary, nought at all others."""
        mesh = self.geometry.mesh
        element = basix.ufl.element("Lagrange", mesh.basix_cell(), order, shape=(2,))
        field = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))
        space = field.function_space
        nodes = dolfinx.fem.locate_dofs_topological(space, 1, self.geometry.boundaries[name])
        at = space.tabulate_dof_coordinates()[nodes, :2]
        field.x.array.reshape(-1, 2)[nodes] = BoundaryNormals(self.geometry, name)(at)
        return field

    def _tie_stiffness(self, factor: float = 1.0) -> dolfinx.fem.Constant:
        """Of springs (Pa/m, times the factor), from the initial shear stiffness and the smallest cell."""
        initial, material = self.scene.initial, self.scene.material
        shear = material.shear_stiffness(-initial.stress, np.array([initial.void_ratio]))[0]
        sizes = self.geometry.cell_sizes()
        smallest = self.geometry.mesh.comm.allreduce(float(sizes.min(initial=np.inf)), op=MPI.MIN)
        return self._constant(TIE_STIFFNESS * factor * shear / smallest)

    def _constant(self, value: float) -> dolfinx.fem.Constant:
        """A number that is not compiled into the forms."""
        return dolfinx.fem.Constant(self.geometry.mesh, value)


def _part(values: Expr, first: int) -> Expr:
    """Two components of a vector."""
    return ufl.as_vector([values[first], values[first + 1]])


def _tangents(normals: Array) -> Array:
    """Normals (m, 2) turned clockwise."""
    return np.stack([normals[:, 1], -normals[:, 0]], axis=1)


def _scaled(function: Function, factor: float) -> Function:
    """A function of travel times a factor."""
    return lambda travel: factor * function(travel)


def _carried(normals: BoundaryNormals, part: float, component: int, places: Array) -> Array:
    """What a component of the particles' displacement takes from each one of the wall's, (m, 2).

    Args:
        normals: of the wall.
        part: of the wall's displacement along itself that is transmitted; across it is all.
        component: 0 or 1.
        places: (m, 2) reference coordinates of the particles (m).
    """
    n = normals(places)
    t = _tangents(n)
    taken: Array = n[:, [component]] * n + part * t[:, [component]] * t
    return taken
