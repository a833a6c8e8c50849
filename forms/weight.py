"""The weight of a body."""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr


def weight_work(weight: Expr, v: Expr, dx: ufl.Measure) -> ufl.Form:
    """Virtual work of the weight, which acts along -x2.

    Args:
        weight: force per initial volume (N/m3); mass does not change, so neither does it.
        v: virtual displacement.
        dx: measure of the body in the reference configuration.
    """
    return -weight * v[1] * dx
