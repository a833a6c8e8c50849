"""Newton's method for an implicit stage of many points at once, of which none knows of the others."""

from __future__ import annotations

from cosserat_fx import rows as row
from cosserat_fx.compiled import kernel
from cosserat_fx.dense import factorise, solve
from cosserat_fx.hypoplasticity import Status, rate, stage_matrix
from cosserat_fx.material import KernelConstants
from cosserat_fx.tables import Tables
from cosserat_fx.typing import Array

# A Newton correction of this size, relative to the trace of the stress, leaves an error of about its square.
_NEWTON_TOLERANCE = 1e-7
_NEWTON_ITERATIONS = 25
_NEWTON_HALVINGS = 12

_OK = float(Status.OK)
_LOCAL_NEWTON = float(Status.LOCAL_NEWTON)
_DENSE = float(Status.DENSER_THAN_E_D)


@kernel
def solve_stage(rows: Array, lanes: int, c: KernelConstants, t: Tables, want_factors: bool) -> None:
    """Newton's method for ``stage = base + scale f(stage)`` at every point, from the guess among the candidates.

    A guess denser than e_d, as in compression near it, is given a pressure at which it is not. Corrections that leave
    the law's domain are halved. A point that has found its solution or fails stays as it is while others go on: no
    point knows of another. At the end the law is that of the solutions and so are, if wanted, the factors.
    """
    n = len(t.weight)
    for lane in range(lanes):
        rows[row.ACTIVE, lane] = 1.0 if rows[row.FAILURE, lane] == _OK else 0.0
    for iteration in range(_NEWTON_ITERATIONS + 1):
        for _ in range(_NEWTON_HALVINGS):
            rate(rows, row.CANDIDATE, lanes, c, t)
            if not _bring_inside(rows, n, lanes, iteration == 0):
                break
        going_on = _accept(rows, n, lanes, iteration == 0)
        if not going_on and not want_factors:
            return
        stage_matrix(rows, lanes, t)
        factorise(rows, row.MATRIX, n, lanes)
        if not going_on:
            return
        _correct(rows, n, lanes)
    for lane in range(lanes):
        rows[row.FAILURE, lane] = max(rows[row.FAILURE, lane], _LOCAL_NEWTON * rows[row.ACTIVE, lane])


@kernel
def _bring_inside(rows: Array, n: int, lanes: int, first: bool) -> bool:
    """Change the candidates outside of the law's domain: a first guess that is too dense, else corrections.

    Returns:
        Whether there were any.
    """
    changed = False
    for lane in range(lanes):
        outside = rows[row.ACTIVE, lane] * rows[row.CODE, lane]
        if outside == _OK or (first and outside != _DENSE):
            continue
        changed = True
        rows[row.DAMPING, lane] *= 0.5
        for i in range(n):
            correction = rows[row.DAMPING, lane] * rows[row.CORRECTION + i, lane]
            halved, doubled = rows[row.STAGE + i, lane] + correction, 2.0 * rows[row.CANDIDATE + i, lane]
            rows[row.CANDIDATE + i, lane] = doubled if first else halved
    return changed


@kernel
def _accept(rows: Array, n: int, lanes: int, first: bool) -> bool:
    """Take the candidates as stages where the law describes them; whether any point is not at its solution yet."""
    for lane in range(lanes):
        active = rows[row.ACTIVE, lane]
        failure = max(rows[row.FAILURE, lane], active * rows[row.CODE, lane])
        rows[row.FAILURE, lane] = failure
        rows[row.ALONG, lane] = 1.0 if first or rows[row.DAMPING, lane] < 1.0 else 0.0
    for i in range(n):
        for lane in range(lanes):
            active = rows[row.ACTIVE, lane] > 0.0
            rows[row.STAGE + i, lane] = rows[row.CANDIDATE + i, lane] if active else rows[row.STAGE + i, lane]
            close = abs(rows[row.CORRECTION + i, lane]) <= -_NEWTON_TOLERANCE * rows[row.TRACE, lane]
            rows[row.ALONG, lane] = rows[row.ALONG, lane] if close else 1.0
    going_on = 0.0
    for lane in range(lanes):
        active = rows[row.ACTIVE, lane] * rows[row.ALONG, lane]
        rows[row.ACTIVE, lane] = active if rows[row.FAILURE, lane] == _OK else 0.0
    for lane in range(lanes):
        going_on = max(going_on, rows[row.ACTIVE, lane])
    return going_on > 0.0


@kernel
def _correct(rows: Array, n: int, lanes: int) -> None:
    """Newton's corrections with the factors at hand, and the candidates that they lead to."""
    for i in range(n):
        for lane in range(lanes):
            known = rows[row.BASE + i, lane] - rows[row.STAGE + i, lane]
            rows[row.CORRECTION + i, lane] = known + rows[row.SCALE, lane] * rows[row.RATE + i, lane]
    solve(rows, row.MATRIX, row.CORRECTION, n, 1, lanes)
    mark_lost(rows, row.CORRECTION, n, lanes)
    for lane in range(lanes):
        rows[row.DAMPING, lane] = 1.0
        lost = rows[row.ALONG, lane] != 0.0
        failure = rows[row.FAILURE, lane]
        rows[row.FAILURE, lane] = max(failure, _LOCAL_NEWTON * rows[row.ACTIVE, lane]) if lost else failure
        rows[row.ACTIVE, lane] = 0.0 if lost else rows[row.ACTIVE, lane]
    for i in range(n):
        for lane in range(lanes):
            correction = rows[row.CORRECTION + i, lane] if rows[row.ACTIVE, lane] > 0.0 else 0.0
            rows[row.CANDIDATE + i, lane] = rows[row.STAGE + i, lane] + correction


@kernel
def mark_lost(rows: Array, first: int, number: int, lanes: int) -> None:
    """Let the sum on its way be 0 for points with finite numbers in some rows, else not: a pivot was zero."""
    for lane in range(lanes):
        rows[row.ALONG, lane] = 0.0
    for k in range(number):
        for lane in range(lanes):
            rows[row.ALONG, lane] += 0.0 * rows[first + k, lane]
