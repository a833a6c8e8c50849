"""Boundary conditions beside the built-in ones: the tables that user programs have registered, and what they get."""

from __future__ import annotations

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


def enter(name: str, table: type[Table]) -> None:
    """Enters a table under its key.

    Raises:
        ValueError: another table has the key.
    """
    if _tables.get(name, table) is not table:
        raise ValueError(f"{name!r} is already taken")
    _tables[name] = table


def registered() -> Mapping[str, type[Table]]:
    """Returns the tables registered so far, by key."""
    return MappingProxyType(_tables)
