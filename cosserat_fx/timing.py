"""Seconds spent in each phase of a run, and how to tell a duration."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter


class Stopwatch:
    """Adds up wall seconds and calls by phase.

    A phase inside another one is taken out of the outer one, so that all phases together are no more than the whole.

    Attributes:
        seconds: by phase.
        calls: by phase.
    """

    def __init__(self) -> None:
        """Start with no phases."""
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.calls: defaultdict[str, int] = defaultdict(int)
        self._inside = 0.0

    def add(self, seconds: Mapping[str, float], calls: Mapping[str, int]) -> None:
        """Count in what was timed before.

        Args:
            seconds: by phase.
            calls: by phase.
        """
        for phase, more in seconds.items():
            self.seconds[phase] += more
        for phase, more_calls in calls.items():
            self.calls[phase] += more_calls

    @contextmanager
    def __call__(self, phase: str) -> Iterator[None]:
        """Time the body of a ``with`` statement as part of a phase."""
        before, self._inside = self._inside, 0.0
        start = perf_counter()
        try:
            yield
        finally:
            seconds = perf_counter() - start
            self.seconds[phase] += seconds - self._inside
            self.calls[phase] += 1
            self._inside = before + seconds


def duration(seconds: float) -> str:
    """A duration in the unit that suits it, to the two digits that an estimate may have."""
    suiting = [(unit, size) for unit, size in (("h", 3600.0), ("min", 60.0)) if seconds >= 1.5 * size]
    unit, size = suiting[0] if suiting else ("s", 1.0)
    return f"{float(f'{seconds / size:.2g}'):g} {unit}"
