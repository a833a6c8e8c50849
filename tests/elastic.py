"""A manufactured solution of linear isotropic Cosserat elasticity on the unit interval and the unit square."""

import numpy as np
import ufl
from body import Body
from ufl.core.expr import Expr

from cosserat_fx._compat import dolfinx
from cosserat_fx.forms import kinematics, loads
from cosserat_fx.typing import Array

LAMBDA, MU, MU_C, BETA, GAMMA = 1.3, 1.0, 0.6, 0.05, 0.2
"""Pa, and N for the couple moduli."""


def stresses(strain: Expr, curvature: Expr) -> tuple[Expr, Expr]:
    """Stress and couple stress, which are not symmetric."""
    stress = LAMBDA * ufl.tr(strain) * ufl.Identity(3) + (MU + MU_C) * strain + (MU - MU_C) * ufl.transpose(strain)
    return stress, (GAMMA + BETA) * curvature + (GAMMA - BETA) * ufl.transpose(curvature)


class Manufactured:
    """Exact fields and what drives them, from the equations of the theory page component by component.

    Nothing here comes from the forms: eps_ij = u_i,j + e_kij w_k, kappa_ij = w_i,j, and the body force and the body
    couple are what is missing from sigma_ij,j = 0 and mu_3j,j - e_3ij sigma_ij = 0.
    """

    def __init__(self, body: Body) -> None:
        x = ufl.SpatialCoordinate(body.mesh)
        axes = {1: 0} if body.dimension == "layer" else {0: 0, 1: 1}

        def d(f: Expr, j: int) -> Expr:
            return f.dx(axes[j]) if j in axes else 0

        y = x[axes[1]]
        u_1, u_2, w = ufl.sin(3 * y + 0.4), ufl.exp(-y) * ufl.cos(2 * y), ufl.cos(2.5 * y - 0.3)
        if body.dimension == "plane":
            u_1, u_2, w = u_1 * ufl.cos(2 * x[0]), u_2 + ufl.sin(2 * x[0] * y), w * ufl.exp(x[0] / 2)
        strain = [[d(u_1, 0), d(u_1, 1) + w, 0], [d(u_2, 0) - w, d(u_2, 1), 0], [0, 0, 0]]
        sigma, mu = stresses(ufl.as_tensor(strain), ufl.as_tensor([[0, 0, 0], [0, 0, 0], [d(w, 0), d(w, 1), 0]]))
        normal = ufl.FacetNormal(body.mesh)
        self.displacement, self.rotation = ufl.as_vector([u_1, u_2]), w
        self.force = ufl.as_vector([-sum(d(sigma[i, j], j) for j in axes) for i in range(2)])
        self.couple = sigma[0, 1] - sigma[1, 0] - sum(d(mu[2, j], j) for j in axes)
        self.traction = ufl.as_vector([sum(sigma[i, j] * normal[k] for j, k in axes.items()) for i in range(2)])


def solve(body: Body) -> Array:
    """Solve for the body's unknown and compare.

    The fields are prescribed on the whole boundary but for the displacement of the top, which carries a traction.

    Returns:
        Errors of displacement and rotation in L2, then of their gradients in L2.
    """
    exact = Manufactured(body)
    u, w = body.split(body.unknown)
    v, q = body.split(ufl.TestFunction(body.space))
    stress, couple = stresses(body.step.strain, body.step.curvature)
    internal = body.work(kinematics.pack((stress, body.layout.stress), (couple, body.layout.couple)))
    dx = ufl.dx(body.mesh, metadata={"quadrature_degree": 6})
    ds = ufl.ds(body.mesh, metadata={"quadrature_degree": 6})
    external = (ufl.inner(exact.force, v) + exact.couple * q) * dx + loads.traction_work(exact.traction, v, ds)
    matrix = dolfinx.fem.assemble_matrix(dolfinx.fem.form(ufl.derivative(internal, body.unknown))).to_dense()

    side, height = body.position[:, :-1], body.position[:, -1]
    fixed = np.any(np.isclose(side, 0) | np.isclose(side, 1), axis=1) | np.isclose(height, 0)
    fixed |= np.isclose(height, 1) & (body.field == "w3")
    free, x = ~fixed, body.unknown.x.array
    fields = {"u1": exact.displacement[0], "u2": exact.displacement[1], "w3": exact.rotation}
    x[fixed] = [fields[f](tuple(at)) for f, at in zip(body.field[fixed], body.position[fixed], strict=True)]
    residual = dolfinx.fem.assemble_vector(dolfinx.fem.form(internal - external)).array
    x[free] -= np.linalg.solve(matrix[np.ix_(free, free)], residual[free])

    errors = [u - exact.displacement, w - exact.rotation]
    norms = [ufl.inner(e, e) * dx for e in errors] + [ufl.inner(ufl.grad(e), ufl.grad(e)) * dx for e in errors]
    return np.sqrt([dolfinx.fem.assemble_scalar(dolfinx.fem.form(norm)) for norm in norms])
