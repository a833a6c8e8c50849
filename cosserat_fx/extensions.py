"""Boundary conditions that users bring along: keys of `[boundaries.NAME]` that a Python file of theirs registers.

A scene executes nothing. The user's own program registers a table before it loads the scene, and the scene may then
use the table's key on any boundary.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

from cosserat_fx.material import Material
from cosserat_fx.scenes.histories import History
from cosserat_fx.scenes.schema import Table

if TYPE_CHECKING:
    from cosserat_fx.conditions import Condition

IDENTIFIER: Final = r"[A-Za-z][A-Za-z0-9_]*"
"""Names that a user may give."""


@dataclass(frozen=True)
class BoundaryContext:
    """What a boundary condition may need to know beside its own keys.

    Attributes:
        history: makes a function of travel (m) from a history and its value at the start. A number is reached linearly
            over the first leg and held; for one that acts from the start give it as its own value at the start.
        material: constants of the law.
        polar: whether there are rotations and couples.
        length: mean grain diameter d50 (m).
    """

    history: Callable[[History, float], Callable[[float], float]]
    material: Material
    polar: bool
    length: float


@runtime_checkable
class MakesConditions(Protocol):
    """A table that says what happens on a boundary."""

    def conditions(self, boundary: str, context: BoundaryContext) -> Sequence[Condition]:
        """Returns the conditions of a boundary.

        Args:
            boundary: its name.
            context: what else they may depend on.
        """


_tables: dict[str, type[Table]] = {}


def register(name: str, table: type[Table]) -> None:
    """Makes a key known that `[boundaries.NAME]` may hold from now on.

    Args:
        name: the key.
        table: validates what stands under the key; it has the method `conditions` of `MakesConditions`.

    Raises:
        ValueError: the name is no identifier, or already taken by the program or another table.
        TypeError: the table is not derived from `Table`, or has no method `conditions`.
    """
    from cosserat_fx.scenes.plane import Boundary  # which asks this module for the keys registered

    if not re.fullmatch(IDENTIFIER, name):
        raise ValueError(f"{name!r} must be made of letters, digits and underscores, beginning with a letter")
    if name in {*dir(Boundary), *Boundary.model_fields} or _tables.get(name, table) is not table:
        raise ValueError(f"{name!r} is already taken")
    if not issubclass(table, Table) or not issubclass(table, MakesConditions):
        raise TypeError(f"{table.__name__} must be derived from Table and have the method conditions")
    _tables[name] = table


def registered() -> Mapping[str, type[Table]]:
    """Returns the tables registered so far, by key."""
    return MappingProxyType(_tables)
