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

from math import inf, sqrt

from cosserat_fx import rows as row
from cosserat_fx.compiled import kernel
from cosserat_fx.dense import solve
from cosserat_fx.elementary import exponential
from cosserat_fx.hypoplasticity import Status, add_input_derivative, rate
from cosserat_fx.material import KernelConstants
from cosserat_fx.stages import mark_lost, solve_stage
from cosserat_fx.tables import Tables
from cosserat_fx.typing import Array

GAMMA = 1.0 - 1.0 / sqrt(2.0)
_SECOND_BY_FIRST = (1.0 - GAMMA) / GAMMA
_ERROR_FACTOR = 2.0 / 3.0

_OK, _LOCAL_NEWTON = float(Status.OK), float(Status.LOCAL_NEWTON)


@kernel
def integrate(
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
            solve_stage(rows, lanes, c, t, want_tangent or (estimate and stage == 1))
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
    mark_lost(rows, row.SENSITIVITY, derivatives, lanes)
    for lane in range(lanes):
        lost, failure = rows[row.ALONG, lane] != 0.0, rows[row.FAILURE, lane]
        rows[row.FAILURE, lane] = max(failure, _LOCAL_NEWTON) if lost else failure


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
    mark_lost(rows, row.CORRECTION, n, lanes)
    for lane in range(lanes):
        rows[row.ESTIMATE, lane] = inf if rows[row.ALONG, lane] != 0.0 else rows[row.ESTIMATE, lane]
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
