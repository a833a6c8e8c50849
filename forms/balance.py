r"""Balance of momentum and of angular momentum as virtual work, from given stresses and their tangent.

.. math::

    R = \int [\sigma : (\nabla v F^{-1} + E(q)) + \mu : (\nabla q F^{-1})] J\, dX

The stresses arrive as a coefficient that the constitutive update has filled, in the order of the layout. The
linearisation is UFL's, of everything but the stresses; these contribute the tangent coefficient times the
derivative of the increments.
"""

from __future__ import annotations

from collections.abc import Sequence

import ufl
from ufl.core.expr import Expr


def internal_work(
    forces: Expr, slots: Sequence[int], weights: Sequence[float], virtual: Expr, volume: Expr, dx: ufl.Measure
) -> ufl.Form:
    """Virtual work of the stresses and couple stresses.

    Args:
        forces: vector of stresses (Pa) and couple stresses (N/m).
        slots: the force that is conjugate to each virtual strain and curvature.
        weights: multiplicity of each force in a contraction.
        virtual: vector of virtual strains and curvatures.
        volume: current over reference volume.
        dx: measure of the reference configuration with the quadrature of the forces.
    """
    return sum(weights[s] * forces[s] * virtual[k] for k, s in enumerate(slots)) * volume * dx


def linearised_work(
    work: ufl.Form,
    unknown: Expr,
    trial: Expr,
    tangent: Expr,
    increments: Expr,
    slots: Sequence[int],
    weights: Sequence[float],
    virtual: Expr,
    volume: Expr,
    dx: ufl.Measure,
) -> ufl.Form:
    """Derivative of :func:`internal_work` in the direction ``trial``.

    Args:
        work: the internal work.
        unknown: the coefficient of all unknown fields.
        trial: the direction, of the same space.
        tangent: matrix coefficient, derivatives of the conjugate forces with respect to the increments.
        increments: vector of strain, curvature and spin increments that drive the constitutive update.
        slots, weights, virtual, volume, dx: as in :func:`internal_work`.
    """
    change = ufl.dot(tangent, ufl.derivative(increments, unknown, trial))
    material = sum(weights[s] * change[k] * virtual[k] for k, s in enumerate(slots)) * volume * dx
    return ufl.derivative(work, unknown, trial) + material
