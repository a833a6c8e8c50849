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
from typing import NamedTuple

from cosserat_fx.newton import NewtonSolver, Solution
from cosserat_fx.problem import Problem
from cosserat_fx.state import QuadratureState

_STEPS = 100
_ROUGHNESS = 30.0
"""By which the local tolerance is raised on the way, which is no answer."""
_AIM, _FALL, _NOTHING = 1e-5, 1e-4, 2e-9
"""Out-of-balance forces from where Newton's method goes on: relative to the internal ones and to those at the start,
and what is too small for either."""
_LARGEST_RISE = 3.0
"""Factor of the out-of-balance forces over a step of the motion beyond which it is taken again, shorter."""
_SHORTER, _LONGER, _MUCH_LONGER = 4.0, 0.5, 0.1
_LARGEST_DAMPING = 1e4


class _Way(NamedTuple):
    """How a motion went: whether it came to rest, and after how many solutions of linear systems."""

    rests: bool
    iterations: int


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
    with _roughly(problem.state):
        way = _move(problem, solver, largest_strain)
    return solver.solve().after(way.iterations) if way.rests else None


def _move(problem: Problem, solver: NewtonSolver, largest_strain: float) -> _Way:
    """Follow the motion; the steps are as long as the forces fall, and short enough to see what is unstable."""
    if not solver.predict() or problem.largest_strain() > largest_strain:
        return _Way(False, 1)
    stiffness = problem.matrix.copy()
    scale, forces = problem.force_scale(), solver.out_of_balance()
    unknown, move = problem.unknown.x.array, problem.unknown.copy()
    aim, damping = max(min(_AIM * scale, _FALL * forces), _NOTHING * scale), 1.0
    step = 0
    while forces > aim and step < _STEPS and damping < _LARGEST_DAMPING:
        step += 1
        if not solver.factorise(stiffness, damping):
            damping *= _SHORTER
            continue
        move.x.array[: problem.vector.getLocalSize()] = problem.vector.array_r
        solver.apply_inverse(move)
        before = unknown.copy()
        unknown -= move.x.array
        moved = solver.out_of_balance()
        if moved > _LARGEST_RISE * forces:
            unknown[:] = before
            solver.out_of_balance()
            damping *= _SHORTER
            continue
        if moved < forces:
            damping *= min(max(moved / forces, _MUCH_LONGER), _LONGER)
        forces = moved
    stiffness.destroy()
    return _Way(forces <= aim, step)


@contextmanager
def _roughly(state: QuadratureState) -> Iterator[None]:
    """Integrate the law with less care."""
    tolerance = state.tolerance
    state.tolerance = _ROUGHNESS * tolerance
    try:
        yield
    finally:
        state.tolerance = tolerance
