"""Which linear solver a run has: factors for most bodies, a preconditioned Krylov method for large ones.

Factors of a plane body grow faster than its unknowns, in time and in memory. For those with many unknowns GMRES is
preconditioned by one sweep of block Gauss-Seidel over rotation and displacement, each of which is approximately solved
by a cycle of algebraic multigrid with smoothed aggregation. Splitting takes care of the units: rows and columns of the
displacement and of the rotation are not comparable, and multigrid on all of them together does not converge.

With the rotation held, a displacement strains a Cosserat continuum unless it is a translation: a rigid rotation of the
grains' centres alone shears it. So the translations are the whole near-nullspace of the displacement's block, which its
block size says, and the constant is that of the rotation's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cosserat_fx._compat import PETSc
from cosserat_fx.layout import Dimension
from cosserat_fx.problem import Problem

PetscOption = str | int | float | bool
Kind = Literal["direct", "iterative", "given"]
Wish = Literal["auto", "direct", "iterative"]

CROSSOVER = 100_000
"""Unknowns of a plane body from which an iterative solution pays, that of branches watched with factors once a step;
without those it is faster from about ten thousand on (benchmarks/growth.py)."""
DIRECT: dict[str, PetscOption] = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
_KRYLOV: dict[str, PetscOption] = {
    "ksp_type": "gmres",
    "ksp_pc_side": "right",
    "ksp_gmres_restart": 100,
    "ksp_max_it": 200,
    "ksp_rtol": 1e-3,
}
_MULTIGRID: dict[str, PetscOption] = {
    "pc_type": "gamg",
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 2,
    "mg_levels_pc_type": "sor",
}
_SPLITS = ("u", "w")
FACTORISING = ("lu", "cholesky")
"""PETSc's preconditioners that take memory for factors."""
FACTORS_PREFIX = "cosserat_factors_"
_ASKING = ("ksp_type", "pc_type", "pc_factor", "mat_mumps")
"""How options begin by which a user chooses a linear solver."""


@dataclass(frozen=True)
class LinearSolver:
    """A choice of linear solver.

    Attributes:
        kind: "direct", "iterative" or, where the user's PETSc options ask for another one, "given".
        reason: why.
        beside: whether factors are made beside an iterative solver: once a step, to watch branches, and where it fails.
    """

    kind: Kind
    reason: str
    beside: bool = False

    def __str__(self) -> str:
        """One line for the user."""
        words = {"direct": "direct", "iterative": "GMRES with multigrid", "given": "as given"}
        return f"linear solver: {words[self.kind]}, {self.reason}"

    @property
    def blindness(self) -> str:
        """Why nobody knows the sign of the tangent's determinant, where that is so."""
        if self.kind == "iterative":
            return "there is no memory for the factors that would tell the tangent's determinant"
        return "of the direct solvers only MUMPS tells the tangent's determinant"

    def petsc_options(self, *, polar: bool) -> dict[str, PetscOption]:
        """PETSc's options for it (without prefix), which those of the user go before.

        Args:
            polar: whether there are rotations.
        """
        if self.kind != "iterative":
            return DIRECT
        if not polar:
            return _KRYLOV | _MULTIGRID
        parts = {f"fieldsplit_{name}_{key}": value for name in _SPLITS for key, value in _MULTIGRID.items()}
        inner = {f"fieldsplit_{name}_ksp_type": "preonly" for name in _SPLITS}
        return _KRYLOV | {"pc_type": "fieldsplit", "pc_fieldsplit_type": "multiplicative"} | inner | parts


def choose(
    wish: Wish,
    dimension: Dimension,
    unknowns: int,
    *,
    options: Mapping[str, PetscOption] | None = None,
    factors_fit: bool = True,
    beside_fit: bool = True,
) -> LinearSolver:
    """Choose the linear solver of a body.

    Args:
        wish: what the scene says.
        dimension: of the body.
        unknowns: of the body, over all ranks.
        options: PETSc options of the user (without prefix).
        factors_fit: whether there is enough memory for factors.
        beside_fit: whether there is, for factors beside an iterative solver.
    """
    options = options or {}
    if any(key.startswith(_ASKING) for key in options):
        kind: Kind = "direct" if options.get("pc_type", "lu") in FACTORISING else "given"
        return LinearSolver(kind, "PETSc's options say so")
    if wish == "direct":
        return LinearSolver("direct", "the scene says so")
    if wish == "iterative":
        return LinearSolver("iterative", "the scene says so", beside_fit)
    if dimension == "layer":
        return LinearSolver("direct", "the factors of a layer grow as its unknowns do")
    if not factors_fit:
        return LinearSolver("iterative", f"factors for {unknowns} unknowns do not fit into the memory")
    if unknowns >= CROSSOVER:
        return LinearSolver("iterative", f"faster for {unknowns} unknowns, from about {CROSSOVER} on", beside_fit)
    return LinearSolver("direct", f"faster for {unknowns} unknowns, below about {CROSSOVER}")


def split_fields(pc: PETSc.PC, problem: Problem) -> None:
    """Tell a preconditioner that splits fields which unknowns are displacements and which rotations.

    Displacements are taken node by node, so that aggregation sees their translations.

    Args:
        pc: of the problem's matrix; of any other kind it is left alone.
        problem: with rotations.
    """
    if pc.getType() != PETSc.PC.Type.FIELDSPLIT or "w" not in problem.fields:
        return
    first = problem.vector.getOwnershipRange()[0]
    parts = {name: part.dofs[: part.owned] for name, part in problem.fields.items()}
    rotation = parts.pop("w")
    splits = np.column_stack(list(parts.values())), rotation[:, None]
    for name, dofs in zip(_SPLITS, splits, strict=True):
        rows = PETSc.IS().createGeneral((first + dofs.ravel()).astype(PETSc.IntType), comm=problem.comm)
        rows.setBlockSize(dofs.shape[1])
        pc.setFieldSplitIS((name, rows))


def factors(problem: Problem) -> PETSc.KSP:
    """A direct solver for the problem's matrix beside the one chosen, with options of its own prefix.

    Args:
        problem: whose matrix is to be factorised.
    """
    ksp = PETSc.KSP().create(problem.comm)
    ksp.setOptionsPrefix(FACTORS_PREFIX)
    ksp.setOperators(problem.matrix)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.LU)
    ksp.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    ksp.setFromOptions()
    return ksp
