"""Equilibrium of one step by PETSc's SNES: Newton's method with a backtracking line search.

Two things are special to this problem. The number of local substeps of each point may grow during the first
iterations and is frozen after them, or the residual would jump; a converged solution is checked with it set free once
more. And a state that the law cannot reach gives an infinite residual, from which the line search backs off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakMethod

import numpy as np

from cosserat_fx._compat import MPI, PETSc, dolfinx
from cosserat_fx.diagnosis import failure_with_state, imbalance
from cosserat_fx.linear_solver import LinearSolver, PetscOption, choose
from cosserat_fx.linear_system import LinearSystem
from cosserat_fx.problem import Failure, Problem

_DEFAULTS: dict[str, PetscOption] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "snes_linesearch_max_it": 10,
}
_ADAPTING_ITERATIONS = 2
_RECHECKS = 3
_PATIENCE, _PATIENCE_AT_THE_END = 8, 2
"""Iterations over which the out-of-balance forces are to fall to a half, or Newton's method goes nowhere: on the way,
and where they are so small that rounding may be all there is to them."""
_ROUNDING = 1e-6
"""Out-of-balance forces, relative to the internal ones, beyond which rounding is not suspected."""
_PREFIX = "cosserat_"
_set_here: set[str] = set()

_REASONS = {
    value: name.lower().replace("_", " ")
    for name, value in vars(PETSc.SNES.ConvergedReason).items()
    if isinstance(value, int) and value < 0
}

_WORDS = {
    "diverged max it": "there was no equilibrium within the allowed number of Newton iterations",
    "diverged dtol": "Newton's method came no closer to an equilibrium",
    "diverged line search": "no part of a Newton step came closer to an equilibrium",
    "diverged fnorm nan": "the out-of-balance forces are not finite",
}


@dataclass(frozen=True)
class Solution:
    """How the iteration of one step ended.

    Attributes:
        converged: whether the step is in equilibrium.
        iterations: Newton iterations.
        reason: why not, where it is not.
        residual: norm of the out-of-balance forces relative to that of the internal forces.
        hopeless: whether a shorter step would end in the same way.
        stable: False where the tangent's determinant is negative, as it is with an odd number of negative eigenvalues.
    """

    converged: bool
    iterations: int
    reason: str
    residual: float
    stable: bool = True
    hopeless: bool = False

    def after(self, iterations: int) -> Solution:
        """The same, with the iterations of earlier attempts counted in."""
        return replace(self, iterations=self.iterations + iterations)


class NewtonSolver:
    """SNES on a :class:`~cosserat_fx.problem.Problem`.

    Attributes:
        snes: the PETSc object, for users who want to set more than options reach. Options have the prefix
            ``cosserat_`` in PETSc's database, where they override the defaults.
        linear: the linear systems, and what solves them.
        before_evaluation: called before every evaluation of the law, on every rank; what it raises ends the solution.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        tolerance: float = 1e-9,
        max_iterations: int = 25,
        options: Mapping[str, PetscOption] | None = None,
        linear: LinearSolver | None = None,
    ) -> None:
        """Create the solver.

        Args:
            problem: what to solve.
            tolerance: of the out-of-balance forces, relative to the internal forces.
            max_iterations: Newton iterations of one step.
            options: PETSc options without prefix, such as ``{"snes_monitor": ""}``.
            linear: the linear solver, by default as the problem's size suggests.
        """
        self._problem = problem
        self._tolerance = tolerance
        self._failure: Failure | None = None
        self._frozen = False
        self._norms: list[float] = []
        self._rounding = 0.0
        self.before_evaluation: Callable[[], None] = lambda: None
        self._evaluated = problem.vector.duplicate()
        self._x = problem.vector.duplicate()

        chosen = linear or choose("auto", problem.geometry.dimension, problem.sizes["unknowns"], options=options)
        asked = chosen.petsc_options(polar=problem.numerics.polar), dict(options or {})
        _set_options(*asked)
        self.snes = PETSc.SNES().create(problem.comm)
        self.snes.setOptionsPrefix(_PREFIX)
        self.snes.setFunction(_weakly(self._residual), problem.vector)
        self.snes.setJacobian(_weakly(self._jacobian), problem.matrix)
        self.snes.setTolerances(rtol=0.0, stol=0.0, max_it=max_iterations)
        self.snes.setConvergenceTest(_weakly(self._test_convergence))
        self.snes.setFromOptions()
        self.linear = LinearSystem(self.snes, problem, chosen, lambda: _restore_options(*asked))

    def solve(self) -> Solution:
        """Find equilibrium from the problem's unknown, which holds the prescribed values already."""
        problem = self._problem
        problem.state.restart_substeps()
        scale = problem.force_scale()
        self.snes.setTolerances(atol=self._tolerance * scale)
        self._rounding = _ROUNDING * scale
        self._x.array_w[:] = problem.unknown.x.array[: self._x.getLocalSize()]
        self._frozen, iterations = False, 0
        self.linear.begin()
        for _ in range(_RECHECKS):
            self._failure = None
            iterations += self._iterate()
            if (
                self.snes.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE
                and self.linear.fall_back()
            ):
                iterations += self._iterate()
            residual = self.snes.getFunctionNorm() / scale
            reason = self.snes.getConvergedReason()
            if reason < 0 and not self._is_rounding():
                problem.set_unknown(self._x)
                return self._failed(reason, iterations, residual)
            before = problem.state.substeps.copy()
            problem.set_unknown(self._x)
            if failure := problem.update(adapt=True):
                return Solution(False, iterations, str(failure), residual)
            if not problem.comm.allreduce(bool(np.any(before != problem.state.substeps)), op=MPI.LOR):
                return Solution(True, iterations, "converged", residual, stable=self._is_stable(iterations))
            self._frozen = True
        return Solution(False, iterations, "the number of local substeps did not settle", residual)

    def _iterate(self) -> int:
        """Iterate from the vector of unknowns on; the number of iterations."""
        with self._problem.stopwatch("Newton"):
            try:
                self.snes.solve(None, self._x)
            except PETSc.Error as error:
                raise error.__cause__ or error from None  # what a callback raised comes wrapped by PETSc
        return int(self.snes.getIterationNumber())

    def predict(self) -> bool:
        """Take a linear step to the prescribed values with the tangent at the unknown at hand.

        From the committed fields this is the answer of the law's linear part, a first guess where there is no
        previous increment to follow.

        Returns:
            Whether the linear system could be solved.
        """
        problem = self._problem
        self.linear.begin()
        problem.state.restart_substeps()
        self._failure = problem.update(adapt=True)
        if self._failure:
            return False
        b = problem.vector
        problem.assemble_prediction(b)
        self.linear.assemble()
        self.linear.take()
        with problem.stopwatch("linear solve"):
            solved = self.linear.solve(b, self._x)
        if not solved:
            return False
        problem.unknown.x.array[: self._x.getLocalSize()] += self._x.array_r
        problem.unknown.x.scatter_forward()
        problem.impose()
        return True

    def failed_prediction(self) -> Solution:
        """Why the last prediction failed: the law at the start of the step, or the linear solver."""
        if self._failure:
            return Solution(False, 0, f"the law failed at the start of the step: {self._failure}", np.inf)
        told, lasting = self.linear.failure()
        return Solution(False, 0, told, np.inf, hopeless=lasting)

    def apply_inverse(self, field: dolfinx.fem.Function) -> bool:
        """Replace a field by the solution with it as right-hand side, with the tangent factorised last.

        Returns:
            Whether the linear system could be solved.
        """
        b = self._problem.vector
        b.array_w[:] = field.x.array[: b.getLocalSize()]
        solved = self.linear.solve(b, self._x)
        field.x.array[: b.getLocalSize()] = self._x.array_r
        field.x.scatter_forward()
        return solved

    def out_of_balance(self) -> float:
        """Update the trial state at the unknown at hand; assemble the out-of-balance forces into the problem's vector.

        Returns:
            Their norm; infinite where the law cannot reach the state.
        """
        self.before_evaluation()
        self._failure = self._problem.update(adapt=True)
        if self._failure:
            return np.inf
        self._problem.assemble_residual(self._problem.vector)
        return float(self._problem.vector.norm())

    def factorise(self, stiffness: PETSc.Mat, factor: float) -> bool:
        """Factorise the tangent of the last update plus a multiple of another matrix.

        Returns:
            False where it could not be factorised, or its determinant is negative.
        """
        self.linear.assemble()
        self._problem.matrix.axpy(factor, stiffness, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        return self.linear.factorise() and self.linear.determinant_is_positive()

    @property
    def sees_branches(self) -> bool:
        """Whether the sign of the tangent's determinant is known at an equilibrium."""
        return self.linear.tells_determinant

    def _failed(self, reason: int, iterations: int, residual: float) -> Solution:
        """What became of a solution that SNES gave up for a reason."""
        reasons = PETSc.SNES.ConvergedReason
        if reason == reasons.DIVERGED_LINEAR_SOLVE:
            told, lasting = self.linear.failure()
            return Solution(False, iterations, told, residual, hopeless=lasting)
        if self._failure and (not iterations or reason == reasons.DIVERGED_LINE_SEARCH):
            return Solution(False, iterations, str(self._failure), residual)
        name = _REASONS[reason]
        return Solution(False, iterations, f"{_WORDS.get(name, 'SNES gave up')} ({name})", residual)

    def explanation(self) -> str:
        """Where the forces are out of balance most at the unknown at hand, or why the law does not reach it."""
        if np.isfinite(self.out_of_balance()):
            return imbalance(self._problem)
        assert self._failure is not None
        return failure_with_state(self._problem, self._failure)

    def _is_rounding(self) -> bool:
        """Whether the out-of-balance forces at the last iterate are no more than rounding of the unknown makes.

        Where the body has moved far and is stiff, the strain increment of a small step holds few digits. How few shows
        in the forces' change when every unknown is changed in its last digit.
        """
        problem = self._problem
        if self.snes.getFunctionNorm() > self._rounding:
            return False
        forces = []
        for change in (0.0, np.finfo(float).eps):
            problem.set_unknown(self._x)
            array = problem.unknown.x.array
            array *= 1 + change * np.where(np.arange(len(array)) % 2, 1, -1)
            if not np.isfinite(self.out_of_balance()):
                return False
            forces.append(problem.vector.copy())
        exact, changed = forces
        changed.axpy(-1.0, exact)
        return bool(exact.norm() <= 10 * changed.norm())

    def _is_stable(self, iterations: int) -> bool:
        """Whether the determinant of the tangent factorised last is positive, or unknown.

        Args:
            iterations: made for this equilibrium; where a guess was one, its tangent is factorised now.
        """
        if not self.sees_branches:
            return True
        if not iterations:
            self.linear.assemble()
        if (not iterations or not self.linear.is_factorised) and not self.linear.factorise():
            return True
        return self.linear.determinant_is_positive()

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        """Residual callback; a state that cannot be reached has an infinite one."""
        adapt = not self._frozen and snes.getIterationNumber() < _ADAPTING_ITERATIONS
        if self._evaluate(x, adapt=adapt):
            self._problem.assemble_residual(b)
        else:
            b.set(np.inf)

    def _test_convergence(
        self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]
    ) -> PETSc.SNES.ConvergedReason:
        """Convergence callback: by the out-of-balance forces alone, given up where they no longer fall.

        Args:
            snes: the solver.
            iteration: how many there were.
            norms: of the unknown, of its last change and of the out-of-balance forces.
        """
        reasons, forces = PETSc.SNES.ConvergedReason, norms[2]
        self._norms = [*(self._norms if iteration else []), forces]
        if not np.isfinite(forces):
            return reasons.DIVERGED_FNORM_NAN
        if forces <= snes.getTolerances()[1]:
            return reasons.CONVERGED_FNORM_ABS
        patience = _PATIENCE if forces > self._rounding else _PATIENCE_AT_THE_END
        if iteration > patience and forces > self._norms[-1 - patience] / 2:
            return reasons.DIVERGED_DTOL
        return reasons.ITERATING

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, a: PETSc.Mat, p: PETSc.Mat) -> None:
        """Jacobian callback; the tangent of the last residual serves where the point is the same."""
        if not self._evaluated.equal(x):
            self._evaluate(x, adapt=False)
        self.linear.assemble()

    def _evaluate(self, x: PETSc.Vec, *, adapt: bool) -> bool:
        """Update the trial state at a point; False, on every rank, where the law cannot."""
        self.before_evaluation()
        self._problem.set_unknown(x)
        failure = self._problem.update(adapt=adapt)
        self._failure = failure or self._failure
        x.copy(self._evaluated)
        return failure is None


def _set_options(linear: Mapping[str, PetscOption], options: Mapping[str, PetscOption]) -> None:
    """Put a solver's options into PETSc's database, and take out what an earlier solver put there.

    An option given here goes before one from the environment, and that before a default.

    Args:
        linear: options of the linear solver, defaults like those of the iteration.
        options: given.
    """
    database = PETSc.Options(_PREFIX)
    while _set_here:
        database.delValue(_set_here.pop())
    for key, value in {**_DEFAULTS, **linear, **options}.items():
        if key.startswith("pc_factor") and key not in options and database.getString("pc_type") != "lu":
            continue
        if key in options or not database.hasName(key):
            database.setValue(key, value)
            _set_here.add(key)
        if key not in options:
            database.hasName(key)  # counts as use; PETSc lists at the end what nobody asked for


def _restore_options(linear: Mapping[str, PetscOption], options: Mapping[str, PetscOption]) -> None:
    """Put options back that another solver took out of PETSc's database.

    Args:
        linear: options of the linear solver.
        options: given.
    """
    database = PETSc.Options(_PREFIX)
    if not all(database.hasName(key) for key in linear):
        _set_options(linear, options)


def _weakly(method: Callable[..., Any]) -> Callable[..., Any]:
    """A callback that does not keep its object alive: PETSc's references are out of the garbage collector's sight."""
    reference = WeakMethod(method)

    def call(*arguments: object) -> Any:
        bound = reference()
        return None if bound is None else bound(*arguments)

    return call
