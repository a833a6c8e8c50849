"""Dead tractions on a boundary."""

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


def balancing_work(stresses: Expr, v: Expr, ds: ufl.Measure) -> ufl.Form:
    """Virtual work of the dead traction that balances normal stresses in the body.

    Args:
        stresses: normal stress along each axis (Pa, tension positive).
        v: virtual displacement.
        ds: measure of the boundary in the reference configuration.
    """
    normal = ufl.FacetNormal(ds.ufl_domain())
    return sum(stresses[i] * normal[i] * v[i] for i in range(len(normal))) * ds
