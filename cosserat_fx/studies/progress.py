"""How far a study has come, and how long it is going to take."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from time import monotonic
from typing import NamedTuple

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from cosserat_fx.progress import Bar
from cosserat_fx.studies.choice import Choice
from cosserat_fx.studies.plan import weight
from cosserat_fx.studies.runs import LONG, Record
from cosserat_fx.timing import duration

PATIENCE, LEAST_PATIENCE = 20.0, 300.0
"""A run is stopped after so many times what was expected of it, and not before so many seconds."""


class Task(NamedTuple):
    """One process to start.

    Attributes:
        choice: what it runs.
        repeat: how often it has then been run to be timed; 0 for a run that is not.
    """

    choice: Choice
    repeat: int


class Forecast:
    """Seconds that runs are going to take, from those that were made."""

    def __init__(self, start: Choice, record: Record, dimension: int) -> None:
        """Begin with the scene as it is.

        Args:
            start: its choice.
            record: of its run, which was timed.
            dimension: in how many directions cells are refined.
        """
        loop, process = record.loop, record.process
        assert loop is not None
        assert process is not None
        self._start, self._dimension = start, dimension
        self._loop = self._expected = self._took = loop
        self._outside = [process - loop]
        self._known: dict[Choice, float] = {}

    def seconds(self, choice: Choice) -> float:
        """What one process is expected to take (s)."""
        if choice in self._known:
            return self._known[choice]
        raw = self._loop * weight(choice, self._start, self._dimension)
        return median(self._outside) + raw * self._took / self._expected

    def of(self, task: Task) -> float:
        """What a task is expected to take (s); long runs are not repeated."""
        once = self.seconds(task.choice)
        return 0.0 if task.repeat > 1 and once > LONG else once

    def learn(self, task: Task, record: Record) -> None:
        """Compare what a run took with what was expected of it; what failed is not repeated."""
        if not record.done or record.process is None or record.loop is None:
            self._known[task.choice] = 0.0
            return
        if task.choice not in self._known:
            self._expected += self._loop * weight(task.choice, self._start, self._dimension)
            self._took += record.loop
            self._outside.append(record.process - record.loop)
        self._known[task.choice] = record.process

    def patience(self, choice: Choice) -> float:
        """After how many seconds to stop a run."""
        return max(LEAST_PATIENCE, PATIENCE * self.seconds(choice))


class StudyProgress(Bar):
    """Reports the runs of a study: a live bar on a terminal, plain lines in a log; a context manager."""

    def __init__(self, console: Console) -> None:
        """Prepare.

        Args:
            console: where to.
        """
        self._console = console
        self._left: list[Task] = []
        self._forecast: Forecast | None = None
        self._number = self._total = 0
        self._begun = monotonic()
        self._bar = Progress(
            TextColumn("{task.completed:.0f} of {task.total:.0f} runs"),
            BarColumn(bar_width=None),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("", total=1, left="")

    def plan(self, left: Sequence[Task], forecast: Forecast) -> None:
        """Tell what is left to do after the first run.

        Args:
            left: in the order in which it is done.
            forecast: of its seconds.
        """
        self._left, self._forecast = list(left), forecast
        self._total = self._number + len(left)
        self._bar.update(self._task, total=self._total)
        if not self._console.is_terminal:
            self._console.print(f"{len(left)} runs to make{self._remaining()}", highlight=False)

    def begin(self, words: str) -> None:
        """Tell what is being run."""
        self._begun = monotonic()
        self._bar.update(self._task, description=words, left=self._remaining().removeprefix(", "))

    def end(self, words: str, record: Record, *, made: bool) -> None:
        """Tell how a run ended.

        Args:
            words: what was run.
            record: of it.
            made: whether there is anything to tell, as it was not known before.
        """
        self._number, self._left = self._number + 1, self._left[1:]
        self._bar.update(self._task, completed=self._number, left=self._remaining().removeprefix(", "))
        took = f"{monotonic() - self._begun:.1f} s"
        line = f"run {self._number} of {self._total or '?'}, {words}: {took}"
        if not made:
            return
        if not record.done:
            self._console.print(f"{line}, {record.status}: {record.reason}", highlight=False, markup=False)
        elif not self._console.is_terminal:
            self._console.print(f"{line}{self._remaining()}", highlight=False, markup=False)

    def _remaining(self) -> str:
        """The time that is left, in words."""
        if self._forecast is None:
            return ""
        seconds = sum(self._forecast.of(task) for task in self._left)
        return f", about {duration(seconds)} left"
