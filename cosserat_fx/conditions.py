"""Boundary conditions of a problem, as functions of the travel along its loading path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

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


Condition = Prescribed | Traction


def fixed(boundary: str, *fields: Field) -> list[Prescribed]:
    """The given components held at zero on a boundary."""
    return [Prescribed(boundary, field, lambda travel: 0.0) for field in fields]
