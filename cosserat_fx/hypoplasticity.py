r"""The hypoplastic Cosserat rate law at one point, with its derivatives.

Stress and couple stress are treated as one vector. With the mean grain diameter :math:`d_{50}`,
the scaled state is :math:`y = (\sigma, \mu/d_{50})` and the scaled rate is
:math:`d = (D, d_{50}\dot\kappa)`, both in the component order of a :class:`~cosserat_fx.layout.Layout`.
With :math:`T = \sigma_{kk} < 0`, :math:`z = y/T`, :math:`\delta_i = 1` on the normal stresses and 0
elsewhere, and :math:`\alpha_i = a(\hat\sigma)` on stresses, :math:`\alpha_i = a_c` on couple stresses,
equations (1) and (2) of the source paper take one form,

.. math::

    \dot y_i = f_s [\alpha_i^2 d_i + P z_i + f_d \alpha_i N (2 z_i - \delta_i/3)] + (L(W) y)_i,
    \qquad P = z : d, \quad N = \sqrt{d : d},

where :math:`L(W) y` holds the objective terms :math:`W\sigma - \sigma W` and :math:`W\mu - \mu W`.
The Jacobian with respect to *y* is a diagonal, three outer products and *L*, which is how it is
formed below. Every function is compiled into its caller, where the layout's tables are constants.

Sources: equations 1 to 7 of the source paper; the barotropy factor f_b from the consistency condition that
isotropic compression along e_i stays on e_i.
"""

from __future__ import annotations

from enum import IntEnum
from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np

from cosserat_fx.compiled import fingerprint, inline
from cosserat_fx.layout import Layout
from cosserat_fx.material import KernelConstants
from cosserat_fx.typing import Array, IntArray


class Status(IntEnum):
    """What became of a point's update; the larger, the graver."""

    OK = 0
    LOOSER_THAN_E_I = 1
    LOCAL_NEWTON = 2
    SUBSTEPS = 3
    RADICAND = 4
    DENSER_THAN_E_D = 5
    TENSION = 6
    NOT_FINITE = 7


REASONS: dict[Status, str] = {
    Status.OK: "updated",
    Status.LOOSER_THAN_E_I: "the void ratio exceeds e_i, the loosest state the law describes",
    Status.LOCAL_NEWTON: "the local Newton iteration did not converge",
    Status.SUBSTEPS: "the local error estimate stays above its tolerance at the largest number of substeps",
    Status.RADICAND: "the stress left the domain of the critical stress function a(s)",
    Status.DENSER_THAN_E_D: "the void ratio fell below e_d, the densest state the law describes",
    Status.TENSION: "the mean stress is no longer compressive",
    Status.NOT_FINITE: "a strain increment is not a finite number",
}

FIRST_FAILURE = int(Status.LOCAL_NEWTON)
_OK, _RADICAND, _DENSE, _TENSION = (
    int(s) for s in (Status.OK, Status.RADICAND, Status.DENSER_THAN_E_D, Status.TENSION)
)


class Tables(NamedTuple):
    """A layout's tables as small arrays, which become constants of the kernel that captures them.

    Attributes:
        weight: multiplicity of each force component in a contraction.
        normal: 1 for the components 11, 22, 33 of the stress, else 0.
        stress: 1 for stress components, 0 for couple stresses.
        share: part of a stress component that goes to its slot of the symmetric part; 0 for couples.
        symmetric: slot of each stress component in the symmetric order 11, 22, 33, 12, 13, 23.
        slots: force component that is conjugate to each strain and curvature increment.
        spin_row, spin_column, spin_of, spin_sign: the entries of L(W), as
            ``L[row, column] += sign * W[of]``.
        source: digest of the compiled modules; nothing reads it, but numba's cache tells kernels by it.
    """

    weight: Array
    normal: Array
    stress: Array
    share: Array
    symmetric: IntArray
    slots: IntArray
    spin_row: IntArray
    spin_column: IntArray
    spin_of: IntArray
    spin_sign: Array
    source: IntArray


class LawArrays(NamedTuple):
    """Vectors that the rate law fills at one state; made once, used for every point.

    Attributes:
        rate: (n,) dy, with the objective terms (Pa per unit of the rate's time).
        material_rate: (n,) dy without them.
        z: (n,) y over its trace.
        flow: (n,) 2 z - delta/3.
        alpha: (n,) a on stresses, a_c on couple stresses.
        a_by_y: (n,) da/dy (1/Pa).
        deviator, gradient: (6,) argument of a and da with respect to it.
    """

    rate: Array
    material_rate: Array
    z: Array
    flow: Array
    alpha: Array
    a_by_y: Array
    deviator: Array
    gradient: Array


class Point(NamedTuple):
    """Scalars of the rate law at one state, kept from the rate for its derivatives.

    trace is T (Pa), f_s (Pa) the stiffness factor, f_d the density factor, a the critical stress
    function, power is P, norm is N; the rest are derivatives with respect to T (1/Pa) and to e.
    """

    trace: float
    f_s: float
    f_d: float
    a: float
    power: float
    norm: float
    log_f_s_by_trace: float
    log_f_s_by_e: float
    f_d_by_trace: float
    f_d_by_e: float


_SYMMETRIC_SLOT = {(0, 0): 0, (1, 1): 1, (2, 2): 2, (0, 1): 3, (1, 0): 3, (0, 2): 4, (2, 0): 4, (1, 2): 5, (2, 1): 5}


def tables(layout: Layout, *, spin: bool) -> Tables:
    """The kernel's tables for a layout, with the objective terms or without."""
    n_stress = len(layout.stress)
    entries: list[tuple[int, int, int, float]] = []
    groups = ((layout.stress, 0), (layout.couple, n_stress)) if spin else ()
    for components, offset in groups:
        find = {c: offset + k for k, c in enumerate(components)}
        if not layout.polar:
            find |= {(j, i): slot for (i, j), slot in find.items()}
        for i, j in components:
            for k in range(3):
                entries += _spin_entries(layout, find, (i, j), (i, k), (k, j), 1.0)
                entries += _spin_entries(layout, find, (i, j), (k, j), (i, k), -1.0)
    n = len(layout.forces)
    diagonal = np.array([i == j for i, j in layout.forces])
    stress = np.arange(n) < n_stress
    rows, columns, ofs, signs = np.ascontiguousarray(np.array(entries, dtype=np.float64).reshape(-1, 4).T)
    return Tables(
        weight=np.array(layout.weights),
        normal=np.where(stress & diagonal, 1.0, 0.0),
        stress=np.where(stress, 1.0, 0.0),
        share=np.where(stress, np.where(diagonal | (not layout.polar), 1.0, 0.5), 0.0),
        symmetric=np.array([_SYMMETRIC_SLOT[c] for c in layout.forces], dtype=np.int32),
        slots=np.array(layout.strain_slots, dtype=np.int32),
        spin_row=rows.astype(np.int32),
        spin_column=columns.astype(np.int32),
        spin_of=ofs.astype(np.int32),
        spin_sign=signs,
        source=fingerprint(),
    )


def _spin_entries(
    layout: Layout,
    find: dict[tuple[int, int], int],
    row: tuple[int, int],
    spin: tuple[int, int],
    column: tuple[int, int],
    sign: float,
) -> list[tuple[int, int, int, float]]:
    """The entry ``sign * W[spin] * y[column]`` of the component ``row``, if both exist."""
    if column not in find:
        return []
    if spin in layout.spin:
        return [(find[row], find[column], layout.spin.index(spin), sign)]
    if spin[::-1] in layout.spin:
        return [(find[row], find[column], layout.spin.index(spin[::-1]), -sign)]
    return []


@inline
def critical_stress(c_phi: float, deviator: Array, gradient: Array) -> float:
    """The critical stress function a, equation (7), and its gradient.

    Args:
        c_phi: sin(phi_c) / (3 - sin(phi_c)).
        deviator: (6,) symmetric part of sigma/sigma_kk - 1/3, order 11, 22, 33, 12, 13, 23.
        gradient: (6,) receives da/dS as tensor components; zero at the isotropic state, where the
            gradient has no direction.

    Returns:
        a > 0, or -1 where the radicand, its denominator or a itself is not positive, or not a number.
    """
    s11, s22, s33, s12, s13, s23 = deviator[0], deviator[1], deviator[2], deviator[3], deviator[4], deviator[5]
    j2 = s11 * s11 + s22 * s22 + s33 * s33 + 2.0 * (s12 * s12 + s13 * s13 + s23 * s23)
    if j2 < 1e-28:
        gradient[:] = 0.0
        return c_phi * sqrt(8.0 / 3.0)
    q11 = s11 * s11 + s12 * s12 + s13 * s13
    q22 = s12 * s12 + s22 * s22 + s23 * s23
    q33 = s13 * s13 + s23 * s23 + s33 * s33
    q12 = s11 * s12 + s12 * s22 + s13 * s23
    q13 = s11 * s13 + s12 * s23 + s13 * s33
    q23 = s12 * s13 + s22 * s23 + s23 * s33
    j3 = s11 * q11 + s22 * q22 + s33 * q33 + 2.0 * (s12 * q12 + s13 * q13 + s23 * q23)
    lode = j3 / j2
    numerator = 8.0 / 3.0 - 3.0 * (j2 + j3)
    denominator = 1.0 - 3.0 * lode
    if not (numerator > 1e-12 and denominator > 1e-12):
        return -1.0
    root = sqrt(numerator / denominator)
    norm = sqrt(j2)
    if not root > norm:
        return -1.0
    # da = c_phi [ (dnumerator - root^2 ddenominator) / (2 root denominator) - dnorm ]
    half = 0.5 / (root * denominator)
    by_square = c_phi * half * (-9.0 + root * root * 9.0 / j2)
    by_linear = c_phi * (half * (-6.0 - root * root * 6.0 * lode / j2) - 1.0 / norm)
    gradient[0] = by_linear * s11 + by_square * q11
    gradient[1] = by_linear * s22 + by_square * q22
    gradient[2] = by_linear * s33 + by_square * q33
    gradient[3] = by_linear * s12 + by_square * q12
    gradient[4] = by_linear * s13 + by_square * q13
    gradient[5] = by_linear * s23 + by_square * q23
    return c_phi * (root - norm)


@inline
def state_factors(trace: float, e: float, c: KernelConstants) -> tuple[float, float, float, float, float, float]:
    """Stiffness and density factors, equations (4) to (6), with their derivatives.

    Args:
        trace: sigma_kk < 0 (Pa).
        e: void ratio.
        c: the material's constants.

    Returns:
        f_s (Pa), f_d, d ln f_s/dT, d ln f_s/de, d f_d/dT, d f_d/de; f_d = -1 where e <= e_d.
    """
    log_pressure = log(-trace / c.h_s)
    compression = exp(c.n * log_pressure)
    shrink = exp(-compression)
    e_i = c.e_i0 * shrink
    relative = e / shrink - c.e_d0
    if not relative > 1e-12 * c.e_d0:
        return 0.0, -1.0, 0.0, 0.0, 0.0, 0.0
    f_d = exp(c.alpha * log(relative / (c.e_c0 - c.e_d0)))
    f_b = c.h_s / (c.n * c.h_i) * (1.0 + e_i) / e_i * exp((1.0 - c.n) * log_pressure)
    f_s = exp(c.beta * log(e_i / e)) * f_b
    log_shrink_by_trace = -c.n * compression / trace
    log_f_s_by_trace = (c.beta - 1.0 / (1.0 + e_i)) * log_shrink_by_trace + (1.0 - c.n) / trace
    f_d_by_relative = c.alpha * f_d / relative
    return (
        f_s,
        f_d,
        log_f_s_by_trace,
        -c.beta / e,
        -f_d_by_relative * e / shrink * log_shrink_by_trace,
        f_d_by_relative / shrink,
    )


@inline
def rate(
    y: Array, e: float, d: Array, norm: float, w: Array, c: KernelConstants, t: Tables, law: LawArrays
) -> tuple[int, Point]:
    """Rate of the scaled state, equations (1) and (2).

    Args:
        y: (n,) stress and couple stress over d50 (Pa).
        e: void ratio.
        d: (n,) strain rate and d50 times curvature rate, zero where the kinematics allows none.
        norm: N, the norm of d.
        w: spin components, in the layout's order.
        c: the material's constants.
        t: the layout's tables.
        law: receives the rate and what its derivatives need.

    Returns:
        A :class:`Status` code and the scalars that the derivatives need.
    """
    trace = 0.0
    for i in range(len(t.weight)):
        trace += t.normal[i] * y[i]
    nothing = Point(trace, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if not trace < 0.0:
        return _TENSION, nothing
    f_s, f_d, log_f_s_by_trace, log_f_s_by_e, f_d_by_trace, f_d_by_e = state_factors(trace, e, c)
    if f_d < 0.0:
        return _DENSE, nothing
    law.deviator[:] = 0.0
    power = 0.0
    for i in range(len(t.weight)):
        law.z[i] = y[i] / trace
        power += t.weight[i] * law.z[i] * d[i]
        law.deviator[t.symmetric[i]] += t.share[i] * law.z[i] - t.normal[i] / 3.0
    a = critical_stress(c.c_phi, law.deviator, law.gradient)
    if a < 0.0:
        return _RADICAND, nothing
    along = 0.0
    for i in range(len(t.weight)):
        law.a_by_y[i] = t.stress[i] * t.weight[i] * law.gradient[t.symmetric[i]]
        along += law.a_by_y[i] * law.z[i]
    for i in range(len(t.weight)):
        law.a_by_y[i] = (law.a_by_y[i] - along * t.normal[i]) / trace
        law.alpha[i] = t.stress[i] * a + (1.0 - t.stress[i]) * c.a_c
        law.flow[i] = 2.0 * law.z[i] - t.normal[i] / 3.0
        law.material_rate[i] = f_s * (
            law.alpha[i] * law.alpha[i] * d[i] + power * law.z[i] + f_d * law.alpha[i] * norm * law.flow[i]
        )
        law.rate[i] = law.material_rate[i]
    for k in range(len(t.spin_row)):
        law.rate[t.spin_row[k]] += t.spin_sign[k] * w[t.spin_of[k]] * y[t.spin_column[k]]
    return _OK, Point(trace, f_s, f_d, a, power, norm, log_f_s_by_trace, log_f_s_by_e, f_d_by_trace, f_d_by_e)


@inline
def stage_matrix(d: Array, w: Array, scale: float, p: Point, t: Tables, law: LawArrays, matrix: Array) -> None:
    """The matrix 1 - scale * d(rate)/dy of an implicit stage.

    Args:
        d: (n,) scaled strain and curvature rate.
        w: spin components.
        scale: the stage's share of the increment.
        p, law: what :func:`rate` left at the state in question.
        t: the layout's tables.
        matrix: (n, n) overwritten.
    """
    n = len(t.weight)
    for i in range(n):
        by_a = t.stress[i] * p.f_s * (2.0 * p.a * d[i] + p.f_d * p.norm * law.flow[i])
        by_power = p.f_s * law.z[i] / p.trace
        diagonal = p.f_s * (p.power + 2.0 * p.f_d * law.alpha[i] * p.norm) / p.trace
        by_trace = (
            p.log_f_s_by_trace * law.material_rate[i]
            + p.f_s * p.f_d_by_trace * law.alpha[i] * p.norm * law.flow[i]
            - by_power * p.power
            - diagonal * law.z[i]
        )
        for j in range(n):
            entry = by_a * law.a_by_y[j] + by_power * t.weight[j] * d[j] + by_trace * t.normal[j]
            matrix[i, j] = -scale * entry
        matrix[i, i] += 1.0 - scale * diagonal
    for k in range(len(t.spin_row)):
        matrix[t.spin_row[k], t.spin_column[k]] -= scale * t.spin_sign[k] * w[t.spin_of[k]]


@inline
def add_input_derivative(
    y: Array, d: Array, scale: float, e_by_volume: float, p: Point, t: Tables, law: LawArrays, columns: Array
) -> None:
    """Add scale * d(rate)/d(strain, curvature, spin increments) to the columns of a stage.

    Args:
        y: (n,) scaled state.
        d: (n,) scaled strain and curvature increment.
        scale: the stage's share of the increment.
        e_by_volume: derivative of the stage's void ratio with respect to the volume strain.
        p, law: what :func:`rate` left at the state in question.
        t: the layout's tables.
        columns: (n, inputs) added to; inputs in the layout's order, curvatures times d50.
    """
    # At d = 0 the norm has no derivative; the law's linear part alone is the useful tangent there.
    by_norm = 1.0 / p.norm if p.norm > 0.0 else 0.0
    for i in range(len(t.weight)):
        nonlinear = p.f_s * law.alpha[i] * law.flow[i]
        by_e = p.log_f_s_by_e * law.material_rate[i] + p.f_d_by_e * p.norm * nonlinear
        for k in range(len(t.slots)):
            j = t.slots[k]
            columns[i, k] += scale * (
                p.f_s * law.z[i] * t.weight[j] * law.z[j]
                + p.f_d * nonlinear * t.weight[j] * d[j] * by_norm
                + by_e * e_by_volume * t.normal[j]
            )
    for k in range(len(t.slots)):
        j = t.slots[k]
        columns[j, k] += scale * p.f_s * law.alpha[j] * law.alpha[j]
    for k in range(len(t.spin_row)):
        column = len(t.slots) + t.spin_of[k]
        columns[t.spin_row[k], column] += scale * t.spin_sign[k] * y[t.spin_column[k]]
