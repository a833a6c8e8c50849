"""The Jacobian of a problem is the derivative of its residual, which ties kernel, state and forms together."""

import numpy as np
import pytest

from cosserat_fx import geometry
from cosserat_fx._compat import MPI
from cosserat_fx.conditions import Condition, Prescribed, Traction, Work, fixed
from cosserat_fx.material import Material
from cosserat_fx.newton import NewtonSolver
from cosserat_fx.problem import Problem
from cosserat_fx.stepping import StepControl, Stepper
from cosserat_fx.typing import Array
from cosserat_fx.weakform import Numerics

HEIGHT, CELLS, STEP = 0.01, 10, 2e-4


def layer(numerics: Numerics) -> Problem:
    """A layer under a medium rough wall with a non-linear spring after five steps of 2 % shear, the sixth predicted."""
    material = Material.named("paper-sand")
    conditions: list[Condition] = [
        *fixed("bottom", "u1", "u2"),
        Prescribed("top", "u1", lambda travel: travel),
        Traction("top", lambda travel: (0.0, -100e3)),
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
    random, problem = np.random.default_rng(20), layer(numerics)
    x, predicted = problem.unknown.x.array, problem.unknown.x.array.copy()
    length = np.full(len(x), HEIGHT / CELLS)
    if numerics.polar:
        length[problem.space.sub(1).collapse()[1]] = 1.0
    residual, slope, direction = (problem.vector.duplicate() for _ in range(3))

    def nearby(strain: float) -> Array:
        """Random unknowns that fulfil the conditions."""
        x[:] = predicted + strain * length * random.uniform(-1, 1, len(x))
        problem.impose()
        return np.array(x)

    def residual_at(unknowns: Array) -> Array:
        x[:] = unknowns
        assert problem.update(adapt=False) is None
        problem.assemble_residual(residual)
        return np.array(residual.array_r)

    start = nearby(0.002)
    assert problem.update(adapt=True) is None
    assert problem.state.substeps.max() > 1
    at = residual_at(start)
    problem.assemble_jacobian(problem.matrix)
    direction.array_w[:] = nearby(0.002) - start
    problem.matrix.mult(direction, slope)
    parts = [0.1 / 2**k for k in range(7)]
    ends = [start + part * direction.array_r for part in parts]
    remainders = [
        float(np.linalg.norm(residual_at(end) - at - part * slope.array_r))
        for part, end in zip(parts, ends, strict=True)
    ]
    order = np.polyfit(np.log(parts), np.log(remainders), 1)[0]
    assert order == pytest.approx(2.0, abs=0.05)
