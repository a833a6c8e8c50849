"""Where a sequence of ever finer runs goes, and how fast its errors fall.

Values are numbers or arrays of one shape, such as profiles; the size of an array is its root mean square.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import linregress

from cosserat_fx.typing import Array

SLOWEST, FASTEST = 0.5, 2.5
"""Observed orders of convergence that are taken for a rate."""
STEADY = 1.0
"""Largest change of the observed order from one pair of differences to the next that is taken for a steady rate."""
ALIGNED = 0.5
"""Smallest cosine between successive changes of an array that count as changes in the same direction."""


class Limit(NamedTuple):
    """Where a sequence goes.

    Attributes:
        value: extrapolated where there is a clean rate, otherwise the finest.
        error: a bound of its size.
        rate: observed order of convergence, nan where there is no clean one.
    """

    value: Array
    error: float
    rate: float

    @property
    def extrapolated(self) -> bool:
        """Whether there is a clean rate."""
        return not math.isnan(self.rate)


def limit(values: Sequence[ArrayLike], *, steady: float = math.inf) -> Limit:
    """Where a sequence goes whose resolution doubles from one value to the next.

    Richardson's extrapolation is made where the last three values show a clean rate: their changes point the same way,
    and the observed order, log2 of the changes' ratio, is between :data:`SLOWEST` and :data:`FASTEST`.

    Args:
        values: at least two, from coarse to fine, numbers or arrays of one shape.
        steady: by how much the order may differ from that of the three values before, where there are four.

    Returns:
        The limit. The bound of its error is the largest of the last change, a quarter of the one before (the last may
        be small by chance) and the extrapolation's correction.
    """
    changes = [np.subtract(finer, coarser) for coarser, finer in pairwise(values)]
    finest, last = np.asarray(values[-1], dtype=np.float64), changes[-1]
    orders = [_order(before, after) for before, after in pairwise(changes[-3:])]
    clean = bool(orders) and SLOWEST < orders[-1] < FASTEST
    if clean and len(orders) == 2 and math.isfinite(steady):
        clean = abs(orders[1] - orders[0]) <= steady
    correction = last / (2 ** orders[-1] - 1) if clean else np.zeros_like(last)
    before = size(changes[-2]) / 4 if len(changes) > 1 else 0.0
    error = max(size(last), before, size(correction))
    return Limit(finest + correction, error, orders[-1] if clean else math.nan)


def size(values: ArrayLike) -> float:
    """Root mean square of an array, the magnitude of a number."""
    return float(np.sqrt(np.mean(np.square(values))))


def _order(before: Array, after: Array) -> float:
    """Observed order from two successive changes; nan where they do not point the same way."""
    lengths = size(before), size(after)
    if not all(lengths) or np.mean(before * after) < ALIGNED * lengths[0] * lengths[1]:
        return math.nan
    return math.log2(lengths[0] / lengths[1])


@dataclass(frozen=True)
class Rate:
    """The power with which errors fall.

    Attributes:
        order: slope of error over resolution on logarithmic axes.
        standard_error: of the slope; nan for two points.
        factor: error at a resolution of 1.
        points: how many errors it is fitted to.
    """

    order: float
    standard_error: float
    factor: float
    points: int

    def __str__(self) -> str:
        """The order with its standard error."""
        doubt = "" if math.isnan(self.standard_error) else f" \u00b1 {self.standard_error:.2f}"
        return f"{self.order:.2f}{doubt}"


def fit_rate(resolutions: Sequence[float], errors: Sequence[float]) -> Rate | None:
    """Fit error = factor * resolution^order on logarithmic axes.

    Args:
        resolutions: sizes of what is refined, such as the cells; positive.
        errors: their errors, positive.

    Returns:
        The fit, or None for fewer than two points.
    """
    if len(errors) < 2:
        return None
    line = linregress(np.log(resolutions), np.log(errors))
    doubt = float(line.stderr) if len(errors) > 2 else math.nan
    return Rate(float(line.slope), doubt, math.exp(line.intercept), len(errors))
