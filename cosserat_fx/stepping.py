"""Load steps: predict, solve, accept or cut back, commit or roll back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from cosserat_fx import branching
from cosserat_fx._compat import MPI
from cosserat_fx.newton import NewtonSolver, Solution
from cosserat_fx.problem import Problem
from cosserat_fx.relaxation import relax
from cosserat_fx.typing import Array


@dataclass(frozen=True)
class StepControl:
    """Bounds and aims of the step size, all in metres of travel where not said otherwise.

    Attributes:
        first: the first step, and the one after every corner of the path.
        largest: no step is larger.
        smallest: a step that fails at this size ends the run; 0 stands for a ten-thousandth of the first step or of the
            stiff travel, whichever is less.
        stiff: the travel in which the body's stiff response shows; 0 stands for the first step.
        halvings: how often a step that ends on an unstable branch is halved before it is pushed off the branch.
        branch: "stable" leaves unstable branches of equilibria, "primary" goes on along them.
        tolerance: aimed change of the strain rate over a step, relative to the strain rate.
        strain: aimed largest strain increment of any point.
        growth: largest factor from one step to the next.
        max_steps: accepted steps after which the run ends.
        max_jumps: steps with a jump to another equilibrium that it may have: a body that jumps again and again moves by
            stick and slip, and of its slips only the ends are equilibria.
    """

    first: float
    largest: float = float("inf")
    smallest: float = 0.0
    stiff: float = 0.0
    halvings: int = 3
    branch: Literal["stable", "primary"] = "stable"
    tolerance: float = 0.12
    strain: float = 0.4
    growth: float = 1.5
    max_steps: int = 100_000
    max_jumps: int = 150

    def __post_init__(self) -> None:
        """Fill in the stiff travel and the smallest step."""
        object.__setattr__(self, "stiff", self.stiff or self.first)
        object.__setattr__(self, "smallest", self.smallest or 1e-4 * min(self.first, self.stiff))


@dataclass(frozen=True)
class Step:
    """An accepted step.

    Attributes:
        number: counts from 1.
        travel: at its end (m).
        size: of the step (m).
        iterations: Newton iterations, those of failed attempts included.
        cutbacks: failed attempts before it.
        passages: 1 where a branch became unstable in this step, which was pushed off it unless asked to stay.
        rate_error: by how much the strain rate at its end differs from the mean one, with which the step is integrated,
            relative to the latter: half the change from step to step, and 1/2 where there is no step before it.
        jumps: 1 where there was no equilibrium near by, and the body was let move to another; else 0.
    """

    number: int
    travel: float
    size: float
    iterations: int
    cutbacks: int
    passages: int = 0
    rate_error: float = 0.5
    jumps: int = 0


class Position(NamedTuple):
    """Where a walk stands between two steps.

    Attributes:
        travel: along the path (m).
        size: of the step to make next (m), stops permitting.
        number: of the steps made.
        stable: whether the equilibrium is a stable one, as far as the solver can tell.
        jumps: steps so far in which the body was let move to another equilibrium.
    """

    travel: float
    size: float
    number: int = 0
    stable: bool = True
    jumps: int = 0


class Increment(NamedTuple):
    """The increment of an accepted step.

    Attributes:
        size: of the step (m).
        unknown: change of this rank's unknowns, ghosts included (m or rad).
        strains: at this rank's own quadrature points, as :meth:`~cosserat_fx.problem.Problem.strain_increments` says.
    """

    size: float
    unknown: Array
    strains: Array


class SteppingError(RuntimeError):
    """The walk cannot go on; the message gives cause and place."""


class Stepper:
    """Walks a problem along its path.

    The step size follows an estimate of the temporal error: strains are integrated as if they grew in proportion within
    a step, so what matters is how much their rate changes from one step to the next,

        r = |d_eps - (h/h_old) d_eps_old| / |d_eps|     (root mean square over the quadrature points),

    which is proportional to the step size. Newton iterations have the second say.

    Attributes:
        position: where the walk stands.
        last: its last increment, which the next step follows; None where there is none to follow. Both may be set to go
            on from where another walk stood, with the problem's fields and state.
    """

    HARD_ITERATIONS = 8
    MOTION = 0.6
    """Part of the last step over which the body is let move to another equilibrium."""
    TRIALS = 2
    """Attempts at a first step before it is cut to the stiff travel."""
    MANY_SUBSTEPS = 30
    """Mean number of local substeps in the linear answer to a first step of the user's beyond which it is cut."""
    LARGEST_STRAIN = 1.0
    """Increment of a point in the linear answer to a step beyond which the step is not attempted."""
    NO_STRAIN = 1e-10
    """A body that moves as a whole strains by rounding, which says nothing about the next step."""

    def __init__(
        self,
        problem: Problem,
        solver: NewtonSolver,
        corners: Sequence[float],
        stations: Sequence[float],
        control: StepControl,
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
        self.position = Position(self._corners[0], control.first)
        self.last: Increment | None = None
        self._unstable_ends = 0
        self._jumped = False
        self._rate_error = Step.rate_error

    def __iter__(self) -> Iterator[Step]:
        """Make the steps that are left one by one; each is committed when it is handed out.

        Raises:
            SteppingError: the smallest step failed, or there were as many steps as allowed.
        """
        for stop in self._stops:
            while self.position.travel < stop:
                yield self._advance(stop)

    def _advance(self, stop: float) -> Step:
        """Make one step towards a stop, as large as it goes; where that fails, all is as it was before."""
        last = self.last
        try:
            return self._step_towards(stop)
        except BaseException:
            self.last = last
            self.problem.roll_back()
            raise

    def _step_towards(self, stop: float) -> Step:
        travel, size, number, _, jumps = self.position
        if number == self.control.max_steps:
            raise SteppingError(f"the run reached its limit of {number} steps at a travel of {travel:.9g} m")
        if jumps > self.control.max_jumps:
            raise SteppingError(
                f"the body moves by stick and slip: up to a travel of {travel:.9g} m it has jumped to another "
                f"equilibrium more often than stepping.max_jumps = {self.control.max_jumps}, {self._most_strained()}"
            )
        size = min(size, self.control.largest)
        step, wish = self._step_from(travel, stop, size), size
        iterations = cutbacks = 0
        self._unstable_ends = 0
        while not (solution := self._solve(travel, step)).converged:
            if solution.hopeless:
                raise SteppingError(f"the step from {travel:.9g} m failed: {solution.reason}")
            if step <= self.control.smallest:
                told, why = solution.reason, self.solver.explanation()
                raise SteppingError(
                    f"the step from {travel:.9g} m failed at the smallest size, {step:.3g} m: "
                    + (why if why.startswith(told) else f"{told}; {why}")
                )
            self.problem.roll_back()
            iterations += solution.iterations
            cutbacks += 1
            step = wish = self._cut(step, cutbacks)
        suggestion = self._remember(step)
        travel = stop if travel + step >= stop - 1e-12 * abs(stop) else travel + step
        self.problem.commit()
        size = self._resize(wish, step, solution.iterations, cutbacks, suggestion)
        if travel in self._corners:
            self.last, size = None, self.control.first
        self.position = Position(travel, size, number + 1, solution.stable, jumps + self._jumped)
        iterations += solution.iterations
        passages = int(self._unstable_ends > 0)
        return Step(number + 1, travel, step, iterations, cutbacks, passages, self._rate_error, int(self._jumped))

    def _step_from(self, travel: float, stop: float, size: float) -> float:
        """The step to make: exactly to the stop where it is near, and never leaving a crumb before it."""
        left = stop - travel
        if left <= size * (1 + 1e-9):
            return left
        return left / 2 if left < 2 * size else size

    def _cut(self, step: float, cutbacks: int) -> float:
        """The step to try after one that failed; a first step that was far too long is not cut little by little."""
        shorter = step / 2
        if self.last is None and cutbacks >= self.TRIALS:
            shorter = min(shorter, self.control.stiff)
        return max(shorter, self.control.smallest)

    def _solve(self, travel: float, step: float) -> Solution:
        """One attempt at a step; an unstable equilibrium is no solution unless the primary branch is asked for."""
        solution = self._attempt(travel, step)
        if not solution.converged:
            return solution
        if self.control.branch == "primary":
            self._unstable_ends = int(self.position.stable and not solution.stable)
            return solution
        if solution.stable:
            return solution
        self._unstable_ends += 1
        if self._unstable_ends <= self.control.halvings and step > self.control.smallest:
            return replace(solution, converged=False, reason="the branch of equilibria has become unstable")
        self.last = None  # the jump to another branch says nothing about the next step
        reason = "the branch of equilibria has become unstable, and no stable one was found beside it"
        left = branching.leave(self.problem, self.solver, step)
        return left.after(solution.iterations) if left else replace(solution, converged=False, reason=reason)

    def _attempt(self, travel: float, step: float) -> Solution:
        """Predict and solve one step; where going on as before leads nowhere, start from the law's linear part.

        The law answers to the direction of the strain rate, however small the step: a part of the body that begins to
        unload needs another start, not a smaller step. And where there is no equilibrium near by, as where a band
        releases more than the walls take up, the body is let move to one.
        """
        problem = self.problem
        problem.apply(travel + step)
        self._jumped, iterations = False, 0
        if self.last is not None:
            problem.unknown.x.array[:] += step / self.last.size * self.last.unknown
            problem.impose()
            solution = self.solver.solve()
            if solution.converged:
                return solution
            iterations = solution.iterations
            problem.roll_back()
            if solution.hopeless:
                return solution
            if step <= self._longest_motion() and (moved := self._move()):
                return moved.after(iterations)
            problem.roll_back()
        if not self.solver.predict():
            return self.solver.failed_prediction().after(iterations)
        if problem.largest_strain() > self.LARGEST_STRAIN and step > self.control.smallest:
            return Solution(
                False, iterations, f"a point would be strained by more than {self.LARGEST_STRAIN:g}", np.inf
            )
        if self.last is None and step > 2 * self.control.stiff and self._substeps() > self.MANY_SUBSTEPS:
            reason = f"its points would need more than {self.MANY_SUBSTEPS} local substeps each"
            return Solution(False, iterations, reason, np.inf)
        solution = self.solver.solve().after(iterations)
        if solution.converged or solution.hopeless or self.last is not None or step > self._longest_motion():
            return solution
        moved = self._move()
        return moved.after(solution.iterations) if moved else solution

    def _substeps(self) -> float:
        """Mean number of local substeps that the points ask for in the linear answer to a step."""
        state, comm = self.problem.state, self.problem.comm
        state.restart_substeps()
        if not np.isfinite(self.solver.out_of_balance()):
            return np.inf
        own = state.substeps[state.points]
        return float(comm.allreduce(own.sum()) / comm.allreduce(len(own)))

    def _move(self) -> Solution | None:
        """Let the body move to an equilibrium; None where it finds none."""
        moved = relax(self.problem, self.solver, self.control.strain)
        self._jumped = moved is not None
        return moved

    def _most_strained(self) -> str:
        """Where the last step has strained the body most, in words."""
        state = self.problem.state
        last = self.last.strains if self.last else np.zeros((len(state.points), 1))
        sizes = np.linalg.norm(last, axis=1)
        row = int(sizes.argmax()) if len(sizes) else -1
        own = (float(sizes[row]), tuple(state.coordinates[row].tolist())) if row >= 0 else (-1.0, ())
        _, place = max(self.problem.comm.allgather(own))
        return f"in the last step mostly at {', '.join(f'{x:.6g}' for x in place)} m"

    def _longest_motion(self) -> float:
        """Longest step over which the body is let move to an equilibrium; a longer one is cut first."""
        followed = self.last.size * self.MOTION if self.last is not None else 0.0
        return max(followed, self.control.stiff)

    def _remember(self, step: float) -> float:
        """Keep the increment just found for the next prediction; return the step size that its strains suggest."""
        problem, control, last = self.problem, self.control, self.last
        strains = problem.strain_increments()
        self.last = Increment(step, problem.unknown.x.array - problem.committed.x.array, strains)
        largest = problem.comm.allreduce(np.max(np.linalg.norm(strains, axis=1), initial=0.0), op=MPI.MAX)
        self._rate_error = Step.rate_error
        if largest < self.NO_STRAIN:
            return np.inf
        size = step * control.strain / largest
        if last is not None:
            change = problem.comm.allreduce(np.sum((strains - step / last.size * last.strains) ** 2))
            total = problem.comm.allreduce(np.sum(strains**2))
            self._rate_error = float(np.sqrt(change / total)) * step / (step + last.size)
            size = min(size, step * control.tolerance * np.sqrt(total / change) if change else np.inf)
        return float(size)

    def _resize(self, wish: float, step: float, iterations: int, cutbacks: int, suggestion: float) -> float:
        """The size to wish for next.

        Args:
            wish: the size wished for before; the step made may have been shorter, to hit a stop.
            step: the step made (m).
            iterations: Newton iterations of the successful attempt.
            cutbacks: failed attempts before it.
            suggestion: the step size that the strains suggest (m).
        """
        control = self.control
        if cutbacks:
            return step
        growth = control.growth if iterations <= self.HARD_ITERATIONS else 0.7
        size = float(np.clip(suggestion, step / 2, growth * max(wish, step)))
        return min(max(size, control.smallest), control.largest)
