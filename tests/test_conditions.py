"""Work conditions: a user's form in residual, Jacobian and equilibrium."""

from collections.abc import Sequence

import numpy as np
import pytest
import ufl
from ufl.core.expr import Expr

from cosserat_fx import geometry
from cosserat_fx._compat import MPI
from cosserat_fx.conditions import Condition, Prescribed, Work, fixed, traction
from cosserat_fx.material import Material
from cosserat_fx.newton import NewtonSolver
from cosserat_fx.problem import Problem
from cosserat_fx.stepping import StepControl, Stepper
from cosserat_fx.typing import Array
from cosserat_fx.weakform import Numerics

HEIGHT, CELLS, PRESSURE = 0.02, 20, 100e3
SAND = Material.named("paper-sand")


def body(extra: Sequence[Condition], numerics: Numerics | None = None) -> Problem:
    """A layer on a very rough bottom, dragged at the top, where grains may turn."""
    numerics = numerics or Numerics()
    conditions: list[Condition] = [
        *fixed("bottom", "u1", "u2"),
        *(fixed("bottom", "w") if numerics.polar else []),
        Prescribed("top", "u1", lambda travel: travel),
        traction("top", lambda travel: (0.0, -PRESSURE)),
        *extra,
    ]
    mesh = geometry.layer(HEIGHT, CELLS, MPI.COMM_SELF)
    return Problem(mesh, SAND, conditions, stress=-PRESSURE, void_ratio=0.6, numerics=numerics)


def shear(problem: Problem) -> Problem:
    """Sheared by 5 %."""
    for _ in Stepper(problem, NewtonSolver(problem), [0.0, 0.05 * HEIGHT], [], StepControl(5e-5)):
        pass
    return problem


def springs(stiffness: float) -> Work:
    """A couple of -stiffness * w per area (N/m)."""

    def work(u: Expr, w: Expr, v: Expr, q: Expr, ds: ufl.Measure) -> ufl.Form:
        return -stiffness * w * q * ds

    return Work(work, "top")


def profile(problem: Problem, i: int, j: int) -> Array:
    """A stress over the height."""
    return np.asarray(problem.state.forces_n[problem.state.points, problem.layout.stress_index(i, j)])


def rotation_at_the_top(problem: Problem) -> int:
    """The unknown that is the rotation of the uppermost node."""
    space, dofs = problem.space.sub(1).collapse()
    return int(np.ravel(dofs)[np.argmax(space.tabulate_dof_coordinates()[:, 0])])


def test_residual_and_jacobian_hold_the_work_and_its_derivative() -> None:
    """Hardening springs -c w^3 against the same body without: c w^3/d50 in one row, 3 c w^2/d50 on the diagonal."""
    c, rotation = 1e5, 0.02

    def work(u: Expr, w: Expr, v: Expr, q: Expr, ds: ufl.Measure) -> ufl.Form:
        return -c * w**3 * q * ds

    loaded, free = body([Work(work, "top")]), body([])
    only = np.arange(len(free.unknown.x.array)) == rotation_at_the_top(free)
    assembled = []
    for problem in (loaded, free):
        problem.unknown.x.array[only] = rotation
        assert problem.update(adapt=True) is None
        problem.assemble_residual(problem.vector)
        problem.assemble_jacobian()
        assembled.append((problem.vector.array.copy(), problem.matrix[:, :]))
    (residual, jacobian), (free_residual, free_jacobian) = assembled
    force, slope = c * rotation**3 / SAND.d50, 3 * c * rotation**2 / SAND.d50
    assert residual - free_residual == pytest.approx(force * only, abs=1e-12 * np.abs(residual).max())
    assert jacobian - free_jacobian == pytest.approx(np.diag(slope * only), abs=1e-12 * np.abs(jacobian).max())


@pytest.mark.parametrize("polar", [True, False], ids=["polar", "classical"])
def test_normal_stress_under_weight_grows_with_depth(polar: bool) -> None:
    """In equilibrium s22 = -p - rho g (h - y), whatever the shear; rho and g refer to the initial volume."""
    weight = 1e6  # N/m^3, a fifth of the pressure at the bottom
    heavy = shear(body([Work(lambda u, w, v, q, dx: -weight * v[1] * dx)], Numerics(polar=polar)))
    depth = HEIGHT - heavy.state.coordinates[:, 0]
    assert profile(heavy, 1, 1) == pytest.approx(-PRESSURE - weight * depth, rel=1e-7)
    assert -heavy.reactions()["bottom", "u2"] == pytest.approx(-PRESSURE - weight * HEIGHT, rel=1e-7)


def test_couples_at_both_walls_balance_the_skew_stress() -> None:
    """A rigid virtual rotation: c w at the top and the couple at the bottom carry the integral of s12 - s21."""
    stiffness = 100.0
    held = shear(body([springs(stiffness)]))
    y, order = held.nodal_values("u2")[0][:, 0], np.argsort(held.state.coordinates[:, 0])
    heights = np.diff((y + held.nodal_values("u2")[1])[np.argsort(y)])
    skew = float(np.sum((profile(held, 0, 1) - profile(held, 1, 0))[order] * heights))
    top = -stiffness * held.boundary_mean("top", "w")
    bottom = SAND.d50 * held.reactions()["bottom", "w"]
    assert top > 0
    assert top + bottom == pytest.approx(skew, rel=1e-6)


def test_springs_lead_from_free_grains_to_held_ones() -> None:
    """No stiffness is no condition; a huge one holds the rotation at zero."""
    free, soft, stiff, held = (
        shear(body(extra)).reactions()["top", "u1"] for extra in ([], [springs(0.0)], [springs(1e8)], fixed("top", "w"))
    )
    assert soft == pytest.approx(free, rel=1e-9)
    assert stiff == pytest.approx(held, rel=1e-5)
    assert held > 1.002 * free
