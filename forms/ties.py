"""Stiff springs on a plane's boundary that hold what no unknown can.

These are displacements along neither axis, and one unknown that goes with another. The springs sit at the nodes, so
that two facets that meet there at an angle do not lock it.
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr


def normal_tie_work(displacement: Expr, stiffness: Expr, normal: Expr, u: Expr, v: Expr, ds: ufl.Measure) -> ufl.Form:
    """Virtual work of springs that hold the normal displacement of a plane's boundary at a value.

    Args:
        displacement: vector whose component along the outward normal is the value (m).
        stiffness: of the springs (Pa/m).
        normal: outward, unit at the nodes of the displacement.
        u, v: displacement (m) and virtual displacement.
        ds: measure of the boundary in the reference configuration, :func:`at_nodes`.
    """
    return -stiffness * ufl.dot(u - displacement, normal) * ufl.dot(v, normal) * ds


def tangential_tie_work(
    displacement: Expr, stiffness: Expr, normal: Expr, u: Expr, v: Expr, ds: ufl.Measure
) -> ufl.Form:
    """Virtual work of springs that hold the tangential displacement of a plane's boundary at a value.

    Args:
        displacement: vector whose component along the tangent is the value (m).
        stiffness: of the springs (Pa/m).
        normal: outward, unit at the nodes of the displacement.
        u, v: displacement (m) and virtual displacement.
        ds: measure of the boundary in the reference configuration, :func:`at_nodes`.
    """
    t = tangent(normal)
    return -stiffness * ufl.dot(u - displacement, t) * ufl.dot(v, t) * ds


def rolling_tie_work(
    rotation_per_displacement: Expr,
    stiffness: Expr,
    normal: Expr,
    u: Expr,
    w: Expr,
    v: Expr,
    q: Expr,
    ds: ufl.Measure,
) -> ufl.Form:
    """Virtual work of springs that tie the rotation of grains at a wall to their own tangential displacement.

    Args:
        rotation_per_displacement: (f_r/f_u)/(d50/2) (rad/m).
        stiffness: of the springs (N/m per rad).
        normal: outward, unit at the nodes of the rotation.
        u, w: displacement (m) and rotation (rad).
        v, q: their virtual counterparts.
        ds: measure of the boundary in the reference configuration, :func:`at_nodes`.
    """
    t, k = tangent(normal), rotation_per_displacement
    return -stiffness * (w + k * ufl.dot(u, t)) * (q + k * ufl.dot(v, t)) * ds


def at_nodes(ds: ufl.Measure, order: int) -> ufl.Measure:
    """The measure with a rule whose points are the nodes of Lagrange elements of an order (Gauss-Lobatto).

    Args:
        ds: measure of a boundary.
        order: 1 or 2.
    """
    return ds(metadata={"quadrature_rule": "GLL", "quadrature_degree": 2 * order - 1})


def tangent(normal: Expr) -> Expr:
    """The outward normal turned clockwise."""
    return ufl.as_vector([normal[1], -normal[0]])
