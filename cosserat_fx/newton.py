"""Equilibrium of one step by PETSc's SNES: Newton's method with a backtracking line search.

Two things are special to this problem. The number of local substeps of each point may grow during the first
iterations and is frozen after them, or the residual would jump; a converged solution is checked with it set free once
more. And a state that the law cannot reach gives an infinite residual, from which the line search backs off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from weakref import WeakMethod

import numpy as np

from cosserat_fx._compat import MPI, PETSc, dolfinx
from cosserat_fx.problem import Failure, Problem

PetscOption = str | int | float | bool

_DEFAULTS: dict[str, PetscOption] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
}
_MUMPS_DETERMINANT = 33
_ADAPTING_ITERATIONS = 2
_RECHECKS = 3
_PREFIX = "cosserat_"
_set_here: set[str] = set()

_REASONS = {
    value: name.lower().replace("_", " ")
    for name, value in vars(PETSc.SNES.ConvergedReason).items()
    if isinstance(value, int) and value < 0
}


@dataclass(frozen=True)
class Solution:
    """How the iteration of one step ended.

    Attributes:
        converged: whether the step is in equilibrium.
        iterations: Newton iterations.
        reason: why not, where it is not.
        residual: norm of the out-of-balance forces relative to that of the internal forces.
        stable: False where the tangent's determinant is negative, as it is with an odd number of negative eigenvalues.
    """

    converged: bool
    iterations: int
    reason: str
    residual: float
    stable: bool = True

    def after(self, iterations: int) -> Solution:
        """The same, with the iterations of earlier attempts counted in."""
        return replace(self, iterations=self.iterations + iterations)


class NewtonSolver:
    """SNES on a :class:`~cosserat_fx.problem.Problem`.

    Attributes:
        snes: the PETSc object, for users who want to set more than options reach. Options have the prefix
            ``cosserat_`` in PETSc's database, where they override the defaults.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        tolerance: float = 1e-9,
        max_iterations: int = 25,
        options: Mapping[str, PetscOption] | None = None,
    ) -> None:
        """Create the solver.

        Args:
            problem: what to solve.
            tolerance: of the out-of-balance forces, relative to the internal forces.
            max_iterations: Newton iterations of one step.
            options: PETSc options without prefix, such as ``{"snes_monitor": ""}``.
        """
        self._problem = problem
        self._tolerance = tolerance
        self._failure: Failure | None = None
        self._frozen = self._asked_for_determinant = False
        self._evaluated = problem.vector.duplicate()
        self._x = problem.vector.duplicate()

        _set_options(options or {})
        self.snes = PETSc.SNES().create(problem.comm)
        self.snes.setOptionsPrefix(_PREFIX)
        self.snes.setFunction(_weakly(self._residual), problem.vector)
        self.snes.setJacobian(_weakly(self._jacobian), problem.matrix)
        self.snes.setTolerances(rtol=0.0, stol=0.0, max_it=max_iterations)
        self.snes.setFromOptions()

    def solve(self) -> Solution:
        """Find equilibrium from the problem's unknown, which holds the prescribed values already."""
        problem = self._problem
        problem.state.restart_substeps()
        scale = problem.force_scale()
        self.snes.setTolerances(atol=self._tolerance * scale)
        self._x.array_w[:] = problem.unknown.x.array[: self._x.getLocalSize()]
        self._frozen, iterations = False, 0
        for _ in range(_RECHECKS):
            self._failure = None
            with problem.stopwatch("Newton"):
                self.snes.solve(None, self._x)
            iterations += self.snes.getIterationNumber()
            residual = self.snes.getFunctionNorm() / scale
            reason = self.snes.getConvergedReason()
            if reason < 0:
                return Solution(False, iterations, str(self._failure or _REASONS[reason]), residual)
            before = problem.state.substeps.copy()
            problem.set_unknown(self._x)
            if failure := problem.update(adapt=True):
                return Solution(False, iterations, str(failure), residual)
            if not problem.comm.allreduce(bool(np.any(before != problem.state.substeps)), op=MPI.LOR):
                return Solution(True, iterations, "converged", residual, stable=self._is_stable(iterations))
            self._frozen = True
        return Solution(False, iterations, "the number of local substeps did not settle", residual)

    def predict(self) -> bool:
        """Take a linear step to the prescribed values with the tangent at the unknown at hand.

        From the committed fields this is the answer of the law's linear part, a first guess where there is no
        previous increment to follow.

        Returns:
            Whether the linear system could be solved.
        """
        problem = self._problem
        if problem.update(adapt=True):
            return False
        b = problem.vector
        problem.assemble_prediction(b)
        self._assemble_jacobian(problem.matrix)
        ksp = self.snes.getKSP()
        ksp.setOperators(problem.matrix)
        with problem.stopwatch("linear solve"):
            ksp.solve(b, self._x)
        if ksp.getConvergedReason() < 0:
            return False
        problem.unknown.x.array[: self._x.getLocalSize()] += self._x.array_r
        problem.unknown.x.scatter_forward()
        problem.impose()
        return True

    def apply_inverse(self, field: dolfinx.fem.Function) -> bool:
        """Replace a field by the solution with it as right-hand side, with the tangent factorised last.

        Returns:
            Whether the linear system could be solved.
        """
        b = self._problem.vector
        b.array_w[:] = field.x.array[: b.getLocalSize()]
        ksp = self.snes.getKSP()
        ksp.solve(b, self._x)
        field.x.array[: b.getLocalSize()] = self._x.array_r
        field.x.scatter_forward()
        return bool(ksp.getConvergedReason() > 0)

    @property
    def sees_branches(self) -> bool:
        """Whether the tangent's determinant is known: MUMPS tells it, other solvers do not."""
        pc = self.snes.getKSP().getPC()
        return bool(pc.getType() == "lu" and pc.getFactorSolverType() == "mumps")

    def _is_stable(self, iterations: int) -> bool:
        """Whether the determinant of the tangent factorised last is positive, or unknown.

        Args:
            iterations: made for this equilibrium; where a guess was one, its tangent is factorised now.
        """
        if not self.sees_branches:
            return True
        ksp = self.snes.getKSP()
        if not iterations:
            self._assemble_jacobian(self._problem.matrix)
            ksp.setOperators(self._problem.matrix)
            ksp.setUp()
        return bool(ksp.getPC().getFactorMatrix().getMumpsRinfog(12) >= 0)

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        """Residual callback; a state that cannot be reached has an infinite one."""
        adapt = not self._frozen and snes.getIterationNumber() < _ADAPTING_ITERATIONS
        if self._evaluate(x, adapt=adapt):
            self._problem.assemble_residual(b)
        else:
            b.set(np.inf)

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, a: PETSc.Mat, p: PETSc.Mat) -> None:
        """Jacobian callback; the tangent of the last residual serves where the point is the same."""
        if not self._evaluated.equal(x):
            self._evaluate(x, adapt=False)
        self._assemble_jacobian(p)

    def _assemble_jacobian(self, a: PETSc.Mat) -> None:
        """Assemble the Jacobian; before its first factorisation, ask MUMPS for its determinant."""
        self._problem.assemble_jacobian(a)
        if self.sees_branches and not self._asked_for_determinant:
            ksp = self.snes.getKSP()
            ksp.setOperators(a)
            ksp.getPC().setFactorSetUpSolverType()
            ksp.getPC().getFactorMatrix().setMumpsIcntl(_MUMPS_DETERMINANT, 1)
            self._asked_for_determinant = True

    def _evaluate(self, x: PETSc.Vec, *, adapt: bool) -> bool:
        """Update the trial state at a point; False, on every rank, where the law cannot."""
        self._problem.set_unknown(x)
        failure = self._problem.update(adapt=adapt)
        self._failure = failure or self._failure
        x.copy(self._evaluated)
        return failure is None


def _set_options(options: Mapping[str, PetscOption]) -> None:
    """Put a solver's options into PETSc's database, and take out what an earlier solver put there.

    An option given here goes before one from the environment, and that before a default.
    """
    database = PETSc.Options(_PREFIX)
    while _set_here:
        database.delValue(_set_here.pop())
    for key, value in {**_DEFAULTS, **options}.items():
        if key in options or not database.hasName(key):
            database.setValue(key, value)
            _set_here.add(key)


def _weakly(method: Callable[..., None]) -> Callable[..., None]:
    """A callback that does not keep its object alive: PETSc's references are out of the garbage collector's sight."""
    reference = WeakMethod(method)

    def call(*arguments: object) -> None:
        bound = reference()
        if bound is not None:
            bound(*arguments)

    return call
