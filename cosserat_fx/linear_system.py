"""The linear systems of Newton's method: solved as chosen, and by factors where these have something to add.

Factors tell the sign of the tangent's determinant, by which unstable branches of equilibria are seen. Where systems are
solved iteratively, the tangent is factorised once a step for that, memory permitting; and where the iterative solver
fails, factors stand in for it.
"""

from __future__ import annotations

from collections.abc import Callable

from cosserat_fx._compat import MPI, PETSc
from cosserat_fx.linear_failure import LinearFailure, linear_failure
from cosserat_fx.linear_solver import LinearSolver, factors, split_fields
from cosserat_fx.problem import Problem

_MUMPS_DETERMINANT = 33


class LinearSystem:
    """The problem's matrix and what solves with it.

    Attributes:
        choice: of the solver.
        notes: what the user should know of the solutions so far, each once.
    """

    def __init__(
        self, snes: PETSc.SNES, problem: Problem, choice: LinearSolver, restore_options: Callable[[], None]
    ) -> None:
        """Take over the linear solver of SNES, whose options have been set.

        Args:
            snes: which solves with it.
            problem: whose matrix it is.
            choice: of the solver.
            restore_options: puts options back into PETSc's database that another solver took out.
        """
        self.choice = choice
        self.notes: list[str] = []
        self._snes, self._problem, self._restore_options = snes, problem, restore_options
        self._chosen: PETSc.KSP = snes.getKSP()
        self._factors: PETSc.KSP | None = None
        self._asked_for_determinant = False
        split_fields(self._chosen.getPC(), problem)

    def begin(self) -> None:
        """Solve as chosen, whatever stood in before."""
        if self._stands_in:
            self._switch(self._chosen)

    def assemble(self) -> None:
        """Assemble the Jacobian; before its first factorisation, ask MUMPS for its determinant.

        The levels of multigrid ask for their options when they are made, which is when they are used first.
        """
        if self.choice.kind == "iterative":
            self._restore_options()
        self._problem.assemble_jacobian()
        self._prepare()

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve with the matrix as it was given last, by factors where the iterative solver fails.

        Args:
            b: right-hand side.
            x: overwritten.

        Returns:
            Whether that went well.
        """
        ksp = self._snes.getKSP()
        ksp.solve(b, x)
        if ksp.getConvergedReason() < 0 and self.fall_back():
            ksp = self._snes.getKSP()
            ksp.solve(b, x)
        return bool(ksp.getConvergedReason() > 0)

    def take(self) -> None:
        """Have the matrix at hand solved with."""
        self._snes.getKSP().setOperators(self._problem.matrix)

    def fall_back(self) -> bool:
        """Let factors stand in for an iterative solver that failed; whether that is possible and something new."""
        if not self.choice.beside or self._stands_in:
            return False
        self._note(f"{self.failure().reason}; where it fails, systems are solved directly")
        self._stand_in()
        return True

    def factorise(self) -> bool:
        """Factorise the matrix at hand, or set up the iterative solver; whether that went well on all ranks."""
        if self.choice.beside:
            self._stand_in()
        self.take()
        ksp = self._snes.getKSP()
        ksp.setUp()
        failed = self._problem.comm.allreduce(bool(ksp.getPC().getFailedReason()), op=MPI.LOR)
        if failed and self.choice.beside:
            self._note(f"{self.failure().reason}; where that happens, branches of equilibrium are not watched")
        return not failed

    @property
    def tells_determinant(self) -> bool:
        """Whether the matrix's determinant is known once it is factorised: MUMPS tells it, other solvers do not."""
        return self.choice.beside or _is_mumps(self._chosen)

    @property
    def is_factorised(self) -> bool:
        """Whether the solver that solves now has factors that tell the determinant."""
        return _is_mumps(self._snes.getKSP())

    def determinant_is_positive(self) -> bool:
        """Whether the determinant of the matrix factorised last is not negative, or unknown."""
        if not self.is_factorised:
            return True
        determinant = self._snes.getKSP().getPC().getFactorMatrix().getMumpsRinfog(12)
        return bool(self._problem.comm.bcast(determinant) >= 0)  # MUMPS promises it on the first rank alone

    def failure(self) -> LinearFailure:
        """Why the last system could not be solved."""
        return linear_failure(self._snes.getKSP())

    @property
    def _stands_in(self) -> bool:
        """Whether factors stand in for the iterative solver."""
        return self._factors is not None and bool(self._snes.getKSP().handle == self._factors.handle)

    def _stand_in(self) -> None:
        """Let factors stand in; what they know of the matrix's structure is kept from one time to the next."""
        if self._factors is None:
            self._factors = factors(self._problem)
        if not self._stands_in:
            self._switch(self._factors)
        self.take()
        self._prepare()

    def _note(self, note: str) -> None:
        if note not in self.notes:
            self.notes.append(note)

    def _switch(self, ksp: PETSc.KSP) -> None:
        self._snes.setKSP(ksp)
        self._asked_for_determinant = False

    def _prepare(self) -> None:
        """Ask MUMPS for the determinant, if it is MUMPS that solves and was not asked yet."""
        if not self.is_factorised or self._asked_for_determinant:
            return
        self.take()
        pc = self._snes.getKSP().getPC()
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(_MUMPS_DETERMINANT, 1)
        self._asked_for_determinant = True


def _is_mumps(ksp: PETSc.KSP) -> bool:
    pc = ksp.getPC()
    return bool(pc.getType() == "lu" and pc.getFactorSolverType() == "mumps")
