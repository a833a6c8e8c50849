"""The weak form of a problem, put together from its parts and compiled: residual, Jacobian and strain increments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import basix.ufl
import numpy as np
import ufl
from ufl.core.expr import Expr

from cosserat_fx._compat import dolfinx
from cosserat_fx.conditions import Condition, Load, Work
from cosserat_fx.forms import balance, kinematics, stabilization
from cosserat_fx.geometry import Geometry
from cosserat_fx.state import QuadratureState


@dataclass(frozen=True)
class Numerics:
    """Which effects a problem has and how its integrals are taken.

    Attributes:
        polar: Cosserat rotations and couple stresses; without them the continuum is classical.
        finite: increments and balance on the deforming configuration instead of the reference one.
        spin: objective terms with the spin of the displacement ("macro"), of the rotation ("cosserat"), or "none".
        void_ratio: whether the void ratio evolves.
        order: polynomial degree of the displacement; the rotation is linear.
        degree: of the quadrature rule; 1 is one point per cell.
        hourglass: resistance to hourglass modes over the initial elastic one; 0 is none.
        local_tolerance: of the constitutive update's error estimate, relative to the trace of the stress.
    """

    polar: bool = True
    finite: bool = True
    spin: str = "macro"
    void_ratio: bool = True
    order: int = 1
    degree: int = 1
    hourglass: float = 0.0
    local_tolerance: float = 1e-3


class Stiffness(NamedTuple):
    """Resistance to hourglass modes: coefficients for displacement (Pa) and rotation (N)."""

    shear: Expr
    couple: Expr


@dataclass(frozen=True)
class WeakForm:
    """Compiled forms of one problem.

    Attributes:
        internal: virtual work of the stresses and of the stabilisation.
        residual: the same less that of the loads.
        jacobian: derivative of the residual.
        increments: strain, curvature and spin increments at the quadrature points, which drive the law.
        stabilisation: the part of the internal work that resists hourglass modes, where there is one.
        external: work of the loads on each boundary that has some, and under None of those in the body.
        loads: the conditions that change along the path, each with the constant that holds its values.
    """

    internal: dolfinx.fem.Form
    residual: dolfinx.fem.Form
    jacobian: dolfinx.fem.Form
    increments: dolfinx.fem.Expression
    stabilisation: dolfinx.fem.Form | None
    external: Mapping[str | None, dolfinx.fem.Form]
    loads: tuple[tuple[Load, dolfinx.fem.Constant], ...]


def element(mesh: dolfinx.mesh.Mesh, *, polar: bool, order: int = 1) -> basix.ufl._ElementBase:
    """Displacement of the given order and, in a polar continuum, linear rotation."""
    cell, gdim = mesh.basix_cell(), mesh.geometry.dim
    displacement = basix.ufl.element("Lagrange", cell, order, shape=(3 if gdim == 3 else 2,))
    if not polar:
        return displacement
    rotation = basix.ufl.element("Lagrange", cell, 1, shape=(3,) if gdim == 3 else None)
    return basix.ufl.mixed_element([displacement, rotation])


def split(function: Expr, *, polar: bool) -> tuple[Expr, Expr | None]:
    """Displacement and rotation (None in a classical continuum) of a function of :func:`element`'s space."""
    return ufl.split(function) if polar else (function, None)


def build(
    geometry: Geometry,
    numerics: Numerics,
    state: QuadratureState,
    conditions: Sequence[Condition],
    unknown: dolfinx.fem.Function,
    committed: dolfinx.fem.Function,
    stiffness: Stiffness | None,
    *,
    length: float,
) -> WeakForm:
    """Put the weak form together and compile it.

    Args:
        geometry: mesh, dimension, boundaries.
        numerics: effects and quadrature.
        state: holds the coefficients of stress and tangent.
        conditions: the natural ones among them enter the forms.
        unknown: fields at the end of the step.
        committed: fields at its start.
        stiffness: of the stabilisation, where there is one.
        length: by which virtual rotations are divided, so that the whole residual is a force (m).
    """
    mesh, dimension, finite, polar = geometry.mesh, geometry.dimension, numerics.finite, numerics.polar
    layout, space = state.layout, unknown.function_space
    trial = ufl.TrialFunction(space)
    v, q = split(ufl.TestFunction(space), polar=polar)
    u, w = split(unknown, polar=polar)
    u_n, w_n = split(committed, polar=polar)
    q = None if q is None else q / length

    step = kinematics.increments(u, u_n, w, w_n, dimension, finite=finite, spin=numerics.spin)
    increments = kinematics.pack(
        (step.strain, layout.strain), (step.curvature, layout.curvature), (step.spin, layout.spin)
    )
    strain, curvature = kinematics.virtual_strain(v, q, u, dimension, finite=finite)
    virtual = kinematics.pack((strain, layout.strain), (curvature, layout.curvature))
    volume = kinematics.determinant(kinematics.deformation_gradient(u, dimension, finite=finite), dimension)
    dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": numerics.degree, "quadrature_scheme": "default"})
    internal = balance.internal_work(state.forces, layout.strain_slots, layout.weights, virtual, volume, dx)
    jacobian = balance.linearised_work(
        internal,
        unknown,
        trial,
        state.tangent,
        increments,
        layout.strain_slots,
        layout.weights,
        virtual,
        volume,
        dx,
    )
    stabilisation = None
    if stiffness is not None:
        stabilisation = stabilization.hourglass_work(u, w, v, q, *stiffness, dx)
        internal += stabilisation
        jacobian += ufl.derivative(stabilisation, unknown, trial)

    residual = internal
    measures = _boundary_measures(geometry, conditions)
    external: dict[str | None, ufl.Form] = {}
    loads = []
    for condition in conditions:
        if not isinstance(condition, Work | Load):
            continue
        measure = dx if condition.boundary is None else measures[condition.boundary]
        if isinstance(condition, Load):
            value = dolfinx.fem.Constant(mesh, np.zeros(len(condition.value(0.0))))
            loads.append((condition, value))
            work = condition.form(value, u, w, v, q, measure)
        else:
            work = condition.form(u, w, v, q, measure)
        residual -= work
        jacobian -= ufl.derivative(work, unknown, trial)
        external[condition.boundary] = external.get(condition.boundary, 0) + work
    return WeakForm(
        internal=dolfinx.fem.form(internal),
        residual=dolfinx.fem.form(residual),
        jacobian=dolfinx.fem.form(jacobian),
        increments=dolfinx.fem.Expression(increments, state.rule_points),
        stabilisation=None if stabilisation is None else dolfinx.fem.form(stabilisation),
        external={name: dolfinx.fem.form(work) for name, work in external.items()},
        loads=tuple(loads),
    )


def _boundary_measures(geometry: Geometry, conditions: Sequence[Condition]) -> dict[str, ufl.Measure]:
    """The measure of each loaded boundary in the reference configuration."""
    loaded = [c.boundary for c in conditions if isinstance(c, Work | Load) and c.boundary is not None]
    names = list(dict.fromkeys(loaded))
    if not names:
        return {}
    ds = ufl.Measure("ds", geometry.mesh, subdomain_data=geometry.facet_tags(names))
    return {name: ds(tag) for tag, name in enumerate(names)}
