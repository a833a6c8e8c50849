"""What a walk of a layer comes to: the peak and the end of every leg, and how finely it was stepped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cosserat_fx.output.layer_bands import vertex
from cosserat_fx.scenes.layer import Leg
from cosserat_fx.typing import Array

FLOOR = 0.1
"""Part of the largest shear stress of the path by which an error is divided at least, as a shear stress may be 0."""
_SAME_TRAVEL = 1e-9


@dataclass(frozen=True)
class Trace:
    """A walk to the end of a path.

    Shear stresses count along the direction of their leg.

    Attributes:
        peaks: (legs,) largest shear stress among the steps (Pa).
        vertices: (legs,) the same of the parabola through the largest and its neighbours (Pa).
        ends: (legs,) shear stress at the end of the leg (Pa).
        straddle: (legs,) by how much steps of this size miss the parabola's vertex where it lies half-way between two
            of them (Pa).
        rate_error: mean of the steps' :attr:`~cosserat_fx.stepping.Step.rate_error`, by their sizes.
    """

    peaks: Array
    vertices: Array
    ends: Array
    straddle: Array
    rate_error: float

    @classmethod
    def of(
        cls, travel: Array, shear: Array, corners: Sequence[float], legs: Sequence[Leg], *, rate_error: float
    ) -> Trace:
        """Measure a walk.

        Args:
            travel: (steps,) along the path, at the end of every step (m).
            shear: (steps,) shear stress on the top wall there (Pa).
            corners: travel at the start and at the end of every leg, those of loading before the first leg included.
            legs: the scene's.
            rate_error: of the walk.
        """
        ends = np.array(corners[len(corners) - len(legs) - 1 :])
        bounds = np.searchsorted(travel, ends + _SAME_TRAVEL * ends[-1], side="right")
        walls = [0.0, *(leg.travel for leg in legs)]
        found = []
        for (begin, end), (before, after) in zip(pairwise(bounds), pairwise(walls), strict=True):
            sheared = shear[begin:end]
            along = sheared * (np.sign(after - before) or np.sign(sheared[-1]) or 1.0)
            top = int(np.argmax(along))
            x = travel[begin:end]
            found.append((along[top], vertex(x, along, top)[1], along[-1], _straddle(x, along, top)))
        peaks, vertices, last, straddle = np.array(found).T
        return cls(peaks, vertices, last, straddle, rate_error)

    @property
    def values(self) -> Array:
        """What converges: (2, legs), peaks (the vertices) and residuals (Pa)."""
        return np.stack([self.vertices, self.ends])

    @property
    def sampling(self) -> Array:
        """(2, legs) by how much the steps miss the vertices, relative; nothing at the ends of the legs."""
        return self._of_peaks(self.vertices - self.peaks)

    @property
    def chance(self) -> Array:
        """(2, legs) by how much other steps of this size may miss the vertices, relative."""
        return self._of_peaks(self.straddle)

    def _of_peaks(self, differences: Array) -> Array:
        relative: Array = np.stack([np.abs(differences), np.zeros(len(differences))]) / scale(self.values)
        return relative


def _straddle(x: Array, value: Array, top: int) -> float:
    """How far below its vertex the parabola through the largest row and its neighbours is, half a step beside it."""
    if not 0 < top < len(x) - 1:
        return 0.0
    steps, slopes = np.diff(x[top - 1 : top + 2]), np.diff(value[top - 1 : top + 2]) / np.diff(x[top - 1 : top + 2])
    bend = (slopes[1] - slopes[0]) / steps.sum()
    return float(abs(bend) * steps.max() ** 2 / 4)


def scale(values: Array) -> Array:
    """By what errors of values (2, legs) are divided: their sizes, or a part of the largest where that is more (Pa)."""
    sizes: Array = np.abs(values)
    return np.maximum(sizes, FLOOR * sizes.max())


def apart(values: Array, others: Array) -> Array:
    """(2, legs) relative differences of values from others."""
    difference: Array = np.abs(values - others) / scale(others)
    return difference
