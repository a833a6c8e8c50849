"""How far a run has come: a live bar on a terminal, plain lines in a log, nothing on other ranks."""

from __future__ import annotations

from time import monotonic
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cosserat_fx.stepping import Step

SECONDS_BETWEEN_LINES = 5.0


class Bar:
    """A live bar for as long as a ``with`` statement lasts."""

    _bar: Progress

    def __enter__(self) -> Self:
        """Show the bar."""
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away."""
        self._bar.stop()


class RunProgress(Bar):
    """Reports the steps of a run as they are accepted; a context manager."""

    def __init__(self, console: Console, length: float) -> None:
        """Start the clock.

        Args:
            console: where to; a quiet one on ranks other than the first.
            length: travel of the whole path (m).
        """
        self._console, self._length = console, length
        self._start = self._last_line = monotonic()
        self._bar = Progress(
            TextColumn("{task.fields[travel]:.2f} mm"),
            BarColumn(bar_width=None),
            TaskProgressColumn(),
            TextColumn("step {task.fields[step]}, {task.fields[rate]:.1f} steps/s, {task.fields[iterations]} its"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("", total=length, travel=0.0, step=0, rate=0.0, iterations=0)

    def report(self, step: Step) -> None:
        """Show an accepted step."""
        now = monotonic()
        rate = step.number / max(now - self._start, 1e-9)
        self._bar.update(
            self._task,
            completed=step.travel,
            travel=1e3 * step.travel,
            step=step.number,
            rate=rate,
            iterations=step.iterations,
        )
        done = step.travel >= self._length
        if not self._console.is_terminal and (done or now - self._last_line >= SECONDS_BETWEEN_LINES):
            self._last_line = now
            left = (now - self._start) * (self._length / step.travel - 1.0)
            self._console.print(
                f"step {step.number}: {1e3 * step.travel:.4g} of {1e3 * self._length:.4g} mm "
                f"({100 * step.travel / self._length:.0f} %), {step.iterations} iterations, {rate:.1f} steps/s, "
                f"about {left:.0f} s left"
            )
