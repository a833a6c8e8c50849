"""The Jacobian of a problem is the derivative of its residual, which ties kernel, state and forms together."""

import pytest
from derivative import order_of_remainder

from cosserat_fx import geometry
from cosserat_fx._compat import MPI
from cosserat_fx.conditions import Condition, Prescribed, Work, fixed, traction
from cosserat_fx.material import Material
from cosserat_fx.newton import NewtonSolver
from cosserat_fx.problem import Problem
from cosserat_fx.stepping import StepControl, Stepper
from cosserat_fx.weakform import Numerics

HEIGHT, CELLS, STEP = 0.01, 10, 2e-4


def layer(numerics: Numerics) -> Problem:
    """A layer under a medium rough wall with a non-linear spring after five steps of 2 % shear, the sixth predicted."""
    material = Material.named("paper-sand")
    conditions: list[Condition] = [
        *fixed("bottom", "u1", "u2"),
        Prescribed("top", "u1", lambda travel: travel),
        traction("top", lambda travel: (0.0, -100e3)),
        Work(lambda u, w, v, q, ds: -1e9 * (u[1] + 1e4 * u[1] ** 2) * v[1] * ds, "top"),
    ]
    if numerics.polar:
        conditions += [*fixed("bottom", "w"), Prescribed("top", "w", lambda travel: -0.025 * travel / material.d50)]
    mesh = geometry.layer(HEIGHT, CELLS, MPI.COMM_SELF)
    problem = Problem(mesh, material, conditions, stress=-100e3, void_ratio=0.6, numerics=numerics)
    solver = NewtonSolver(problem)
    *_, last = Stepper(problem, solver, [0.0, 5 * STEP], [], StepControl(STEP, STEP, STEP / 10))
    problem.apply(last.travel + STEP)
    assert solver.predict()
    return problem


@pytest.mark.parametrize(
    "numerics",
    [
        pytest.param(Numerics(spin="macro"), id="polar-finite-macro"),
        pytest.param(Numerics(spin="cosserat", degree=3), id="polar-finite-cosserat-2-point"),
        pytest.param(Numerics(spin="none"), id="polar-finite-none"),
        pytest.param(Numerics(finite=False, spin="none"), id="polar-small"),
        pytest.param(Numerics(polar=False), id="classical-finite-macro"),
        pytest.param(Numerics(polar=False, finite=False), id="classical-small"),
    ],
)
def test_jacobian_of_a_layer_is_the_derivative_of_its_residual(numerics: Numerics) -> None:
    """Off equilibrium, along random changes that respect the conditions, the number of local substeps held."""
    assert order_of_remainder(layer(numerics), HEIGHT / CELLS) == pytest.approx(2.0, abs=0.05)
