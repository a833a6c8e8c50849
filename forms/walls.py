"""Kinematics of grains that stick to, roll on or slide along a rough wall.

A wall that moves by u_b parallel to itself carries its grains along by u_p = f_u u_b; of the rest they make up f_r u_b
by rolling and f_s u_b by sliding, f_u + f_r + f_s = 1. Rolling turns them by f_r u_b over their radius, which is
(f_r/f_u) u_p / (d50/2) (equations 8 to 11 of the source paper).

The tangent of a boundary is its outward normal turned clockwise, t = (n2, -n1): +x1 on a top wall, -x1 on a bottom
wall. A wall above the grains that moves along +x1 turns them clockwise, so everywhere w = -rolling u_t / (d50/2).
"""

from __future__ import annotations


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
