"""Boundary conditions of a problem, as functions of the travel along its loading path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import ufl
from ufl.core.expr import Expr

from cosserat_fx.forms.traction import traction_work
from cosserat_fx.typing import Array

Field = Literal["u1", "u2", "u3", "w"]
Point = tuple[float, ...]


@dataclass(frozen=True)
class Prescribed:
    """A displacement component (m) or the Cosserat rotation (rad) that is given on a boundary or at a point.

    Where two of them give the same field at a node, the one listed first holds.

    Attributes:
        boundary: name of the boundary, or coordinates (m) of the point whose nearest node is meant.
        field: the component.
        value: its value at a travel (m) along the path, or factors of the ``profile``.
        profile: functions of the place, from reference coordinates (m, gdim) in m to (m, factors); their sum, each
            times its factor, is the value. None: uniform.
    """

    boundary: str | Point
    field: Field
    value: Callable[[float], float | Sequence[float]]
    profile: Callable[[Array], Array] | None = None


VirtualWork = Callable[[Expr, Expr | None, Expr, Expr | None, ufl.Measure], ufl.Form]
"""Returns virtual work, linear in v and q, from u, w, v, q and a measure of the reference configuration.

These are displacement (m) and rotation (rad) at the end of the step and their virtual counterparts; w and q are None in
a classical continuum.
"""

LoadWork = Callable[[Expr, Expr, Expr | None, Expr, Expr | None, ufl.Measure], ufl.Form]
"""Returns virtual work as :data:`VirtualWork` does, from the vector of the load's values and the rest."""


@dataclass(frozen=True)
class Work:
    """A load or resistance given by its virtual work on the body, such as springs at a wall or weight.

    The Jacobian gets its derivative from UFL, so it may depend on u and w. Work that resists a motion is negative.

    Attributes:
        form: the virtual work, a UFL form.
        boundary: name of the boundary whose reference area is integrated over, or None for the volume of the body.
    """

    form: VirtualWork
    boundary: str | None = None


@dataclass(frozen=True)
class Load:
    """A :class:`Work` that changes along the path, such as a traction or a pressure.

    Attributes:
        form: the virtual work, a UFL form.
        value: the load's values at a travel (m) along the path.
        boundary: name of the boundary whose reference area is integrated over, or None for the volume of the body.
    """

    form: LoadWork
    value: Callable[[float], Sequence[float]]
    boundary: str | None = None


Condition = Prescribed | Work | Load


def fixed(boundary: str, *fields: Field) -> list[Prescribed]:
    """The given components held at zero on a boundary."""
    return [Prescribed(boundary, field, lambda travel: 0.0) for field in fields]


def traction(boundary: str, value: Callable[[float], Sequence[float]]) -> Load:
    """A dead traction, per reference area (Pa).

    Args:
        boundary: name of the boundary.
        value: its components at a travel (m) along the path.
    """
    return Load(lambda t, u, w, v, q, ds: traction_work(t, v, ds), value, boundary)
