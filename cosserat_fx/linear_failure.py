"""Why a linear system could not be solved, in words."""

from __future__ import annotations

from typing import NamedTuple

from cosserat_fx._compat import PETSc

_MUMPS = {
    -5: "there is not enough memory to plan the factorisation",
    -6: "the tangent is singular in structure: some unknown is held by nothing",
    -7: "there is not enough memory to plan the factorisation",
    -8: "its memory for integers is too small",
    -9: "its memory for numbers is too small",
    -10: "the tangent is singular",
    -13: "there is not enough memory",
    -17: "its memory for messages is too small",
    -19: "the memory that it is allowed is too small",
    -20: "its memory for messages is too small",
}
"""INFOG(1), from MUMPS' Users' Guide."""
_MEMORY = {-5, -7, -8, -9, -13, -17, -19, -20}
_ITERATIVE = {
    value: name.lower().replace("_", " ")
    for name, value in vars(PETSc.KSP.ConvergedReason).items()
    if isinstance(value, int) and value < 0
}


class LinearFailure(NamedTuple):
    """Why a linear system could not be factorised or solved.

    Attributes:
        reason: in words.
        lasting: whether the same would happen to any other system of this size: there is too little memory.
    """

    reason: str
    lasting: bool


def linear_failure(ksp: PETSc.KSP) -> LinearFailure:
    """Tell why the last linear system could not be factorised or solved.

    Args:
        ksp: which failed.
    """
    pc = ksp.getPC()
    if pc.getType() == "lu" and pc.getFactorSolverType() == "mumps":
        factors = pc.getFactorMatrix()
        code, detail = factors.getMumpsInfog(1), factors.getMumpsInfog(2)
        if code < 0:
            reason = _MUMPS.get(code, "see its Users' Guide")
            told = f"MUMPS could not factorise the tangent: {reason} (INFOG(1) = {code}, INFOG(2) = {detail})"
            return LinearFailure(told, code in _MEMORY)
    reason = _ITERATIVE.get(ksp.getConvergedReason(), "for an unknown reason")
    return LinearFailure(f"the linear solver ({ksp.getType()}, {pc.getType()}) failed: {reason}", False)
