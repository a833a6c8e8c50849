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
from functools import cache
from math import exp, expm1, isfinite, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from cosserat_fx.compiled import inline
from cosserat_fx.dense import factorise, solve
from cosserat_fx.hypoplasticity import (
    FIRST_FAILURE,
    LawArrays,
    Point,
    Status,
    Tables,
    add_input_derivative,
    rate,
    stage_matrix,
    tables,
)
from cosserat_fx.layout import Layout
from cosserat_fx.material import KernelConstants
from cosserat_fx.typing import Array, CodeArray, IntArray

GAMMA = 1.0 - 1.0 / sqrt(2.0)
_ERROR_FACTOR = 2.0 / 3.0

# A Newton correction of this size, relative to the trace of the stress, leaves an error of its square.
_NEWTON_TOLERANCE = 1e-10
_NEWTON_ITERATIONS = 25
_NEWTON_HALVINGS = 12
_PRESSURE_DOUBLINGS = 10
_ORDER_OF_ERROR = 3.0

_OK = int(Status.OK)
_LOOSE = int(Status.LOOSER_THAN_E_I)
_LOCAL_NEWTON = int(Status.LOCAL_NEWTON)
_DENSE = int(Status.DENSER_THAN_E_D)
_SUBSTEPS = int(Status.SUBSTEPS)
_NOT_FINITE = int(Status.NOT_FINITE)

Update = Callable[..., tuple[int, int]]


class Work(NamedTuple):
    """Arrays that one call of the kernel makes once and uses for every point.

    Attributes:
        law: arrays of the rate law.
        d, w: scaled strain and curvature increment (n,), spin increment.
        y, base, stage, candidate: states (n,) of a substep.
        known_error: (n,) the error estimate's terms from the start and the first stage.
        correction: (n, 1) of Newton's method, and the error estimate.
        matrix, pivots: stage matrix (n, n) and its row exchanges.
        sensitivity, stage_sensitivity: (n, inputs) derivatives of y and of the stage.
    """

    law: LawArrays
    d: Array
    w: Array
    y: Array
    base: Array
    stage: Array
    candidate: Array
    known_error: Array
    correction: Array
    matrix: Array
    pivots: IntArray
    sensitivity: Array
    stage_sensitivity: Array


@njit(error_model="numpy")
def make_work(n: int, n_driven: int, n_spin: int) -> Work:
    """Allocate the kernel's arrays for n force components, n_driven strains and curvatures, n_spin spins."""
    inputs = n_driven + n_spin
    law = LawArrays(
        np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(6), np.zeros(6)
    )
    return Work(
        law,
        np.zeros(n),
        np.zeros(max(n_spin, 1)),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros((n, 1)),
        np.zeros((n, n)),
        np.zeros(n, dtype=np.int32),
        np.zeros((n, inputs)),
        np.zeros((n, inputs)),
    )


@inline
def _solve_stage(work: Work, e: float, norm: float, scale: float, c: KernelConstants, t: Tables) -> tuple[int, Point]:
    """Newton's method for ``stage = base + scale f(stage)`` from the guess in ``work.stage``.

    A guess denser than e_d, as in compression near it, is given a pressure at which it is not. Corrections that leave
    the law's domain are halved. On success the law's arrays are those of the solution and the factors of the stage
    matrix those of the iterate before it, which is as near as the tolerance.

    Returns:
        A status code and the law's scalars at the last admissible iterate.
    """
    n = len(t.weight)
    code, p = rate(work.stage, e, work.d, norm, work.w, c, t, work.law)
    for _ in range(_PRESSURE_DOUBLINGS):
        if code != _DENSE:
            break
        for i in range(n):
            work.stage[i] *= 2.0
        code, p = rate(work.stage, e, work.d, norm, work.w, c, t, work.law)
    if code != _OK:
        return code, p
    for _ in range(_NEWTON_ITERATIONS):
        for i in range(n):
            work.correction[i, 0] = work.base[i] + scale * work.law.rate[i] - work.stage[i]
        stage_matrix(work.d, work.w, scale, p, t, work.law, work.matrix)
        if not factorise(work.matrix, work.pivots, n):
            return _LOCAL_NEWTON, p
        solve(work.matrix, work.pivots, work.correction, n, 1)
        damping = 1.0
        for _ in range(_NEWTON_HALVINGS):
            for i in range(n):
                work.candidate[i] = work.stage[i] + damping * work.correction[i, 0]
            code, p = rate(work.candidate, e, work.d, norm, work.w, c, t, work.law)
            if code == _OK:
                break
            damping *= 0.5
        if code != _OK:
            return code, p
        work.stage[:] = work.candidate
        converged = damping == 1.0
        for i in range(n):
            converged = converged and abs(work.correction[i, 0]) <= -_NEWTON_TOLERANCE * p.trace
        if converged:
            return _OK, p
    return _LOCAL_NEWTON, p


@inline
def _integrate(
    work: Work,
    n_spin: int,
    e_n: float,
    evolving: bool,
    substeps: int,
    estimate: bool,
    want_tangent: bool,
    c: KernelConstants,
    t: Tables,
) -> tuple[int, float]:
    """Advance ``work.y`` over the increment in ``work.d``, ``work.w`` by a number of substeps.

    Returns:
        A status code and the largest error estimate of a substep, relative to the trace of the stress
        (0 where no estimate is asked for).
    """
    n = len(t.weight)
    inputs = len(t.slots) + n_spin
    norm = 0.0
    volume = 0.0
    for i in range(n):
        norm += t.weight[i] * work.d[i] * work.d[i]
        volume += t.normal[i] * work.d[i]
    norm = sqrt(norm)
    work.sensitivity[:] = 0.0
    worst = 0.0
    for step in range(substeps):
        begin = (step / substeps) ** 2
        h = ((step + 1) / substeps) ** 2 - begin
        if estimate:
            e = e_n + (1.0 + e_n) * expm1(begin * volume) if evolving else e_n
            code, p = rate(work.y, e, work.d, norm, work.w, c, t, work.law)
            if code != _OK:
                return code, worst
            for i in range(n):
                work.known_error[i] = -_ERROR_FACTOR * (1.0 - GAMMA) * h * work.law.rate[i]
        work.base[:] = work.y
        work.stage[:] = work.y
        work.stage_sensitivity[:] = work.sensitivity
        for stage in range(2):
            time = begin + (GAMMA if stage == 0 else 1.0) * h
            e = e_n + (1.0 + e_n) * expm1(time * volume) if evolving else e_n
            code, p = _solve_stage(work, e, norm, GAMMA * h, c, t)
            if code != _OK:
                return code, worst
            if want_tangent:
                e_by_volume = (1.0 + e) * time if evolving else 0.0
                add_input_derivative(work.stage, work.d, GAMMA * h, e_by_volume, p, t, work.law, work.stage_sensitivity)
                solve(work.matrix, work.pivots, work.stage_sensitivity, n, inputs)
            if stage == 0:
                # h f(Y_1) is known from the stage equation itself.
                ratio = (1.0 - GAMMA) / GAMMA
                for i in range(n):
                    first = work.stage[i] - work.y[i]
                    work.base[i] = work.y[i] + ratio * first
                    work.known_error[i] += _ERROR_FACTOR / GAMMA * first
                if want_tangent:
                    for i in range(n):
                        for k in range(inputs):
                            before = work.sensitivity[i, k]
                            work.stage_sensitivity[i, k] = before + ratio * (work.stage_sensitivity[i, k] - before)
        if estimate:
            for i in range(n):
                work.correction[i, 0] = work.known_error[i] - _ERROR_FACTOR * (work.stage[i] - work.base[i])
            solve(work.matrix, work.pivots, work.correction, n, 1)
            for i in range(n):
                worst = max(worst, -abs(work.correction[i, 0]) / p.trace)
        work.y[:] = work.stage
        work.sensitivity[:] = work.stage_sensitivity
    return _OK, worst


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

        Where a point fails, its trial values are its committed ones and its status says why. Where ``adapt``, the
        points after it keep the number of substeps they have, so their status and error mean little; the worst
        status and its row are then those of the point that failed first.
    """
    t = tables(layout, spin=spin)
    n = len(layout.forces)
    n_stress = len(layout.stress)
    n_driven = len(layout.strain_slots)
    n_spin = len(layout.spin)

    @njit(cache=True, error_model="numpy", nogil=True)
    def update(
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
        work = make_work(n, n_driven, n_spin)
        worst = 0
        where = -1
        for row in range(len(points)):
            q = points[row]
            size = 0.0
            work.d[:] = 0.0
            for k in range(n_driven):
                length = 1.0 if t.slots[k] < n_stress else c.d50
                work.d[t.slots[k]] = length * increments[row, k]
                size += work.d[t.slots[k]] ** 2
            for k in range(n_spin):
                work.w[k] = increments[row, n_driven + k]
                size += work.w[k] ** 2
            number = substeps[q]
            finite = isfinite(size)
            code = _OK if finite else _NOT_FINITE
            while finite:
                for i in range(n):
                    work.y[i] = forces_n[q, i] / (1.0 if i < n_stress else c.d50)
                code, estimate = _integrate(work, n_spin, e_n[q], void_ratio, number, adapt, want_tangent, c, t)
                if not adapt:
                    break
                error[q] = estimate
                if code == _OK and estimate <= tolerance:
                    break
                if number >= max_substeps:
                    code = _SUBSTEPS if code == _OK else code
                    break
                if worst >= FIRST_FAILURE:
                    break  # another point has failed already, and with it all that this one could be used for
                growth = 2.0
                if code == _OK:
                    growth = min(4.0, 1.1 * (estimate / tolerance) ** (1.0 / _ORDER_OF_ERROR))
                number = min(max_substeps, max(number + 1, int(growth * number)))
            substeps[q] = number
            if code == _OK:
                volume = 0.0
                for i in range(n):
                    forces[q, i] = work.y[i] * (1.0 if i < n_stress else c.d50)
                    volume += t.normal[i] * work.d[i]
                e[q] = e_n[q] + (1.0 + e_n[q]) * expm1(volume) if void_ratio else e_n[q]
                trace = 0.0
                for i in range(n):
                    trace += t.normal[i] * work.y[i]
                if e[q] > c.e_i0 * exp(-((-trace / c.h_s) ** c.n)):
                    code = _LOOSE
                if want_tangent:
                    for k in range(n_driven):
                        row_scale = 1.0 if t.slots[k] < n_stress else c.d50
                        for j in range(n_driven + n_spin):
                            column_scale = row_scale
                            if j < n_driven and t.slots[j] >= n_stress:
                                column_scale *= c.d50
                            tangent[q, k, j] = column_scale * work.sensitivity[t.slots[k], j]
            else:
                forces[q, :] = forces_n[q, :]
                e[q] = e_n[q]
                if want_tangent:
                    tangent[q, :, :] = 0.0
            status[q] = code
            if code > worst and not (adapt and worst >= FIRST_FAILURE):
                worst = code
                where = row
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
