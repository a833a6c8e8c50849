r"""What reduced integration needs: an elastic resistance to the deformation that one point in a quadrilateral misses.

A bilinear field on a quadrilateral has one mode beyond its value and gradient at the centre, the hourglass mode. With
the columns a and b of the Jacobian dX/d(xi, eta) of the cell at its centre its amplitude is

.. math::

    \gamma(f) = a \cdot \nabla\nabla f \cdot b ,

which is f,xi eta less what the cell's own distortion contributes to it, so that linear fields have none on any
quadrilateral (Flanagan and Belytschko 1981) and patch tests are passed. The energy of a cell is
c/24 (G |gamma(u)|^2 + M gamma(w)^2): with c = 1 and 2 it has the order of what full integration would see.
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr


def hourglass_mode(f: Expr, mesh: ufl.AbstractDomain) -> Expr:
    """Amplitude of the hourglass mode of a field at a point of a quadrilateral, in the unit of the field.

    Args:
        f: scalar field.
        mesh: the domain.
    """
    jacobian = ufl.Jacobian(mesh)
    return ufl.dot(jacobian[:, 0], ufl.dot(ufl.grad(ufl.grad(f)), jacobian[:, 1]))


def hourglass_work(
    u: Expr, w: Expr | None, v: Expr, q: Expr | None, shear: Expr, couple: Expr, dx: ufl.Measure
) -> ufl.Form:
    """Virtual work of the resistance to hourglass modes, on total fields and the reference configuration.

    Args:
        u, w: displacement (m) and rotation (rad), the latter None in a classical continuum.
        v, q: their virtual counterparts.
        shear: c times the shear stiffness (Pa).
        couple: c times the couple stiffness (N).
        dx: one-point measure of the reference configuration.
    """
    mesh = dx.ufl_domain()
    pairs = [(shear, u[i], v[i]) for i in range(len(u))]
    if w is not None and q is not None:
        pairs.append((couple, w, q))
    work = sum(k * hourglass_mode(f, mesh) * hourglass_mode(g, mesh) for k, f, g in pairs)
    return work / (12 * abs(ufl.JacobianDeterminant(mesh))) * dx
