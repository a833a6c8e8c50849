"""The loading path of a plane body: what its histories prescribe at a travel.

Travel is the path's own coordinate (m). Loads and weight that the initial stress does not balance are brought up first,
in a leg of their own; the histories of a scene begin where it ends, at ``start``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate

import numpy as np

from cosserat_fx.scenes.histories import History, HistoryTable

Function = Callable[[float], float]


class PlanePath:
    """Legs, and histories over them.

    Attributes:
        start: travel at which the histories begin; 0 where nothing is to be brought up first (m).
        corners: travel at the start, at ``start`` and at the end of every leg (m).
    """

    def __init__(self, leg_lengths: Sequence[float], *, loading: float = 0.0) -> None:
        """Lay out the path.

        Args:
            leg_lengths: travel of each leg (m).
            loading: travel of the leg that brings up loads and weight, 0 for none (m).
        """
        self.start = loading
        self._ends = [loading, *(loading + end for end in accumulate(leg_lengths))]
        self.corners = [0.0, *self._ends] if loading else self._ends

    @property
    def length(self) -> float:
        """Travel of the whole path, the leg of the loads included (m)."""
        return self._ends[-1]

    def loaded(self, travel: float) -> float:
        """Part of the loads that is brought up (0 to 1)."""
        return min(1.0, travel / self.start) if self.start else 1.0

    def function(self, history: History, initial: float) -> Function:
        """A history as a function of the travel.

        Args:
            history: a number is reached linearly over the first leg, a list at the ends of the legs.
            initial: value at the start of the first leg; a table has its own.
        """
        if isinstance(history, HistoryTable):
            places = [self.start + travel for travel in history.travel]
            values = list(history.value)
        else:
            values = [initial, *(history if isinstance(history, tuple) else (history,))]
            places = self._ends[: len(values)]
        return lambda travel: float(np.interp(travel, places, values))

    def load(self, history: History, balance: float) -> Function:
        """A load as a function of the travel: a number acts all along, a list begins at what balances the body.

        Args:
            history: of the load.
            balance: the load that balances the initial stress; before the first leg the load goes from it to the
                history's first value.
        """
        first = initial_load(history)
        value = self.function(history, balance if first is None else first)
        if first is None:
            return value
        return lambda travel: balance + self.loaded(travel) * (value(travel) - balance)


def initial_load(history: History) -> float | None:
    """The value that a load has at the start of the first leg; None where a list leaves it to the initial stress."""
    if isinstance(history, HistoryTable):
        return history.value[0]
    return None if isinstance(history, tuple) else history
