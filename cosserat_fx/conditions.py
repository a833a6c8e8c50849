"""Boundary conditions of a problem, as functions of the travel along its loading path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import ufl
from ufl.core.expr import Expr

Field = Literal["u1", "u2", "u3", "w"]


@dataclass(frozen=True)
class Prescribed:
    """A displacement component (m) or the Cosserat rotation (rad) that is given on a boundary.

    Attributes:
        boundary: name of the boundary.
        field: the component.
        value: its value at a travel (m) along the path.
    """

    boundary: str
    field: Field
    value: Callable[[float], float]


@dataclass(frozen=True)
class Traction:
    """A dead traction, per reference area (Pa).

    Attributes:
        boundary: name of the boundary.
        value: its components at a travel (m) along the path.
    """

    boundary: str
    value: Callable[[float], Sequence[float]]


VirtualWork = Callable[[Expr, Expr | None, Expr, Expr | None, ufl.Measure], ufl.Form]
"""Returns virtual work, linear in v and q, from u, w, v, q and a measure of the reference configuration.

These are displacement (m) and rotation (rad) at the end of the step and their virtual counterparts; w and q are None in
a classical continuum.
"""


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


Condition = Prescribed | Traction | Work


def fixed(boundary: str, *fields: Field) -> list[Prescribed]:
    """The given components held at zero on a boundary."""
    return [Prescribed(boundary, field, lambda travel: 0.0) for field in fields]
