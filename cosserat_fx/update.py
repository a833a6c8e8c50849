r"""The rate law integrated over a strain increment, with the exact tangent of that integration.

The increment is applied at a constant rate over a unit of pseudo-time, in *K* substeps that end at the times
:math:`(k/K)^2`: a change of direction starts with a fast transient, which small first substeps follow, while the
method stays of second order in 1/K. Each substep, of size *h*, is one step of the L-stable, stiffly accurate SDIRK
method of second order,

.. math::

    Y_1 = y + \gamma h f(Y_1), \qquad Y_2 = y + (1-\gamma) h f(Y_1) + \gamma h f(Y_2), \qquad
    \gamma = 1 - 1/\sqrt 2,

whose stages are solved by Newton's method. The void ratio needs no integration: 1 + e scales with the
volume, :math:`1 + e(\tau) = (1 + e_n) \exp(\tau\, \Delta\epsilon_{kk})`. Differentiating the converged
stages gives the derivative of the result by one more solve with the factors at hand, so the
tangent is that of the discrete update and not of the rate equations.

The error of a substep is estimated from how far f(Y_1) lies from the straight line between f(y) and f(Y_2),

.. math::

    (1 - \gamma h f')^{-1} \tfrac23 h [f(Y_1) - (1-\gamma) f(y) - \gamma f(Y_2)],

the one combination of the three that vanishes to second order. The factor 2/3 makes it the leading error where the law
is linear; the filter, the inverse of the stage matrix, keeps it meaningful where it is stiff (as Hosea and Shampine do
for TR-BDF2). The number of substeps of a point is chosen from it when the caller asks for it and is otherwise taken as
given: with it frozen the update is a smooth function of the increment.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from math import exp, expm1, isfinite, sqrt

import numpy as np
from numba import njit

from cosserat_fx import rows as row
from cosserat_fx.compiled import fingerprint, kernel
from cosserat_fx.dense import factorise, solve
from cosserat_fx.elementary import exponential
from cosserat_fx.hypoplasticity import (
    FIRST_FAILURE,
    Status,
    Tables,
    add_input_derivative,
    rate,
    stage_matrix,
    tables,
)
from cosserat_fx.layout import Layout
from cosserat_fx.material import KernelConstants
from cosserat_fx.rows import LANES
from cosserat_fx.typing import Array, CodeArray, IntArray

GAMMA = 1.0 - 1.0 / sqrt(2.0)
_SECOND_BY_FIRST = (1.0 - GAMMA) / GAMMA
_ERROR_FACTOR = 2.0 / 3.0

# A Newton correction of this size, relative to the trace of the stress, leaves an error of about its square.
_NEWTON_TOLERANCE = 1e-7
_NEWTON_ITERATIONS = 25
_NEWTON_HALVINGS = 12
_ORDER_OF_ERROR = 3.0

_OK = float(Status.OK)
_LOCAL_NEWTON = float(Status.LOCAL_NEWTON)
_DENSE = float(Status.DENSER_THAN_E_D)
_NOT_FINITE = float(Status.NOT_FINITE)
_UPDATED, _LOOSE, _SUBSTEPS, _NUMBERLESS = (
    int(s) for s in (Status.OK, Status.LOOSER_THAN_E_I, Status.SUBSTEPS, Status.NOT_FINITE)
)

Update = Callable[..., tuple[int, int]]


@kernel
def _solve_stage(rows: Array, lanes: int, c: KernelConstants, t: Tables, want_factors: bool) -> None:
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
            outside = 0.0
            for lane in range(lanes):
                outside = max(outside, rows[row.ACTIVE, lane] * rows[row.CODE, lane])
            if outside == 0.0:
                break
            _bring_inside(rows, n, lanes, iteration == 0)
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
def _bring_inside(rows: Array, n: int, lanes: int, first: bool) -> None:
    """Change the candidates outside of the law's domain: a first guess that is too dense, else corrections."""
    for lane in range(lanes):
        outside = rows[row.ACTIVE, lane] * rows[row.CODE, lane]
        if outside == _OK:
            continue
        rows[row.DAMPING, lane] *= 0.5
        for i in range(n):
            if not first:
                correction = rows[row.DAMPING, lane] * rows[row.CORRECTION + i, lane]
                rows[row.CANDIDATE + i, lane] = rows[row.STAGE + i, lane] + correction
            elif outside == _DENSE:
                rows[row.CANDIDATE + i, lane] *= 2.0


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
    for lane in range(lanes):
        rows[row.DAMPING, lane] = 1.0
        rows[row.ALONG, lane] = 0.0
    for i in range(n):
        for lane in range(lanes):
            rows[row.ALONG, lane] += 0.0 * rows[row.CORRECTION + i, lane]  # not a number where this is not finite
    for lane in range(lanes):
        lost = rows[row.ALONG, lane] != 0.0
        failure = rows[row.FAILURE, lane]
        rows[row.FAILURE, lane] = max(failure, _LOCAL_NEWTON * rows[row.ACTIVE, lane]) if lost else failure
        rows[row.ACTIVE, lane] = 0.0 if lost else rows[row.ACTIVE, lane]
    for i in range(n):
        for lane in range(lanes):
            correction = rows[row.CORRECTION + i, lane] if rows[row.ACTIVE, lane] > 0.0 else 0.0
            rows[row.CANDIDATE + i, lane] = rows[row.STAGE + i, lane] + correction


@kernel
def _integrate(
    rows: Array, lanes: int, evolving: bool, estimate: bool, want_tangent: bool, c: KernelConstants, t: Tables
) -> None:
    """Advance the states over the increments by every point's number of substeps.

    A point that has made its substeps makes further ones of no size, which change nothing. What ended the integration
    of a point and, where asked for, its largest error estimate are in their rows afterwards.
    """
    n = len(t.weight)
    inputs = len(t.slots) + t.n_spin
    derivatives = n * inputs if want_tangent else 0
    most = _prepare(rows, n, lanes, t)
    for k in range(derivatives):
        for lane in range(lanes):
            rows[row.SENSITIVITY + k, lane] = 0.0
    for step in range(most):
        _begin_substep(rows, lanes, step)
        if estimate:
            _begin_estimate(rows, n, lanes, step == 0, c, t)
        _copy(rows, row.Y, row.BASE, n, lanes)
        _copy(rows, row.Y, row.CANDIDATE, n, lanes)
        _copy(rows, row.SENSITIVITY, row.STAGE_SENSITIVITY, derivatives, lanes)
        for stage in range(2):
            _set_void_ratio(rows, lanes, GAMMA if stage == 0 else 1.0, evolving)
            _solve_stage(rows, lanes, c, t, want_tangent or (estimate and stage == 1))
            if want_tangent:
                add_input_derivative(rows, row.STAGE, lanes, t)
                solve(rows, row.MATRIX, row.STAGE_SENSITIVITY, n, inputs, lanes)
            if stage == 0:
                _begin_second_stage(rows, n, derivatives, lanes)
        if estimate:
            _end_estimate(rows, n, lanes)
        _copy(rows, row.STAGE, row.Y, n, lanes)
        _copy(rows, row.STAGE_SENSITIVITY, row.SENSITIVITY, derivatives, lanes)
        if _all_failed(rows, lanes):
            return


@kernel
def _prepare(rows: Array, n: int, lanes: int, t: Tables) -> int:
    """Measure the increments and clear the estimates; return the largest number of substeps."""
    for lane in range(lanes):
        rows[row.NORM, lane] = 0.0
        rows[row.VOLUME, lane] = 0.0
        rows[row.ESTIMATE, lane] = 0.0
    for i in range(n):
        weight, normal = t.weight[i], t.normal[i]
        for lane in range(lanes):
            d = rows[row.D + i, lane]
            rows[row.WEIGHTED_D + i, lane] = weight * d
            rows[row.NORM, lane] += weight * d * d
            rows[row.VOLUME, lane] += normal * d
    most = 0.0
    for lane in range(lanes):
        norm = sqrt(rows[row.NORM, lane])
        rows[row.NORM, lane] = norm
        rows[row.INVERSE_NORM, lane] = 1.0 / norm if norm > 0.0 else 0.0
        most = max(most, rows[row.SUBSTEPS, lane])
    return int(most)


@kernel
def _begin_substep(rows: Array, lanes: int, step: int) -> None:
    """Place and size of the next substep, which is of no size where all have been made."""
    for lane in range(lanes):
        number = rows[row.SUBSTEPS, lane]
        begin, end = min(float(step), number) / number, min(step + 1.0, number) / number
        rows[row.BEGIN, lane] = begin * begin
        rows[row.SIZE, lane] = end * end - begin * begin
        rows[row.SCALE, lane] = GAMMA * rows[row.SIZE, lane]


@kernel
def _set_void_ratio(rows: Array, lanes: int, part: float, evolving: bool) -> None:
    """The void ratio after a part of the substep, 1 + e(tau) = (1 + e_n) exp(tau volume), and its derivative."""
    for lane in range(lanes):
        time = rows[row.BEGIN, lane] + part * rows[row.SIZE, lane]
        growth = exponential(time * rows[row.VOLUME, lane]) if evolving else 1.0
        e = (1.0 + rows[row.E_N, lane]) * growth - 1.0 if evolving else rows[row.E_N, lane]
        rows[row.E, lane] = e
        rows[row.E_BY_VOLUME, lane] = (1.0 + e) * time if evolving else 0.0


@kernel
def _begin_second_stage(rows: Array, n: int, derivatives: int, lanes: int) -> None:
    """The known part of the second stage; h f(Y_1) is known from the equation of the first."""
    for i in range(n):
        for lane in range(lanes):
            first = rows[row.STAGE + i, lane] - rows[row.Y + i, lane]
            rows[row.BASE + i, lane] = rows[row.Y + i, lane] + _SECOND_BY_FIRST * first
            rows[row.CANDIDATE + i, lane] = rows[row.STAGE + i, lane]
    for k in range(derivatives):
        for lane in range(lanes):
            before = rows[row.SENSITIVITY + k, lane]
            first = rows[row.STAGE_SENSITIVITY + k, lane] - before
            rows[row.STAGE_SENSITIVITY + k, lane] = before + _SECOND_BY_FIRST * first


@kernel
def _begin_estimate(rows: Array, n: int, lanes: int, first: bool, c: KernelConstants, t: Tables) -> None:
    """What an explicit step would add, for the error estimate, where the law was asked last unless it is the first."""
    if first:
        _set_void_ratio(rows, lanes, 0.0, False)
        rate(rows, row.Y, lanes, c, t)
        for lane in range(lanes):
            rows[row.FAILURE, lane] = max(rows[row.FAILURE, lane], rows[row.CODE, lane])
    for i in range(n):
        for lane in range(lanes):
            rows[row.EXPLICIT + i, lane] = rows[row.SIZE, lane] * rows[row.RATE + i, lane]


@kernel
def _end_estimate(rows: Array, n: int, lanes: int) -> None:
    """The error estimate of a substep, filtered with the factors of the second stage."""
    for i in range(n):
        for lane in range(lanes):
            first = (rows[row.BASE + i, lane] - rows[row.Y + i, lane]) / (1.0 - GAMMA)
            last = rows[row.STAGE + i, lane] - rows[row.BASE + i, lane]
            explicit = (1.0 - GAMMA) * rows[row.EXPLICIT + i, lane]
            rows[row.CORRECTION + i, lane] = _ERROR_FACTOR * (first - explicit - last)
    solve(rows, row.MATRIX, row.CORRECTION, n, 1, lanes)
    for i in range(n):
        for lane in range(lanes):
            relative = -abs(rows[row.CORRECTION + i, lane]) * rows[row.INVERSE_TRACE, lane]
            rows[row.ESTIMATE, lane] = max(rows[row.ESTIMATE, lane], relative)


@kernel
def _copy(rows: Array, source: int, target: int, number: int, lanes: int) -> None:
    """Copy so many rows."""
    for k in range(number):
        for lane in range(lanes):
            rows[target + k, lane] = rows[source + k, lane]


@kernel
def _all_failed(rows: Array, lanes: int) -> bool:
    """Whether no point is left to integrate."""
    alive = 0
    for lane in range(lanes):
        alive += rows[row.FAILURE, lane] == _OK
    return alive == 0


@kernel
def _choose(pending: IntArray, points: IntArray, status: CodeArray, substeps: IntArray) -> tuple[IntArray, IntArray]:
    """Which of the pending rows to integrate next, and the others.

    Some that failed are tried first, as all others are of no use if they fail for good. The chosen are in the order of
    their numbers of substeps, so that those who go together have as much to do.
    """
    number, failed = 0, 0
    most = 0
    for at in pending:
        failed += status[points[at]] >= FIRST_FAILURE
        most = max(most, substeps[points[at]])
    number = min(failed, LANES) if failed else len(pending)
    chosen = np.empty(number, np.int32)
    others = np.empty(len(pending) - number, np.int32)
    places = np.zeros(most + 2, np.int32)
    taken = 0
    for k in range(len(pending)):
        at = pending[k]
        if taken < number and (not failed or status[points[at]] >= FIRST_FAILURE):
            places[substeps[points[at]] + 1] += 1
            chosen[taken] = at
            taken += 1
        else:
            others[k - taken] = at
    for k in range(most + 1):
        places[k + 1] += places[k]
    ordered = np.empty(number, np.int32)
    for at in chosen:
        place = substeps[points[at]]
        ordered[places[place]] = at
        places[place] += 1
    return ordered, others


@kernel
def _load(
    rows: Array,
    chosen: IntArray,
    increments: Array,
    points: IntArray,
    forces_n: Array,
    e_n: Array,
    substeps: IntArray,
    c: KernelConstants,
    t: Tables,
) -> None:
    """Put the chosen points into lanes, scaled."""
    driven = len(t.slots)
    for lane in range(len(chosen)):
        at, q = chosen[lane], points[chosen[lane]]
        size = 0.0
        for i in range(len(t.weight)):
            rows[row.Y + i, lane] = forces_n[q, i] / (1.0 if i < t.n_stress else c.d50)
            rows[row.D + i, lane] = 0.0
        for k in range(driven):
            d = increments[at, k] * (1.0 if t.slots[k] < t.n_stress else c.d50)
            rows[row.D + t.slots[k], lane] = d
            size += d * d
        for k in range(t.n_spin):
            rows[row.SPIN + k, lane] = increments[at, driven + k]
            size += increments[at, driven + k] ** 2
        rows[row.E_N, lane] = e_n[q]
        rows[row.SUBSTEPS, lane] = substeps[q]
        rows[row.FAILURE, lane] = _OK if isfinite(size) else _NOT_FINITE


@kernel
def _store(
    rows: Array,
    lane: int,
    q: int,
    e_n: Array,
    forces: Array,
    e: Array,
    tangent: Array,
    evolving: bool,
    want_tangent: bool,
    c: KernelConstants,
    t: Tables,
) -> int:
    """Write what became of a point that was integrated; return its status."""
    driven = len(t.slots)
    trace = 0.0
    for i in range(len(t.weight)):
        y = rows[row.Y + i, lane]
        forces[q, i] = y * (1.0 if i < t.n_stress else c.d50)
        trace += t.normal[i] * y
    e[q] = e_n[q] + (1.0 + e_n[q]) * expm1(rows[row.VOLUME, lane]) if evolving else e_n[q]
    if want_tangent:
        for k in range(driven):
            row_scale = 1.0 if t.slots[k] < t.n_stress else c.d50
            for j in range(driven + t.n_spin):
                scale = row_scale * (c.d50 if j < driven and t.slots[j] >= t.n_stress else 1.0)
                tangent[q, k, j] = scale * rows[row.SENSITIVITY + t.slots[k] * (driven + t.n_spin) + j, lane]
    return _LOOSE if e[q] > c.e_i0 * exp(-((-trace / c.h_s) ** c.n)) else _UPDATED


@kernel
def _store_failure(
    q: int, forces_n: Array, e_n: Array, forces: Array, e: Array, tangent: Array, want_tangent: bool
) -> None:
    """Write the committed values as those of a point that failed."""
    forces[q, :] = forces_n[q, :]
    e[q] = e_n[q]
    if want_tangent:
        tangent[q, :, :] = 0.0


@kernel
def _more_substeps(number: int, failed: bool, estimate: float, tolerance: float) -> int:
    """Number of substeps to try next, from the error estimate of a number or, where it failed, without one."""
    growth = 2.0 if failed else min(4.0, 1.1 * (estimate / tolerance) ** (1.0 / _ORDER_OF_ERROR))
    return max(number + 1, int(growth * number))


@cache
def build_update(layout: Layout, *, spin: bool = True, void_ratio: bool = True) -> Update:
    """The compiled update of a batch of points, specialised for one kind of problem.

    Args:
        layout: components of the problem; polar or classical.
        spin: whether the objective terms are integrated. Which spin (of the displacement gradient or
            of the Cosserat rotation) is the caller's choice: it is an input.
        void_ratio: whether the void ratio evolves; otherwise it stays what it was.

    Returns:
        ``update(increments, points, forces_n, e_n, forces, e, tangent, substeps, status, error, c,
        tolerance, max_substeps, adapt, want_tangent) -> (worst status, its row or -1)`` with

        - increments: (m, inputs) strain, curvature (1/m) and spin increments of m points;
        - points: (m,) the row of each point in the arrays that follow (N rows);
        - forces_n, e_n: (N, n), (N,) committed stress (Pa) with couple stress (N/m), void ratio; read only;
        - forces, e: trial values, written;
        - tangent: (N, driven, inputs) written if ``want_tangent``: derivatives of the forces that are
          conjugate to strains and curvatures with respect to the inputs;
        - substeps: (N,) number of substeps, raised where ``adapt`` and the estimate asks for it;
        - status: (N,) :class:`~cosserat_fx.hypoplasticity.Status` codes, written;
        - error: (N,) largest relative error estimate of a substep, written if ``adapt``;
        - c: :class:`~cosserat_fx.material.KernelConstants`;
        - tolerance: of the estimate, relative to the trace of the stress; max_substeps: its limit.

        Where a point fails, its trial values are its committed ones and its status says why. The row is the first with
        the worst status. Where ``adapt``, a point that fails at the largest number of substeps ends the search of all
        others, whose trial values, status and error may then be those of an attempt or the committed ones.
    """
    return partial(_compiled(), np.zeros((row.NUMBER, LANES)), tables(layout, spin=spin), void_ratio)


@cache
def _compiled() -> Update:
    """The kernel for all layouts and effects, which numba keeps on disk for as long as the sources stay as they are."""
    sources = fingerprint()

    @njit(cache=True, error_model="numpy", nogil=True)
    def update(
        rows: Array,
        t: Tables,
        evolving: bool,
        increments: Array,
        points: IntArray,
        forces_n: Array,
        e_n: Array,
        forces: Array,
        e: Array,
        tangent: Array,
        substeps: IntArray,
        status: CodeArray,
        error: Array,
        c: KernelConstants,
        tolerance: float,
        max_substeps: int,
        adapt: bool,
        want_tangent: bool,
    ) -> tuple[int, int]:
        assert len(sources)  # numba tells kernels by what they use
        for q in points:
            status[q] = _UPDATED
        pending = np.arange(len(points), dtype=np.int32)
        worst, where = _UPDATED, -1
        while len(pending) and not (adapt and worst >= FIRST_FAILURE):
            chosen, others = _choose(pending, points, status, substeps)
            left = 0
            for first in range(0, len(chosen), LANES):
                block = chosen[first : first + LANES]
                _load(rows, block, increments, points, forces_n, e_n, substeps, c, t)
                _integrate(rows, len(block), evolving, adapt, want_tangent, c, t)
                for lane in range(len(block)):
                    at, q = block[lane], points[block[lane]]
                    status[q] = int(rows[row.FAILURE, lane])
                    failed = status[q] != _UPDATED
                    if adapt:
                        error[q] = rows[row.ESTIMATE, lane]
                        if status[q] != _NUMBERLESS and (failed or not error[q] <= tolerance):
                            if substeps[q] < max_substeps:
                                more = _more_substeps(substeps[q], failed, error[q], tolerance)
                                substeps[q] = min(max_substeps, more)
                                chosen[left] = at
                                left += 1
                                continue
                            status[q] = status[q] if failed else _SUBSTEPS
                            failed = True
                    if failed:
                        _store_failure(q, forces_n, e_n, forces, e, tangent, want_tangent)
                    else:
                        status[q] = _store(rows, lane, q, e_n, forces, e, tangent, evolving, want_tangent, c, t)
                    if status[q] > worst or (status[q] == worst > _UPDATED and at < where):
                        worst, where = int(status[q]), at
            pending = np.concatenate((others, chosen[:left]))
        for at in pending:
            _store_failure(points[at], forces_n, e_n, forces, e, tangent, want_tangent)
        return worst, where

    return update


def compile_update(update: Update, layout: Layout, c: KernelConstants) -> None:
    """Compile (or load from the cache) a kernel by calling it for no points at all.

    Compiling on one MPI rank before the others keeps them from racing for numba's cache on disk.
    """
    n, driven, inputs = len(layout.forces), len(layout.strain_slots), layout.n_inputs
    update(
        np.zeros((0, inputs)),
        np.zeros(0, dtype=np.int32),
        np.zeros((0, n)),
        np.zeros(0),
        np.zeros((0, n)),
        np.zeros(0),
        np.zeros((0, driven, inputs)),
        np.zeros(0, dtype=np.int32),
        np.zeros(0, dtype=np.uint8),
        np.zeros(0),
        c,
        0.0,
        1,
        False,
        False,
    )
