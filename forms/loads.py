"""External work of loads: dead tractions and couples on a boundary, weight in a body."""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr


def traction_work(traction: Expr, v: Expr, ds: ufl.Measure) -> ufl.Form:
    """Virtual work of a dead traction, given per reference area.

    Args:
        traction: force per area (Pa), positive along the axes: tension on a surface that faces +x2 is +x2.
        v: virtual displacement.
        ds: measure of the loaded boundary.
    """
    return ufl.inner(traction, v) * ds


def couple_work(couple: Expr, q: Expr, ds: ufl.Measure) -> ufl.Form:
    """Virtual work of a couple traction, given per reference area.

    Args:
        couple: moment per area (N/m) about +x3.
        q: virtual rotation.
        ds: measure of the loaded boundary.
    """
    return couple * q * ds


def balancing_work(stresses: Expr, v: Expr, ds: ufl.Measure) -> ufl.Form:
    """Virtual work of the dead traction that balances normal stresses in the body.

    Args:
        stresses: normal stress along each axis (Pa, tension positive).
        v: virtual displacement.
        ds: measure of the boundary in the reference configuration.
    """
    normal = ufl.FacetNormal(ds.ufl_domain())
    return sum(stresses[i] * normal[i] * v[i] for i in range(len(normal))) * ds


def weight_work(weight: Expr, v: Expr, dx: ufl.Measure) -> ufl.Form:
    """Virtual work of the weight, which acts along -x2.

    Args:
        weight: force per initial volume (N/m3); mass does not change, so neither does it.
        v: virtual displacement.
        dx: measure of the body in the reference configuration.
    """
    return -weight * v[1] * dx
