r"""Work of the stresses over one step, point by point, from committed and trial stresses and the law's own increments.

The nodal forces work by the trapezoidal rule, half of those at the start and half of those at the end of a step times
the displacements in it. At a point that is, per initial volume,

.. math::

    \tfrac12 (\sigma_n + \sigma) : \Delta\epsilon\, J_m + \tfrac12 (\mu_n + \mu) : \Delta\kappa\, J_m + c ,

the work on the increments that the law has seen, and a term *c* of third order in the step, which stands for the change
of the geometry. In a layer and a plane the cofactors of F are linear in F, and *c* has a closed form. With
:math:`L = \nabla(\Delta u) F_m^{-1}` and :math:`\mathrm{adj}\, F = J F^{-1}` it is

.. math::

    c = & \tfrac14 (\sigma - \sigma_n)_{\alpha\alpha} J_m \det L
      + \tfrac12 [\sigma_n (J_n - J_m) + \sigma (J - J_m)] : E(\Delta w) \\
      & + \tfrac12 \Delta\kappa F_m : [\mu_n\, \mathrm{adj}(F_n - F_m)^T + \mu\, \mathrm{adj}(F - F_m)^T] .

**What is not dissipated.** Hypoplasticity has no stored energy. Its rate is the sum of a linear and a non-linear part,
:math:`\dot y = \mathcal L d + N b`, :math:`\mathcal L = f_s (A + z \otimes z)`. The work on the strain that the linear
part alone would need for the change of stress, :math:`y : \mathcal L^{-1} \dot y`, is called recoverable. What is left,

.. math::

    y : (d - \mathcal L^{-1} \dot y) = -\sigma_{kk} f_d N\,
        \frac{(2 \hat\sigma : \hat\sigma - 1/3)/a + 2 \hat\mu : \hat\mu / a_c}
             {1 + \hat\sigma : \hat\sigma / a^2 + \hat\mu : \hat\mu / a_c^2} ,

is positive in every state, as :math:`\hat\sigma : \hat\sigma \ge 1/3`; it is called dissipated. The recoverable part is
summed along the straight line between both stresses, with the law's stiffness in its middle. Objective terms add
nothing to it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import log

import numpy as np
from numba import njit

from cosserat_fx.compiled import fingerprint
from cosserat_fx.hypoplasticity import critical_stress, state_factors
from cosserat_fx.layout import Component, Layout
from cosserat_fx.material import KernelConstants
from cosserat_fx.tables import tables
from cosserat_fx.typing import Array, IntArray

Power = Callable[..., tuple[float, float, float]]


@cache
def build_power(layout: Layout, *, finite: bool) -> Power:
    """The compiled sums over the points of a layer or a plane, specialised for one kind of problem.

    Args:
        layout: components of the problem.
        finite: whether increments are those of the deforming configuration.

    Returns:
        ``power(increments, points, forces_n, e_n, forces, e, before, after, weights, c) -> (work, recoverable, rule)``

        - increments: (m, inputs) strain, curvature (1/m) and spin increments of m points;
        - points: (m,) the row of each point in the arrays that follow (N rows);
        - forces_n, e_n: (N, n), (N,) committed stress (Pa) with couple stress (N/m), void ratio;
        - forces, e: their trial values, about to be committed;
        - before, after: (m, 4) displacement gradients 11, 12, 21, 22 at the start and at the end of the step;
        - weights: (m,) initial volume of each point (m in a layer, m2 in a plane);
        - c: :class:`~cosserat_fx.material.KernelConstants`;
        - work, recoverable: as above (J/m2 in a layer, J/m in a plane);
        - rule: the largest difference of any point between log(J/J_n) and the law's own change of log(1 + e),
          (J - J_n)/J_m. Of small strains both are the trace of the increment, and it is 0.
    """
    t, sources = tables(layout, spin=False), fingerprint()
    n, n_stress, n_strain, n_driven = (
        len(layout.forces),
        len(layout.stress),
        len(layout.strain),
        len(layout.strain_slots),
    )
    polar = layout.polar
    s11, s22 = layout.stress_index(0, 0), layout.stress_index(1, 1)
    s12, s21 = layout.stress_index(0, 1), layout.stress_index(1, 0)
    strain_12 = layout.strain.index((0, 1))
    m31, m32 = (_position(layout.couple, n_stress, (2, k)) for k in (0, 1))
    k31, k32 = (_position(layout.curvature, n_strain, (2, k)) for k in (0, 1))

    @njit(cache=True, error_model="numpy", nogil=True)
    def power(
        increments: Array,
        points: IntArray,
        forces_n: Array,
        e_n: Array,
        forces: Array,
        e: Array,
        before: Array,
        after: Array,
        weights: Array,
        c: KernelConstants,
    ) -> tuple[float, float, float]:
        assert len(sources)  # numba tells compiled functions by what they use
        deviator = np.zeros(6)
        z = np.zeros(n)
        work = 0.0
        recoverable = 0.0
        worst = 0.0
        for row in range(len(points)):
            q = points[row]
            y_n, y, d = forces_n[q], forces[q], increments[row]
            density = 0.0
            for k in range(n_driven):
                slot = t.slots[k]
                density += 0.5 * t.weight[slot] * (y_n[slot] + y[slot]) * d[k]
            middle = 1.0
            if finite:
                a11, a12, a21, a22 = 1.0 + before[row, 0], before[row, 1], before[row, 2], 1.0 + before[row, 3]
                b11, b12, b21, b22 = 1.0 + after[row, 0], after[row, 1], after[row, 2], 1.0 + after[row, 3]
                j_n = a11 * a22 - a12 * a21
                j = b11 * b22 - b12 * b21
                f11, f12, f21, f22 = 0.5 * (a11 + b11), 0.5 * (a12 + b12), 0.5 * (a21 + b21), 0.5 * (a22 + b22)
                middle = f11 * f22 - f12 * f21
                worst = max(worst, abs(log(j / j_n) - (j - j_n) / middle))
                change = (b11 - a11) * (b22 - a22) - (b12 - a12) * (b21 - a21)
                density *= middle
                density += 0.25 * change * (y[s11] - y_n[s11] + y[s22] - y_n[s22])
                if polar:
                    turn = d[strain_12] - ((b12 - a12) * f11 - (b11 - a11) * f12) / middle
                    skew_n, skew = y_n[s12] - y_n[s21], y[s12] - y[s21]
                    density += 0.5 * (skew_n * (j_n - middle) + skew * (j - middle)) * turn
                    first = 0.0 if k31 < 0 else d[k31]
                    w1 = first * f11 + d[k32] * f21
                    w2 = first * f12 + d[k32] * f22
                    density += 0.5 * y_n[m31] * (w1 * (a22 - f22) - w2 * (a21 - f21))
                    density += 0.5 * y_n[m32] * (w2 * (a11 - f11) - w1 * (a12 - f12))
                    density += 0.5 * y[m31] * (w1 * (b22 - f22) - w2 * (b21 - f21))
                    density += 0.5 * y[m32] * (w2 * (b11 - f11) - w1 * (b12 - f12))
            work += weights[row] * density

            trace = 0.0
            for i in range(n):
                z[i] = 0.5 * (y_n[i] + y[i]) / (1.0 if i < n_stress else c.d50)
                trace += t.normal[i] * z[i]
            if not trace < 0.0:
                continue
            deviator[:] = 0.0
            for i in range(n):
                z[i] /= trace
                deviator[t.symmetric[i]] += t.share[i] * z[i] - t.normal[i] / 3.0
            f_s = state_factors(trace, 0.5 * (e_n[q] + e[q]), c)[0]
            s = deviator
            a = critical_stress(c.c_phi, s[0], s[1], s[2], s[3], s[4], s[5])[0]
            if not (f_s > 0.0 and a > 0.0):
                continue  # the line leaves the law's domain, in which both of its ends are
            along = 0.0
            stiffer = 1.0
            for i in range(n):
                softness = t.weight[i] / (a * a if i < n_stress else c.a_c * c.a_c)
                along += softness * z[i] * (y[i] - y_n[i]) / (1.0 if i < n_stress else c.d50)
                stiffer += softness * z[i] * z[i]
            recoverable += weights[row] * middle * trace / f_s * along / stiffer
        return work, recoverable, worst

    return power


def compile_power(power: Power, layout: Layout, c: KernelConstants) -> None:
    """Compile (or load from the cache) the sums by asking for those of no points at all."""
    n = len(layout.forces)
    none, gradients = np.zeros(0), np.zeros((0, 4))
    power(
        np.zeros((0, layout.n_inputs)),
        np.zeros(0, dtype=np.int32),
        np.zeros((0, n)),
        none,
        np.zeros((0, n)),
        none,
        gradients,
        gradients,
        none,
        c,
    )


def _position(components: tuple[Component, ...], first: int, component: Component) -> int:
    """Position of a component behind so many others, -1 where there is none."""
    return first + components.index(component) if component in components else -1
