"""A manufactured solution of linear isotropic Cosserat elasticity on the unit interval and the unit square."""

from collections.abc import Callable
from typing import Any

import numpy as np
import ufl
from body import Body
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve
from ufl.constantvalue import ConstantValue
from ufl.core.expr import Expr

from cosserat_fx._compat import dolfinx
from cosserat_fx.forms import kinematics, stabilization
from cosserat_fx.forms.traction import traction_work
from cosserat_fx.typing import Array

LAMBDA, MU, MU_C, BETA, GAMMA = 1.3, 1.0, 0.6, 0.05, 0.2
"""Pa, and N for the couple moduli."""


def stresses(strain: Expr, curvature: Expr) -> tuple[Expr, Expr]:
    """Stress and couple stress, which are not symmetric."""
    stress = LAMBDA * ufl.tr(strain) * ufl.Identity(3) + (MU + MU_C) * strain + (MU - MU_C) * ufl.transpose(strain)
    return stress, (GAMMA + BETA) * curvature + (GAMMA - BETA) * ufl.transpose(curvature)


Fields = Callable[[Expr, Expr], tuple[Expr, Expr, Expr]]
"""Returns u1, u2 and w at x1 and x2, which in a layer is all that they depend on."""


def waves(x: Expr, y: Expr) -> tuple[Expr, Expr, Expr]:
    """Smooth fields without any symmetry."""
    u_1, u_2, w = waves_of_layer(x, y)
    return u_1 * ufl.cos(2 * x), u_2 + ufl.sin(2 * x * y), w * ufl.exp(x / 2)


def waves_of_layer(x: Expr, y: Expr) -> tuple[Expr, Expr, Expr]:
    """The same for a layer."""
    return ufl.sin(3 * y + 0.4), ufl.exp(-y) * ufl.cos(2 * y), ufl.cos(2.5 * y - 0.3)


class Manufactured:
    """Exact fields and what drives them, from the equations of the theory page component by component.

    Nothing here comes from the forms: eps_ij = u_i,j + e_kij w_k, kappa_ij = w_i,j, and the body force and the body
    couple are what is missing from sigma_ij,j = 0 and mu_3j,j - e_3ij sigma_ij = 0. In a classical continuum the
    particles turn as their neighbourhood does, and there are no couples.
    """

    def __init__(self, body: Body, fields: Fields) -> None:
        x = ufl.SpatialCoordinate(body.mesh)
        axes = {1: 0} if body.dimension == "layer" else {0: 0, 1: 1}

        def d(f: Expr, j: int) -> Expr:
            return 0 if j not in axes or isinstance(f, ConstantValue) else f.dx(axes[j])

        u_1, u_2, w = fields(x[0], x[axes[1]])
        turn = w if body.layout.polar else (d(u_2, 0) - d(u_1, 1)) / 2
        strain = [[d(u_1, 0), d(u_1, 1) + turn, 0], [d(u_2, 0) - turn, d(u_2, 1), 0], [0, 0, 0]]
        sigma, mu = stresses(ufl.as_tensor(strain), ufl.as_tensor([[0, 0, 0], [0, 0, 0], [d(w, 0), d(w, 1), 0]]))
        normal = ufl.FacetNormal(body.mesh)
        self.displacement, self.rotation = ufl.as_vector([u_1, u_2]), w
        self.force = ufl.as_vector([-sum(d(sigma[i, j], j) for j in axes) for i in range(2)])
        self.couple = sigma[0, 1] - sigma[1, 0] - sum(d(mu[2, j], j) for j in axes)
        self.traction = ufl.as_vector([sum(sigma[i, j] * normal[k] for j, k in axes.items()) for i in range(2)])


def internal_work(body: Body, hourglass: float = 0.0) -> ufl.Form:
    """Virtual work of the elastic stresses and of the resistance to hourglass modes.

    Args:
        body: of small strains.
        hourglass: factor of the resistance.
    """
    stress, couple = stresses(body.step.strain, body.step.curvature)
    work = body.work(kinematics.pack((stress, body.layout.stress), (couple, body.layout.couple)))
    if hourglass:
        (u, w), (v, q) = body.split(body.unknown), body.split(ufl.TestFunction(body.space))
        shear, curvature = (ufl.as_ufl(hourglass * k) for k in (MU + MU_C, GAMMA + BETA))
        one_point = ufl.Measure("dx", body.mesh, metadata={"quadrature_degree": 1})
        work += stabilization.hourglass_work(u, w, v, q, shear, curvature, one_point)
    return work


def stiffness(body: Body, hourglass: float = 0.0) -> Any:
    """The matrix of the internal work, as SciPy's."""
    form = dolfinx.fem.form(ufl.derivative(internal_work(body, hourglass), body.unknown))
    matrix = dolfinx.fem.petsc.assemble_matrix(form)
    matrix.assemble()
    rows, columns, values = matrix.getValuesCSR()
    return csr_matrix((values, columns, rows), shape=matrix.getSize())


def solve(body: Body, hourglass: float = 0.0, *, fields: Fields | None = None, degree: int = 6) -> Array:
    """Solve for the body's unknown and compare.

    The fields are prescribed on the whole boundary but for the displacement of the top, which carries a traction.

    Args:
        body: on the unit interval or square.
        hourglass: factor of the resistance to hourglass modes.
        fields: the solution; waves by default.
        degree: of the rule that body forces and couples are integrated by.

    Returns:
        Errors of displacement and rotation in L2, then of their gradients in L2; without rotation where there is none.
    """
    exact = Manufactured(body, fields or (waves if body.dimension == "plane" else waves_of_layer))
    u, w = body.split(body.unknown)
    v, q = body.split(ufl.TestFunction(body.space))
    dx = ufl.dx(body.mesh, metadata={"quadrature_degree": 6})
    ds = ufl.ds(body.mesh, metadata={"quadrature_degree": 6})
    inside = ufl.dx(body.mesh, metadata={"quadrature_degree": degree})
    external = ufl.inner(exact.force, v) * inside + traction_work(exact.traction, v, ds)
    if q is not None:
        external += exact.couple * q * inside
    matrix = stiffness(body, hourglass)

    side, height = body.position[:, :-1], body.position[:, -1]
    fixed = np.any(np.isclose(side, 0) | np.isclose(side, 1), axis=1) | np.isclose(height, 0)
    fixed |= np.isclose(height, 1) & (body.field == "w3")
    free, x = ~fixed, body.unknown.x.array
    given = {"u1": exact.displacement[0], "u2": exact.displacement[1], "w3": exact.rotation}
    x[fixed] = [given[f](tuple(at)) for f, at in zip(body.field[fixed], body.position[fixed], strict=True)]
    residual = dolfinx.fem.assemble_vector(dolfinx.fem.form(internal_work(body, hourglass) - external)).array
    x[free] -= spsolve(matrix[free][:, free].tocsc(), residual[free])

    errors = [u - exact.displacement] + ([] if w is None else [w - exact.rotation])
    norms = [ufl.inner(e, e) * dx for e in errors] + [ufl.inner(ufl.grad(e), ufl.grad(e)) * dx for e in errors]
    return np.sqrt([dolfinx.fem.assemble_scalar(dolfinx.fem.form(norm)) for norm in norms])
