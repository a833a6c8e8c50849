"""Histories: what a scene prescribes along the path, and the legs and lengths of the path that follow from them.

Travel is the path's clock (m). A history is a number, a list of numbers, one for the end of each leg, or a table of
values over travel, linear between its entries and held after the last.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import accumulate, pairwise
from typing import Annotated, Any, Final, Self, get_args

import numpy as np
from annotated_types import MaxLen, MinLen
from pydantic import BeforeValidator, Discriminator, Tag, model_validator

from cosserat_fx.material import AdmissibilityError
from cosserat_fx.scenes.schema import MAX_LIST, ROUNDING, Table, Unit, list_as_tuple, spell_key

_Travels = Annotated[tuple[float, ...], BeforeValidator(list_as_tuple), MinLen(2), MaxLen(MAX_LIST), Unit("m")]
_Values = Annotated[tuple[float, ...], BeforeValidator(list_as_tuple), MinLen(2), MaxLen(MAX_LIST)]


class HistoryTable(Table):
    """Values over travel: linear between the entries, held after the last."""

    travel: _Travels
    """Travels, ascending from 0, m."""
    value: _Values
    """A value at each of them, in the unit of the key."""

    @model_validator(mode="after")
    def _check_entries(self) -> Self:
        if self.travel[0] != 0:
            raise AdmissibilityError("travel[0]", self.travel[0], "must be 0, the start of the path (m)")
        for index, (before, here) in enumerate(pairwise(self.travel), start=1):
            if here <= before:
                raise AdmissibilityError(f"travel[{index}]", here, f"must be greater than the entry before, {before:g}")
        if len(self.value) != len(self.travel):
            allowed = f"must have as many entries as travel, {len(self.travel)} and not {len(self.value)}"
            raise AdmissibilityError("value", self.value, allowed)
        return self


History = float | tuple[float, ...] | HistoryTable


class Meaning(Enum):
    """What a history prescribes, which decides how a number is read and whether it sets the length of a leg."""

    DISPLACEMENT = "displacement"
    """A number is a target, reached linearly over the first leg and held; a leg is as long as its largest change."""
    ROTATION = "rotation"
    """A number is a target as well, but its change sets no length."""
    LOAD = "load"
    """A number acts from the start."""


def _spelling(value: object) -> str:
    """Returns which spelling of a history a value is closest to."""
    if isinstance(value, list | tuple):
        return "list"
    return "table" if isinstance(value, dict | HistoryTable) else "number"


_Targets = Annotated[tuple[float, ...], BeforeValidator(list_as_tuple), MinLen(1), MaxLen(MAX_LIST)]
_Parsed = Annotated[
    Annotated[float, Tag("number")] | Annotated[_Targets, Tag("list")] | Annotated[HistoryTable, Tag("table")],
    Discriminator(_spelling),
]
DisplacementHistory = Annotated[_Parsed, Meaning.DISPLACEMENT, Unit("m")]
RotationHistory = Annotated[_Parsed, Meaning.ROTATION, Unit("rad")]
TractionHistory = Annotated[_Parsed, Meaning.LOAD, Unit("Pa, tension positive")]
PressureHistory = Annotated[_Parsed, Meaning.LOAD, Unit("Pa, compression positive")]
CoupleHistory = Annotated[_Parsed, Meaning.LOAD, Unit("N/m")]


@dataclass(frozen=True)
class Given:
    """A history that a table of the scene holds.

    Attributes:
        key: dotted key of the history.
        history: its value.
        meaning: what it prescribes.
    """

    key: str
    history: History
    meaning: Meaning


def histories(table: Table, key: str = "") -> Iterator[Given]:
    """Returns the histories given in a table and the tables in it, those of extensions included.

    Args:
        table: the table.
        key: dotted key of the table.
    """
    for name, field in type(table).model_fields.items():
        value = getattr(table, name)
        here = f"{key}.{spell_key(name)}".lstrip(".")
        meaning = _meaning([*field.metadata, field.annotation])
        if isinstance(value, Table) and not isinstance(value, HistoryTable):
            yield from histories(value, here)
        elif meaning and value is not None:
            yield Given(here, value, meaning)
    for name, value in (table.model_extra or {}).items():
        yield from histories(value, f"{key}.{name}".lstrip("."))


def _meaning(metadata: Sequence[Any]) -> Meaning | None:
    """Returns the meaning stated anywhere in an annotation and its metadata."""
    for it in metadata:
        found = it if isinstance(it, Meaning) else _meaning(get_args(it))
        if found:
            return found
    return None


def count_legs(given: Sequence[Given]) -> int:
    """Returns the number of legs: of the tables' travels where there are tables, of the lists' entries otherwise.

    Raises:
        AdmissibilityError: a list has another number of entries than the path has legs.
    """
    corners = _table_corners(given)
    lists = {it.key: it.history for it in given if isinstance(it.history, tuple)}
    if not corners and not lists:
        return 1
    if corners:
        legs, source = len(corners) - 1, "the travels of the tables make"
    else:
        first, entries = next(iter(lists.items()))
        legs, source = len(entries), f"{first} has"
    for key, entries in lists.items():
        if len(entries) != legs:
            allowed = f"must have one entry for each leg of the path: {source} {legs}, and not {len(entries)}"
            raise AdmissibilityError(key, entries, allowed)
    return legs


def _table_corners(given: Sequence[Given]) -> list[float]:
    """Returns the travels of all tables, ascending from 0, each once; nothing where there is no table (m)."""
    travels = sorted({travel for it in given if isinstance(it.history, HistoryTable) for travel in it.history.travel})
    corners: list[float] = []
    for travel in travels:
        if not corners or travel - corners[-1] > ROUNDING * travels[-1]:
            corners.append(travel)
    return corners


def leg_lengths(given: Sequence[Given], d50: float) -> tuple[float, ...]:
    """Returns the length of each leg, m.

    Tables give it directly: each travel in any of them ends a leg. Otherwise it is the largest change of a prescribed
    displacement in the leg, and d50 where none changes.

    Args:
        given: the scene's histories.
        d50: mean grain diameter, m.
    """
    corners = _table_corners(given)
    if corners:
        return tuple(end - begin for begin, end in pairwise(corners))
    changes = np.zeros(count_legs(given))
    for it in given:
        if it.meaning is Meaning.DISPLACEMENT:
            targets = np.atleast_1d(np.array(it.history, dtype=np.float64))  # a number is reached in the first leg
            with np.errstate(over="ignore"):
                change = np.abs(np.diff(targets, prepend=0.0))
            changes[: len(change)] = np.maximum(changes[: len(change)], change)
    return tuple((changes + d50 * (changes == 0)).tolist())


def check_motions_start_at_rest(given: Sequence[Given]) -> None:
    """Refuses tables that move something at the start.

    Raises:
        AdmissibilityError: the first value of a displacement's or rotation's table is not 0.
    """
    for it in given:
        table = it.history
        if it.meaning is not Meaning.LOAD and isinstance(table, HistoryTable) and table.value[0] != 0:
            allowed = "must be 0, as the body starts undeformed"
            raise AdmissibilityError(f"{it.key}.value[0]", table.value[0], allowed)


_EXTREMES: Final = ((min, np.inf), (max, -np.inf))


def largest_range(groups: Sequence[Sequence[History]], lengths: Sequence[float]) -> float:
    """Returns the largest difference of prescribed displacements along the same direction at any time, m.

    A displacement that is alone in its direction is compared with rest.

    Args:
        groups: the displacements prescribed along each direction.
        lengths: length of each leg, m.
    """
    corners, largest = np.array([0.0, *accumulate(lengths)]), 0.0
    for group in groups:
        held = [it for it in group if isinstance(it, float)] + [0.0] * (len(group) == 1)
        low, high = (np.full(len(corners), extreme(held, default=rest)) for extreme, rest in _EXTREMES)
        if held:
            low[0] = high[0] = 0.0
        for history in group:
            if isinstance(history, float):
                continue
            if isinstance(history, HistoryTable):
                values = np.interp(corners, history.travel, history.value)
            else:
                values = np.array([0.0, *history])
            low, high = np.minimum(low, values), np.maximum(high, values)
        with np.errstate(over="ignore"):
            largest = max(largest, float(np.max(high - low)) if group else 0.0)
    return largest
