"""Boundary conditions that users bring along: keys of `[boundaries.NAME]` that a Python file of theirs registers.

A scene executes nothing. The user's own program registers a table before it loads the scene, and the scene may then
use the table's key on any boundary.
"""

from __future__ import annotations

import re

from cosserat_fx.scenes.plane import Boundary
from cosserat_fx.scenes.registry import IDENTIFIER, BoundaryContext, MakesConditions, enter
from cosserat_fx.scenes.schema import Table

__all__ = ["BoundaryContext", "Table", "register"]


def register(name: str, table: type[Table]) -> None:
    """Makes a key known that `[boundaries.NAME]` may hold from now on.

    Args:
        name: the key.
        table: validates what stands under the key; it has the method `conditions` of `MakesConditions`.

    Raises:
        ValueError: the name is no identifier, or already taken by the program or another table.
        TypeError: the table is not derived from `Table`, or has no method `conditions`.
    """
    if not re.fullmatch(IDENTIFIER, name):
        raise ValueError(f"{name!r} must be made of letters, digits and underscores, beginning with a letter")
    if name in {*dir(Boundary), *Boundary.model_fields}:
        raise ValueError(f"{name!r} is already taken")
    if not issubclass(table, Table) or not issubclass(table, MakesConditions):
        raise TypeError(f"{table.__name__} must be derived from Table and have the method conditions")
    enter(name, table)
