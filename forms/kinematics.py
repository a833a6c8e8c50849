r"""Strain, curvature and spin of a Cosserat continuum, finite or small, in one, two or three dimensions.

Every field is embedded in three dimensions first, so that one set of equations serves all of them:
a layer's fields depend on x2 alone, plane strain keeps u1, u2 and w3, a solid keeps everything. UFL drops the
zeros. The second index of a tensor is the derivative.

.. math::

    \epsilon_{ij} = u_{i,j} + e_{kij} w_k, \qquad \kappa_{ij} = w_{i,j}

Finite increments are taken on the configuration half-way through the step (``F_m``), which makes them second-order
accurate; in a layer and a plane the change of volume is exact, J - J_n = J_m tr(d_eps):

.. math::

    \Delta\epsilon = \nabla(\Delta u) F_m^{-1} + E(\Delta w), \quad
    \Delta\kappa = \nabla(\Delta w) F_m^{-1}, \quad
    \Delta W = \mathrm{skew}(\nabla(\Delta u) F_m^{-1}), \quad F_m = I + \nabla(u_n + \Delta u/2)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import ufl
from ufl.core.expr import Expr

Component = tuple[int, int]


class Increments(NamedTuple):
    """Increments over a step, each a 3x3 tensor: strain (-), curvature (1/m) and spin (rad)."""

    strain: Expr
    curvature: Expr
    spin: Expr


def displacement_gradient(u: Expr, dimension: str) -> Expr:
    """Gradient u_i,j as a 3x3 tensor.

    Args:
        u: displacement (m); two components in a layer or a plane, three in a solid.
        dimension: "layer" (the mesh's only coordinate is x2), "plane" or "solid".
    """
    if dimension == "solid":
        return ufl.grad(u)
    if dimension == "plane":
        return ufl.as_tensor([[u[0].dx(0), u[0].dx(1), 0], [u[1].dx(0), u[1].dx(1), 0], [0, 0, 0]])
    return ufl.as_tensor([[0, u[0].dx(0), 0], [0, u[1].dx(0), 0], [0, 0, 0]])


def rotation_gradient(w: Expr, dimension: str) -> Expr:
    """Gradient w_i,j as a 3x3 tensor (1/m).

    Args:
        w: Cosserat rotation (rad); the scalar w3 in a layer or a plane, a vector in a solid.
        dimension: "layer", "plane" or "solid".
    """
    if dimension == "solid":
        return ufl.grad(w)
    if dimension == "plane":
        return ufl.as_tensor([[0, 0, 0], [0, 0, 0], [w.dx(0), w.dx(1), 0]])
    return ufl.as_tensor([[0, 0, 0], [0, 0, 0], [0, w.dx(0), 0]])


def rotation_tensor(w: Expr, dimension: str) -> Expr:
    """The tensor E(w)_ij = e_kij w_k that a rotation adds to the displacement gradient."""
    if dimension == "solid":
        return ufl.as_tensor([[0, w[2], -w[1]], [-w[2], 0, w[0]], [w[1], -w[0], 0]])
    return ufl.as_tensor([[0, w, 0], [-w, 0, 0], [0, 0, 0]])


def deformation_gradient(u: Expr, dimension: str, *, finite: bool) -> Expr:
    """F = I + grad u, or I where strains are taken to be small."""
    return ufl.Identity(3) + displacement_gradient(u, dimension) if finite else ufl.Identity(3)


def inverse(f: Expr, dimension: str) -> Expr:
    """Inverse of a deformation gradient, written out for the in-plane block where that is all there is."""
    if dimension == "solid":
        return ufl.inv(f)
    j = in_plane_determinant(f)
    return ufl.as_tensor([[f[1, 1] / j, -f[0, 1] / j, 0], [-f[1, 0] / j, f[0, 0] / j, 0], [0, 0, 1]])


def determinant(f: Expr, dimension: str) -> Expr:
    """Determinant of a deformation gradient: current volume over initial volume."""
    return ufl.det(f) if dimension == "solid" else in_plane_determinant(f)


def in_plane_determinant(f: Expr) -> Expr:
    """Determinant of the block 11, 12, 21, 22."""
    return f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]


def increments(
    u: Expr, u_n: Expr, w: Expr | None, w_n: Expr | None, dimension: str, *, finite: bool, spin: str = "macro"
) -> Increments:
    """Strain, curvature and spin increments of a step.

    Args:
        u, u_n: displacement at the end and at the start of the step (m).
        w, w_n: Cosserat rotation (rad), or None in a classical continuum, whose strain is symmetric.
        dimension: "layer", "plane" or "solid".
        finite: increments on the mid-step configuration; otherwise on the reference one.
        spin: "macro" takes the spin of the displacement, "cosserat" that of the rotation; "none" is no spin.
    """
    f_inverse = inverse(deformation_gradient((u + u_n) / 2, dimension, finite=finite), dimension)
    gradient = ufl.dot(displacement_gradient(u, dimension) - displacement_gradient(u_n, dimension), f_inverse)
    zero = ufl.zero((3, 3))
    turn = {"macro": ufl.skew(gradient), "none": zero}
    if w is None or w_n is None:
        return Increments(ufl.sym(gradient), zero, turn[spin])
    turn["cosserat"] = -rotation_tensor(w - w_n, dimension)
    curvature = ufl.dot(rotation_gradient(w, dimension) - rotation_gradient(w_n, dimension), f_inverse)
    return Increments(gradient + rotation_tensor(w - w_n, dimension), curvature, turn[spin])


def virtual_strain(v: Expr, q: Expr | None, u: Expr, dimension: str, *, finite: bool) -> tuple[Expr, Expr]:
    """Virtual strain and curvature on the current configuration, each a 3x3 tensor.

    Args:
        v: virtual displacement.
        q: virtual rotation, or None in a classical continuum.
        u: displacement that defines the current configuration (m).
        dimension: "layer", "plane" or "solid".
        finite: whether the current configuration differs from the reference one.
    """
    f_inverse = inverse(deformation_gradient(u, dimension, finite=finite), dimension)
    gradient = ufl.dot(displacement_gradient(v, dimension), f_inverse)
    if q is None:
        return ufl.sym(gradient), ufl.zero((3, 3))
    return gradient + rotation_tensor(q, dimension), ufl.dot(rotation_gradient(q, dimension), f_inverse)


def pack(*parts: tuple[Expr, Sequence[Component]]) -> Expr:
    """Chosen components of several tensors, one after the other, as one vector."""
    return ufl.as_vector([tensor[i, j] for tensor, components in parts for i, j in components])
