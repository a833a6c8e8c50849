"""Load steps: predict, solve, accept or cut back, commit or roll back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cosserat_fx.newton import NewtonSolver
from cosserat_fx.problem import Problem


@dataclass(frozen=True)
class StepControl:
    """Bounds and aims of the step size, all in metres of travel where not said otherwise.

    Attributes:
        first: the first step, and the one after every corner of the path.
        largest: no step is larger.
        smallest: a step that fails at this size ends the run.
        max_steps: accepted steps after which the run ends.
    """

    first: float
    largest: float
    smallest: float
    max_steps: int = 100_000


@dataclass(frozen=True)
class Step:
    """An accepted step.

    Attributes:
        number: counts from 1.
        travel: at its end (m).
        size: of the step (m).
        iterations: Newton iterations, those of failed attempts included.
        cutbacks: failed attempts before it.
    """

    number: int
    travel: float
    size: float
    iterations: int
    cutbacks: int


class StepFailure(RuntimeError):
    """A step could not be made at the smallest size; the message gives cause and place."""


class Stepper:
    """Walks a problem along its path."""

    GROWTH = 1.5
    EASY_ITERATIONS = 5
    HARD_ITERATIONS = 9

    def __init__(
        self, problem: Problem, solver: NewtonSolver, corners: Sequence[float], stations: Sequence[float], control: StepControl
    ) -> None:
        """Prepare the walk.

        Args:
            problem: what to solve; its conditions are functions of the travel.
            solver: how.
            corners: travel at the start and wherever the direction of loading changes, ascending (m).
            stations: further travels to be hit exactly (m).
            control: step sizes.
        """
        self.problem, self.solver, self.control = problem, solver, control
        self._corners = list(corners)
        self._stops = sorted({*corners[1:], *(s for s in stations if s > corners[0])})

    def __iter__(self) -> Iterator[Step]:
        """Make the steps one by one; each is committed when it is handed out.

        Raises:
            StepFailure: the smallest step failed.
        """
        travel, size = self._corners[0], self.control.first
        increment, made = None, 0.0
        number = 0
        for stop in self._stops:
            while travel < stop:
                target, wish = self._next(travel, stop, size)
                iterations = cutbacks = 0
                while True:
                    step = target - travel
                    solution = self._attempt(target, increment, step / made if made else 0.0)
                    iterations += solution.iterations
                    if solution.converged:
                        break
                    self.problem.roll_back()
                    if step <= self.control.smallest:
                        raise StepFailure(
                            f"the step from {travel:.9g} m failed at the smallest size, {step:.3g} m: {solution.reason}"
                        )
                    cutbacks += 1
                    wish = max(step / 2, self.control.smallest)
                    target = travel + wish
                increment = self.problem.unknown.x.array - self.problem.committed.x.array
                made, travel = step, target
                self.problem.commit()
                number += 1
                yield Step(number, travel, step, iterations, cutbacks)
                size = self._resize(wish, step, solution.iterations, cutbacks)
                if travel in self._corners:
                    increment, made, size = None, 0.0, self.control.first

    def _next(self, travel: float, stop: float, size: float) -> tuple[float, float]:
        """Where to step: at most to the stop, and not so close to it that a crumb is left over."""
        left = stop - travel
        count = int(np.ceil(left / size * (1 - 1e-9)))
        if count == 1:
            return stop, size
        return (travel + left / 2 if count == 2 else travel + size), size

    def _attempt(self, target, increment, ratio):
        """Predict and solve one step."""
        problem = self.problem
        problem.apply(target)
        if increment is not None:
            problem.unknown.x.array[:] = problem.committed.x.array + ratio * increment
            problem.impose()
        else:
            self.solver.predict()
        return self.solver.solve()

    def _resize(self, wish: float, step: float, iterations: int, cutbacks: int) -> float:
        """The size to wish for next."""
        if cutbacks or iterations > self.HARD_ITERATIONS:
            return step
        growth = self.GROWTH if iterations <= self.EASY_ITERATIONS else 1.0
        return min(self.control.largest, max(wish, step) * growth)
