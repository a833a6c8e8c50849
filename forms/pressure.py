r"""Pressure that follows a boundary: always normal to it as it is now, per current area.

By Nanson's formula the area element n da is J F^-T N dA of the reference configuration:

.. math::

    \delta W = -\int p\, v \cdot J F^{-T} N\, dA
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from cosserat_fx.forms import kinematics


def pressure_work(pressure: Expr, u: Expr, v: Expr, ds: ufl.Measure, dimension: str, *, finite: bool) -> ufl.Form:
    """Virtual work of a follower pressure.

    Args:
        pressure: force per current area (Pa), positive in compression.
        u: displacement that defines the current configuration (m).
        v: virtual displacement.
        ds: measure of the boundary in the reference configuration.
        dimension: "plane" or "solid".
        finite: whether the current configuration differs from the reference one.
    """
    normal = ufl.FacetNormal(ds.ufl_domain())
    f = kinematics.deformation_gradient(u, dimension, finite=finite)
    cofactor = kinematics.determinant(f, dimension) * ufl.transpose(kinematics.inverse(f, dimension))
    axes = range(len(normal))
    return -pressure * sum(v[i] * cofactor[i, j] * normal[j] for i in axes for j in axes) * ds
