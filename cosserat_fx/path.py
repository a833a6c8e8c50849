"""The loading path: wall displacements and normal stress as functions of the travel along it.

Travel is the path's own coordinate: the relative displacement of the walls added up over all legs, whichever their
direction (m). Where both walls move the same way, the displacement of the faster one takes its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np


@dataclass(frozen=True)
class Waypoint:
    """Where a leg ends.

    Attributes:
        top, bottom: displacement of the walls (m).
        length: travel of the leg that ends here (m).
        load: part of the change from the initial to the final normal stress that is applied (0 to 1).
    """

    top: float
    bottom: float
    length: float
    load: float = 1.0


class Path:
    """A piecewise linear path through waypoints.

    Attributes:
        corners: travel at the start and at every waypoint (m); the direction of loading changes there.
    """

    def __init__(self, waypoints: Sequence[Waypoint], *, initial_load: float = 1.0) -> None:
        """Start at rest.

        Args:
            waypoints: ends of the legs, in order.
            initial_load: part of the normal stress's change that is present from the start.
        """
        points = [Waypoint(0.0, 0.0, 0.0, initial_load), *waypoints]
        self.corners: list[float] = list(accumulate(p.length for p in points))
        self._top = [p.top for p in points]
        self._bottom = [p.bottom for p in points]
        self._load = [p.load for p in points]

    @property
    def length(self) -> float:
        """Travel of the whole path (m)."""
        return self.corners[-1]

    def at(self, leg: int, fraction: float) -> float:
        """Travel where a fraction of a leg is done (m)."""
        begin, end = self.corners[leg], self.corners[leg + 1]
        return end if fraction == 1.0 else begin + fraction * (end - begin)

    def top(self, travel: float) -> float:
        """Displacement of the top wall (m)."""
        return float(np.interp(travel, self.corners, self._top))

    def bottom(self, travel: float) -> float:
        """Displacement of the bottom wall (m)."""
        return float(np.interp(travel, self.corners, self._bottom))

    def load(self, travel: float) -> float:
        """Part of the normal stress's change that is applied (0 to 1)."""
        return float(np.interp(travel, self.corners, self._load))
