"""The converged reference of a study: steps and cells refined until their limits are in sight.

Both refinements share a corner, the run with the cells c and the steps s. To the limit of the steps at the cells c is
added what these cells miss, from the refinement of the cells at the steps s:

    reference = lim V(c, .) + lim V(., s) - V(c, s).

What this leaves out is the part of the error that depends on both. One run with both finer by a level shows it: with
errors that fall with the orders p and q, the mixed difference of the four runs is (1 - 2^-p) (1 - 2^-q) of that part.
Without two clean orders it is taken as it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cosserat_fx.studies.choice import Choice
from cosserat_fx.studies.convergence import STEADY, Limit, limit, size
from cosserat_fx.studies.plan import Refinement
from cosserat_fx.studies.quantities import Measured, Quantity
from cosserat_fx.typing import Array


@dataclass(frozen=True)
class Reference:
    """The converged value of one quantity.

    Attributes:
        value: of shape () or (n,).
        step_error, cell_error, local_error, mixed_error: parts of the bound of its error, in the quantity's unit;
            0 where nothing was refined.
        step_rate, cell_rate: observed orders of convergence by which it was extrapolated, nan where it was not and the
            finest run counts.
    """

    value: Array
    step_error: float
    cell_error: float
    local_error: float
    mixed_error: float
    step_rate: float
    cell_rate: float

    @property
    def error(self) -> float:
        """Bound of the whole error."""
        return self.step_error + self.cell_error + self.local_error + self.mixed_error


class Levels:
    """The refinement of one knob, as far as its runs came to their end.

    Attributes:
        choices: a part of the refinement without gaps, around the corner.
    """

    def __init__(self, planned: Sequence[Choice], corner: Choice, measured: Mapping[Choice, Measured]) -> None:
        """Leave out what failed, and what lies beyond that.

        Args:
            planned: from coarse to fine.
            corner: one of them.
            measured: what the runs came to.
        """
        at = planned.index(corner)
        coarse, fine = at, at
        while coarse > 0 and planned[coarse - 1] in measured:
            coarse -= 1
        while fine + 1 < len(planned) and planned[fine + 1] in measured:
            fine += 1
        self.choices = list(planned[coarse : fine + 1])
        self._measured = measured

    def limit(self, quantity: Quantity) -> Limit | None:
        """Where a quantity goes; None where it is not to be had of two runs, the corner's among them."""
        values = [self._measured[choice].get(quantity.name) for choice in self.choices]
        present = [value for value in values if value is not None]
        return limit(present, steady=STEADY) if len(values) == len(present) > 1 else None


def reference(
    quantity: Quantity, refinement: Refinement, measured: Mapping[Choice, Measured], *, with_cells: bool
) -> Reference | None:
    """The converged value of a quantity, or None where the runs that came to their end do not suffice.

    Args:
        quantity: what.
        refinement: the runs planned for it.
        measured: what those came to that came to their end.
        with_cells: whether cells are refined.
    """
    corner = refinement.corner
    if corner not in measured or quantity.name not in measured[corner]:
        return None
    at_corner = measured[corner][quantity.name]
    steps = Levels(refinement.steps, corner, measured).limit(quantity)
    cells = (
        Levels(refinement.cells, corner, measured).limit(quantity) if with_cells else Limit(at_corner, 0.0, math.nan)
    )
    local = _difference(quantity, measured, refinement.looser, refinement.tighter)
    if steps is None or cells is None or local is None:
        return None
    mixed = _mixed(quantity, refinement, measured, steps.rate, cells.rate) if with_cells else 0.0
    return Reference(
        value=steps.value + cells.value - at_corner,
        step_error=steps.error,
        cell_error=cells.error,
        local_error=local,
        mixed_error=mixed,
        step_rate=steps.rate,
        cell_rate=cells.rate,
    )


def _difference(quantity: Quantity, measured: Mapping[Choice, Measured], *pair: Choice) -> float | None:
    """By how much two runs differ."""
    values = [measured[choice].get(quantity.name) for choice in pair if choice in measured]
    return size(values[0] - values[1]) if len(values) == 2 and values[0] is not None and values[1] is not None else None


def _mixed(quantity: Quantity, refinement: Refinement, measured: Mapping[Choice, Measured], *orders: float) -> float:
    """Bound of the part of the corner's error that depends on cells and steps together; 0 where it was not measured."""
    corner, diagonal = refinement.corner, refinement.diagonal
    if diagonal is None:
        return 0.0
    finer_cells = next((it for it in refinement.cells if it.cells == diagonal.cells), None)
    finer_steps = next((it for it in refinement.steps if it.steps == diagonal.steps), None)
    runs = [diagonal, finer_cells, finer_steps, corner]
    values = [measured[it].get(quantity.name) if it is not None and it in measured else None for it in runs]
    if any(value is None for value in values):
        return 0.0
    both, cells, steps, neither = (value for value in values if value is not None)
    clean = not any(map(math.isnan, orders))
    seen = math.prod(1 - 2**-order for order in orders) if clean else 1.0
    return size(both - cells - steps + neither) / seen
