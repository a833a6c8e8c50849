r"""The hypoplastic Cosserat rate law, with its derivatives.

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
formed below.

Points are treated side by side in the lanes of a block: every quantity is a row of numbers, one for each lane, and the
innermost loops run over lanes and do not branch, so that the compiler makes vector instructions of them. Every function
is compiled into its caller, where the layout's tables and the places of the rows are constants.

Sources: equations 1 to 7 of the source paper; the barotropy factor f_b from the consistency condition that
isotropic compression along e_i stays on e_i.
"""

from __future__ import annotations

from enum import IntEnum
from math import sqrt

from cosserat_fx import rows as row
from cosserat_fx.compiled import inline, kernel
from cosserat_fx.elementary import exponential, logarithm
from cosserat_fx.material import KernelConstants
from cosserat_fx.tables import Tables
from cosserat_fx.typing import Array


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
    float(s) for s in (Status.OK, Status.RADICAND, Status.DENSER_THAN_E_D, Status.TENSION)
)


@inline
def critical_stress(
    c_phi: float, s11: float, s22: float, s33: float, s12: float, s13: float, s23: float
) -> tuple[float, float, float, float, float, float, float]:
    """The critical stress function a, equation (7), and its gradient.

    Args:
        c_phi: sin(phi_c) / (3 - sin(phi_c)).
        s11, s22, s33, s12, s13, s23: symmetric part of sigma/sigma_kk - 1/3.

    Returns:
        a > 0, or -1 where the radicand, its denominator or a itself is not positive, or not a number; and da/dS as
        tensor components, in the order of the arguments: zero at the isotropic state, where it has no direction.
    """
    j2 = s11 * s11 + s22 * s22 + s33 * s33 + 2.0 * (s12 * s12 + s13 * s13 + s23 * s23)
    q11 = s11 * s11 + s12 * s12 + s13 * s13
    q22 = s12 * s12 + s22 * s22 + s23 * s23
    q33 = s13 * s13 + s23 * s23 + s33 * s33
    q12 = s11 * s12 + s12 * s22 + s13 * s23
    q13 = s11 * s13 + s12 * s23 + s13 * s33
    q23 = s12 * s13 + s22 * s23 + s23 * s33
    j3 = s11 * q11 + s22 * q22 + s33 * q33 + 2.0 * (s12 * q12 + s13 * q13 + s23 * q23)
    isotropic = j2 < 1e-28
    directed = 0.0 if isotropic else 1.0
    by_j2 = 1.0 / (1.0 if isotropic else j2)
    lode = directed * j3 * by_j2
    numerator = 8.0 / 3.0 - 3.0 * (j2 + j3)
    denominator = 1.0 - 3.0 * lode
    root = sqrt(numerator / denominator)
    norm = directed * sqrt(j2)
    valid = (numerator > 1e-12) & (denominator > 1e-12) & (root > norm)
    # da = c_phi [ (dnumerator - root^2 ddenominator) / (2 root denominator) - dnorm ]
    half = 0.5 / (root * denominator)
    by_square = directed * c_phi * half * (-9.0 + root * root * 9.0 * by_j2)
    by_linear = directed * c_phi * (half * (-6.0 - root * root * 6.0 * lode * by_j2) - norm * by_j2)
    return (
        c_phi * (root - norm) if valid else -1.0,
        by_linear * s11 + by_square * q11,
        by_linear * s22 + by_square * q22,
        by_linear * s33 + by_square * q33,
        by_linear * s12 + by_square * q12,
        by_linear * s13 + by_square * q13,
        by_linear * s23 + by_square * q23,
    )


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
    hardness = -trace / c.h_s
    compression = exponential(c.n * logarithm(hardness))
    expand = exponential(compression)
    e_i = c.e_i0 / expand
    relative = e * expand - c.e_d0
    valid = relative > 1e-12 * c.e_d0
    relative = relative if valid else c.e_d0
    f_d = exponential(c.alpha * logarithm(relative / (c.e_c0 - c.e_d0)))
    f_b = c.h_s / (c.n * c.h_i) * (1.0 + e_i) / e_i * hardness / compression
    f_s = exponential(c.beta * logarithm(e_i / e)) * f_b
    log_shrink_by_trace = -c.n * compression / trace
    log_f_s_by_trace = (c.beta - 1.0 / (1.0 + e_i)) * log_shrink_by_trace + (1.0 - c.n) / trace
    f_d_by_relative = c.alpha * f_d / relative
    return (
        f_s,
        f_d if valid else -1.0,
        log_f_s_by_trace,
        -c.beta / e,
        -f_d_by_relative * e * expand * log_shrink_by_trace,
        f_d_by_relative * expand,
    )


@kernel
def rate(rows: Array, y: int, lanes: int, c: KernelConstants, t: Tables) -> None:
    """Rate of the scaled state of every point, equations (1) and (2), with what its derivatives need.

    Where the law does not describe a state, its code is not OK and all else that is said of it means nothing.

    Args:
        rows: (rows, LANES) hold the void ratio, the increments of strain, curvature and spin, and the states.
        y: first row of the states: stress and couple stress over d50 (Pa).
        lanes: number of points.
        c: the material's constants.
        t: the layout's tables.
    """
    n = len(t.weight)
    for lane in range(lanes):
        rows[row.TRACE, lane] = 0.0
        rows[row.POWER, lane] = 0.0
        rows[row.ALONG, lane] = 0.0
    for slot in range(6):
        for lane in range(lanes):
            rows[row.DEVIATOR + slot, lane] = 0.0
    for i in t.normals:
        for lane in range(lanes):
            rows[row.TRACE, lane] += rows[y + i, lane]
    for lane in range(lanes):
        trace = rows[row.TRACE, lane]
        compressed = trace < 0.0
        trace = trace if compressed else -1.0
        f_s, f_d, log_f_s_by_trace, log_f_s_by_e, f_d_by_trace, f_d_by_e = state_factors(trace, rows[row.E, lane], c)
        dense = _DENSE if f_d < 0.0 else _OK
        rows[row.CODE, lane] = dense if compressed else _TENSION
        rows[row.TRACE, lane] = trace
        rows[row.INVERSE_TRACE, lane] = 1.0 / trace
        rows[row.F_S, lane] = f_s
        rows[row.F_D, lane] = f_d
        rows[row.LOG_F_S_BY_TRACE, lane] = log_f_s_by_trace
        rows[row.LOG_F_S_BY_E, lane] = log_f_s_by_e
        rows[row.F_D_BY_TRACE, lane] = f_d_by_trace
        rows[row.F_D_BY_E, lane] = f_d_by_e
    for i in range(n):
        third = t.normal[i] / 3.0
        for lane in range(lanes):
            z = rows[y + i, lane] * rows[row.INVERSE_TRACE, lane]
            rows[row.Z + i, lane] = z
            rows[row.FLOW + i, lane] = 2.0 * z - third
            rows[row.POWER, lane] += z * rows[row.WEIGHTED_D + i, lane]
    for i in range(t.n_stress):
        slot, share, third = row.DEVIATOR + t.symmetric[i], t.share[i], t.normal[i] / 3.0
        for lane in range(lanes):
            rows[slot, lane] += share * rows[row.Z + i, lane] - third
    for lane in range(lanes):
        a, a11, a22, a33, a12, a13, a23 = critical_stress(
            c.c_phi,
            rows[row.DEVIATOR, lane],
            rows[row.DEVIATOR + 1, lane],
            rows[row.DEVIATOR + 2, lane],
            rows[row.DEVIATOR + 3, lane],
            rows[row.DEVIATOR + 4, lane],
            rows[row.DEVIATOR + 5, lane],
        )
        code = rows[row.CODE, lane]
        rows[row.CODE, lane] = _RADICAND if (a < 0.0) & (code == _OK) else code
        rows[row.A, lane] = a
        rows[row.GRADIENT, lane] = a11
        rows[row.GRADIENT + 1, lane] = a22
        rows[row.GRADIENT + 2, lane] = a33
        rows[row.GRADIENT + 3, lane] = a12
        rows[row.GRADIENT + 4, lane] = a13
        rows[row.GRADIENT + 5, lane] = a23
    for i in range(t.n_stress):
        slot, weight = row.GRADIENT + t.symmetric[i], t.weight[i]
        for lane in range(lanes):
            rows[row.ALONG, lane] += weight * rows[slot, lane] * rows[row.Z + i, lane]
    for i in range(t.n_stress):
        slot, weight, normal = row.GRADIENT + t.symmetric[i], t.weight[i], t.normal[i]
        for lane in range(lanes):
            by_z = weight * rows[slot, lane] - normal * rows[row.ALONG, lane]
            rows[row.A_BY_Y + i, lane] = by_z * rows[row.INVERSE_TRACE, lane]
    for i in range(n):
        of_stress = i < t.n_stress
        for lane in range(lanes):
            alpha = rows[row.A, lane] if of_stress else c.a_c
            nonlinear = rows[row.F_D, lane] * alpha * rows[row.NORM, lane] * rows[row.FLOW + i, lane]
            linear = alpha * alpha * rows[row.D + i, lane] + rows[row.POWER, lane] * rows[row.Z + i, lane]
            rows[row.ALPHA + i, lane] = alpha
            rows[row.MATERIAL_RATE + i, lane] = rows[row.F_S, lane] * (linear + nonlinear)
            rows[row.RATE + i, lane] = rows[row.F_S, lane] * (linear + nonlinear)
    for k in range(len(t.spin_row)):
        to, turned, spin, sign = row.RATE + t.spin_row[k], y + t.spin_column[k], row.SPIN + t.spin_of[k], t.spin_sign[k]
        for lane in range(lanes):
            rows[to, lane] += sign * rows[spin, lane] * rows[turned, lane]


@kernel
def stage_matrix(rows: Array, lanes: int, t: Tables) -> None:
    """The matrix 1 - scale * d(rate)/dy of an implicit stage, at the state where :func:`rate` was asked last.

    Args:
        rows: (rows, LANES) hold the increments, the scale and what the law said; the matrix is written.
        lanes: number of points.
        t: the layout's tables.
    """
    n = len(t.weight)
    for i in range(n):
        of_stress = 1.0 if i < t.n_stress else 0.0
        for lane in range(lanes):
            factor = -rows[row.SCALE, lane] * rows[row.F_S, lane]
            rest = -rows[row.SCALE, lane] * rows[row.LOG_F_S_BY_TRACE, lane] * rows[row.MATERIAL_RATE + i, lane]
            norm, inverse_trace = rows[row.NORM, lane], rows[row.INVERSE_TRACE, lane]
            z, alpha, flow = rows[row.Z + i, lane], rows[row.ALPHA + i, lane], rows[row.FLOW + i, lane]
            power, f_d = rows[row.POWER, lane], rows[row.F_D, lane]
            by_power = factor * z * inverse_trace
            diagonal = factor * (power + 2.0 * f_d * norm * alpha) * inverse_trace
            by_trace = rest + factor * rows[row.F_D_BY_TRACE, lane] * norm * alpha * flow
            rows[row.BY_A, lane] = of_stress * factor * (2.0 * alpha * rows[row.D + i, lane] + f_d * norm * flow)
            rows[row.BY_POWER, lane] = by_power
            rows[row.BY_TRACE, lane] = by_trace - by_power * power - diagonal * z
            rows[row.DIAGONAL, lane] = 1.0 + diagonal
        for j in range(n):
            entry = row.MATRIX + i * n + j
            for lane in range(lanes):
                rows[entry, lane] = rows[row.BY_POWER, lane] * rows[row.WEIGHTED_D + j, lane]
        for j in range(t.n_stress):
            entry = row.MATRIX + i * n + j
            for lane in range(lanes):
                rows[entry, lane] += rows[row.BY_A, lane] * rows[row.A_BY_Y + j, lane]
        for j in t.normals:
            entry = row.MATRIX + i * n + j
            for lane in range(lanes):
                rows[entry, lane] += rows[row.BY_TRACE, lane]
        entry = row.MATRIX + i * n + i
        for lane in range(lanes):
            rows[entry, lane] += rows[row.DIAGONAL, lane]
    for k in range(len(t.spin_row)):
        entry, spin, sign = row.MATRIX + t.spin_row[k] * n + t.spin_column[k], row.SPIN + t.spin_of[k], t.spin_sign[k]
        for lane in range(lanes):
            rows[entry, lane] -= rows[row.SCALE, lane] * sign * rows[spin, lane]


@kernel
def add_input_derivative(rows: Array, y: int, lanes: int, t: Tables) -> None:
    """Add scale * d(rate)/d(strain, curvature, spin increments) to the sensitivities of a stage.

    At a zero increment the norm has no derivative; the law's linear part alone is the useful tangent there.

    Args:
        rows: (rows, LANES) hold the increments, the scale, the void ratio's derivative and what :func:`rate` said last;
            the stage's sensitivities, with inputs in the layout's order and curvatures times d50, are added to.
        y: first row of the states that it was asked at.
        lanes: number of points.
        t: the layout's tables.
    """
    n, driven = len(t.weight), len(t.slots)
    inputs = driven + t.n_spin
    for i in range(n):
        for lane in range(lanes):
            f_s, alpha = rows[row.F_S, lane] * rows[row.SCALE, lane], rows[row.ALPHA + i, lane]
            nonlinear = f_s * alpha * rows[row.FLOW + i, lane]
            log_f_s_by_e = rows[row.LOG_F_S_BY_E, lane] * rows[row.SCALE, lane]
            by_e = log_f_s_by_e * rows[row.MATERIAL_RATE + i, lane]
            by_e += rows[row.F_D_BY_E, lane] * rows[row.NORM, lane] * nonlinear
            rows[row.BY_TRACE, lane] = by_e * rows[row.E_BY_VOLUME, lane]
            rows[row.BY_POWER, lane] = f_s * rows[row.Z + i, lane]
            rows[row.BY_A, lane] = rows[row.F_D, lane] * nonlinear * rows[row.INVERSE_NORM, lane]
            rows[row.DIAGONAL, lane] = f_s * alpha * alpha
        for k in range(driven):
            column, j = row.STAGE_SENSITIVITY + i * inputs + k, t.slots[k]
            weight = t.weight[j]
            for lane in range(lanes):
                along = weight * rows[row.BY_POWER, lane] * rows[row.Z + j, lane]
                rows[column, lane] += along + rows[row.BY_A, lane] * rows[row.WEIGHTED_D + j, lane]
            if t.normal[j] > 0.0:
                for lane in range(lanes):
                    rows[column, lane] += rows[row.BY_TRACE, lane]
            if i == j:
                for lane in range(lanes):
                    rows[column, lane] += rows[row.DIAGONAL, lane]
    for k in range(len(t.spin_row)):
        column = row.STAGE_SENSITIVITY + t.spin_row[k] * inputs + driven + t.spin_of[k]
        turned, sign = y + t.spin_column[k], t.spin_sign[k]
        for lane in range(lanes):
            rows[column, lane] += rows[row.SCALE, lane] * sign * rows[turned, lane]
