"""Couples on a boundary: given ones, and those of an elastic resistance to the rotation of the grains."""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr


def couple_work(couple: Expr, q: Expr, ds: ufl.Measure) -> ufl.Form:
    """Virtual work of a couple traction, given per reference area.

    Args:
        couple: moment per area (N/m) about +x3.
        q: virtual rotation.
        ds: measure of the loaded boundary.
    """
    return couple * q * ds


def rotational_resistance_work(stiffness: Expr, w: Expr, q: Expr, ds: ufl.Measure) -> ufl.Form:
    """Virtual work of an elastic resistance to the rotation of the grains at a boundary.

    Args:
        stiffness: couple per area and rotation (N/m per rad).
        w, q: rotation (rad) and virtual rotation.
        ds: measure of the boundary in the reference configuration.
    """
    return -stiffness * w * q * ds
