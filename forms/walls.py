"""Kinematics of grains that stick to, roll on or slide along a rough wall, and what ties them to it.

A wall that moves by u_b parallel to itself carries its grains along by u_p = f_u u_b; of the rest they make up f_r u_b
by rolling and f_s u_b by sliding, f_u + f_r + f_s = 1. Rolling turns them by f_r u_b over their radius, which is
(f_r/f_u) u_p / (d50/2) (equations 8 to 11 of the source paper).

The tangent of a boundary is its outward normal turned clockwise, t = (n2, -n1): +x1 on a top wall, -x1 on a bottom
wall. A wall above the grains that moves along +x1 turns them clockwise, so everywhere w = -rolling u_t / (d50/2).

Where a displacement along neither axis is prescribed, or one unknown tied to another, stiff springs do it.
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr


def rolling_rotation(displacement: float, rotation_per_displacement: float, outward: int) -> float:
    """Cosserat rotation of the grains at a wall that moves along +x1.

    A wall above the grains (outward normal +x2) that moves along +x1 turns them clockwise: w < 0. A wall below
    them turns them the other way.

    Args:
        displacement: of the wall, or of the grains if the factor belongs to them (m).
        rotation_per_displacement: f_r/(d50/2), respectively (f_r/f_u)/(d50/2) (rad/m).
        outward: sign of the outward normal's x2 component, +1 for a top wall and -1 for a bottom wall.

    Returns:
        Rotation w3 about +x3 (rad).
    """
    return -outward * rotation_per_displacement * displacement


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


def rotational_resistance_work(stiffness: Expr, w: Expr, q: Expr, ds: ufl.Measure) -> ufl.Form:
    """Virtual work of an elastic resistance to the rotation of the grains at a boundary.

    Args:
        stiffness: couple per area and rotation (N/m per rad).
        w, q: rotation (rad) and virtual rotation.
        ds: measure of the boundary in the reference configuration.
    """
    return -stiffness * w * q * ds


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
