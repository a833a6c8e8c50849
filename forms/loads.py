"""External work of loads on a boundary or in a body."""

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
