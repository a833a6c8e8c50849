"""Leaving an unstable branch of equilibria, along the critical mode, for a stable one.

Where an equilibrium path bifurcates, Newton's method may go on along a branch that a real body leaves. An odd number of
negative eigenvalues of the tangent shows in the sign of its determinant, which comes with the factorisation; an even
number does not, and neither does a branch that has been left behind for good.
"""

from __future__ import annotations

import numpy as np

from cosserat_fx._compat import MPI
from cosserat_fx.newton import NewtonSolver, Solution
from cosserat_fx.problem import Problem
from cosserat_fx.typing import Array

_INVERSE_ITERATIONS = 6
_PUSHES = 12
_FIRST_PUSH = 0.1


def leave(problem: Problem, solver: NewtonSolver, step: float) -> Solution | None:
    """Push the equilibrium at hand along its critical mode until Newton's method ends on a stable branch.

    Args:
        problem: its unknown is an equilibrium at which the tangent's determinant is negative.
        solver: holds the factors of a tangent next to it.
        step: just made (m of travel); the pushes are measured by it, and each is twice as long as the one before.

    Returns:
        The stable equilibrium, which the problem then holds; None where no push led to one.
    """
    start = problem.unknown.x.array.copy()
    mode = _critical_mode(problem, solver)
    if mode is None:
        return None
    iterations = 0
    for push in range(_PUSHES):
        for side in (1.0, -1.0):
            problem.state.roll_back()
            problem.unknown.x.array[:] = start + side * _FIRST_PUSH * 2**push * step * mode
            problem.impose()
            solution = solver.solve()
            iterations += solution.iterations
            if solution.converged and solution.stable:
                return solution.after(iterations - solution.iterations)
    return None


def _critical_mode(problem: Problem, solver: NewtonSolver) -> Array | None:
    """The mode that the tangent resists least, by inverse iteration with the factors at hand.

    Returns:
        Change of this rank's unknowns with a largest displacement of 1 m, or None where the solver gave up.
    """
    mode = problem.unknown.copy()
    mode.x.array[:] = 0.0
    for number, part in enumerate(problem.fields.values()):
        # Any start will do that is the same on every number of ranks and has no symmetry of a body.
        phase = part.coordinates @ np.array([1.0, np.sqrt(2.0)])[: part.coordinates.shape[1]]
        mode.x.array[part.dofs] = np.cos(phase / problem.material.d50 + number)
    mode.x.array[problem.prescribed.dofs] = 0.0
    for _ in range(_INVERSE_ITERATIONS):
        if not solver.apply_inverse(mode):
            return None
        largest = max(
            float(np.abs(mode.x.array[part.dofs]).max(initial=0.0))
            for name, part in problem.fields.items()
            if name != "w"
        )
        mode.x.array[:] /= problem.comm.allreduce(largest, op=MPI.MAX)
    found: Array = mode.x.array
    return found
