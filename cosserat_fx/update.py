"""The constitutive update of a batch of points: from committed state and increment to trial state and tangent.

Points are integrated in blocks that lie side by side in lanes (:mod:`cosserat_fx.rows`). Those whose error estimate
is too large, or which fail, are integrated again with more substeps, together with others of their kind.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from math import exp, expm1, isfinite

import numpy as np
from numba import njit

from cosserat_fx import rows as row
from cosserat_fx.compiled import fingerprint, kernel
from cosserat_fx.hypoplasticity import FIRST_FAILURE, Status
from cosserat_fx.integration import integrate
from cosserat_fx.layout import Layout
from cosserat_fx.material import KernelConstants
from cosserat_fx.rows import LANES
from cosserat_fx.tables import Tables, tables
from cosserat_fx.typing import Array, CodeArray, IntArray

_ORDER_OF_ERROR = 3.0

_OK = float(Status.OK)
_NOT_FINITE = float(Status.NOT_FINITE)
_UPDATED, _LOOSE, _SUBSTEPS, _NUMBERLESS = (
    int(s) for s in (Status.OK, Status.LOOSER_THAN_E_I, Status.SUBSTEPS, Status.NOT_FINITE)
)

Update = Callable[..., tuple[int, int]]


@kernel
def _choose(pending: IntArray, points: IntArray, status: CodeArray, substeps: IntArray) -> tuple[IntArray, IntArray]:
    """Which of the pending rows to integrate next, and the others.

    Some that failed are tried first, as all others are of no use if they fail for good. The chosen are in the order of
    their numbers of substeps, so that those who go together have as much to do.
    """
    failed, most = 0, 0
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
    """The compiled update of a batch of points for one kind of problem; its working memory is for one caller at a time.

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

    @njit(cache=True, error_model="numpy")
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
                integrate(rows, len(block), evolving, adapt, want_tangent, c, t)
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
