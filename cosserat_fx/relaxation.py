r"""Where Newton's method finds no equilibrium: the motion of a damped body towards one.

A body whose equilibrium has become unstable, or has none near by because the path of equilibria turns back, moves until
it finds another. With a resistance to motion in proportion to the stiffness *K* of the law's linear part, the motion of
the unknown *u* under the out-of-balance forces *R* is

.. math::

    K \dot u = -R(u),

which is followed by linearly implicit steps of 1/mu in time, :math:`(R'(u) + \mu K)\,\Delta u = -R(u)`. A large mu
makes a short step against the linear stiffness, which the law never exceeds by much; with mu = 0 the step is Newton's.
Nothing of the motion is kept: at each of its points the law is integrated from the committed state over the whole
increment, and where it ends is an equilibrium like any other.

This is pseudo-transient continuation (Kelley and Keyes, SIAM J. Numer. Anal. 35 (1998) 508-523).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from cosserat_fx.newton import NewtonSolver, Solution
from cosserat_fx.problem import Problem
from cosserat_fx.state import QuadratureState

_STEPS = 300
_ROUGHNESS = 30.0
"""By which the local tolerance is raised on the way, which is no answer."""
_AIM, _FALL, _NOTHING = 1e-5, 1e-4, 2e-9
"""Out-of-balance forces from where Newton's method is tried: relative to the internal ones and to those at the start,
and what is too small for either."""
_CLOSER = 0.01
"""Factor of the aim where Newton's method was tried too early."""
_LARGEST_RISE = 3.0
"""Factor of the out-of-balance forces over a step of the motion beyond which it is taken again, shorter."""
_SHORTER, _LONGER, _MUCH_LONGER = 4.0, 0.5, 0.1
_LARGEST_DAMPING = 1e4


def relax(problem: Problem, solver: NewtonSolver, largest_strain: float) -> Solution | None:
    """Let the body move from its linear answer to the loads until it is in equilibrium.

    Args:
        problem: holds the loads and prescribed values of the end of the step; its trial fields are dropped.
        solver: of the problem.
        largest_strain: increment of any point in the linear answer beyond which this is not tried.

    Returns:
        The equilibrium, which the problem then holds; None where the motion does not come to rest.
    """
    problem.roll_back()
    if not solver.predict() or problem.largest_strain() > largest_strain:
        return None
    motion = _Motion(problem, solver)
    smallest, in_vain = _NOTHING * motion.scale, 0
    aim = max(min(_AIM * motion.scale, _FALL * motion.forces), smallest)
    while motion.comes_to(aim):
        resting = problem.unknown.x.array.copy()
        solution = solver.solve()
        if solution.converged:
            return solution.after(motion.steps + in_vain)
        if aim == smallest:
            return None
        in_vain += solution.iterations
        problem.unknown.x.array[:] = resting
        motion.look_again()
        aim = max(_CLOSER * aim, smallest)
    return None


class _Motion:
    """The motion, from the unknown at hand on.

    Attributes:
        scale: norm of the internal forces at the start.
        forces: norm of the out-of-balance forces where the body is.
        steps: linear systems solved so far.
    """

    def __init__(self, problem: Problem, solver: NewtonSolver) -> None:
        """Start from the linear answer, which was just found.

        Args:
            problem: its matrix is the stiffness of the law's linear part.
            solver: of the problem.
        """
        self._problem, self._solver = problem, solver
        self._stiffness = problem.matrix.copy()
        self._move = problem.unknown.copy()
        self._damping = 1.0
        self.scale, self.steps = problem.force_scale(), 0
        self.look_again()

    def look_again(self) -> None:
        """Evaluate the out-of-balance forces where the body is."""
        with _roughly(self._problem.state):
            self.forces = self._solver.out_of_balance()

    def comes_to(self, aim: float) -> bool:
        """Go on until the out-of-balance forces are small; False where they do not become so."""
        with _roughly(self._problem.state):
            while self.forces > aim:
                if self.steps == _STEPS or self._damping > _LARGEST_DAMPING or not self.forces < float("inf"):
                    return False
                self._step()
        return True

    def _step(self) -> None:
        """One step, as long as the forces fall, and short enough to see what is unstable."""
        problem, solver, unknown = self._problem, self._solver, self._problem.unknown.x.array
        self.steps += 1
        if not solver.factorise(self._stiffness, self._damping):
            self._damping *= _SHORTER
            return
        self._move.x.array[: problem.vector.getLocalSize()] = problem.vector.array_r
        solver.apply_inverse(self._move)
        before = unknown.copy()
        unknown -= self._move.x.array
        moved = solver.out_of_balance()
        if moved > _LARGEST_RISE * self.forces:
            unknown[:] = before
            solver.out_of_balance()
            self._damping *= _SHORTER
            return
        if moved < self.forces:
            self._damping *= min(max(moved / self.forces, _MUCH_LONGER), _LONGER)
        self.forces = moved


@contextmanager
def _roughly(state: QuadratureState) -> Iterator[None]:
    """Integrate the law with less care."""
    tolerance = state.tolerance
    state.tolerance = _ROUGHNESS * tolerance
    try:
        yield
    finally:
        state.tolerance = tolerance
