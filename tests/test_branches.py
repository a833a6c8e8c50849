"""Branches of equilibria: what is seen of them, how unstable ones are left, and what staying on them costs."""

from typing import Any

import numpy as np
import pytest
import ufl
from planes import BIAXIAL, DEMO, build
from ufl.core.expr import Expr

from cosserat_fx import geometry
from cosserat_fx._compat import MPI
from cosserat_fx.conditions import Condition, Prescribed, Work, fixed, traction
from cosserat_fx.material import Material
from cosserat_fx.newton import NewtonSolver
from cosserat_fx.plane import Plane
from cosserat_fx.problem import Problem
from cosserat_fx.stepping import Step
from cosserat_fx.weakform import Numerics

PRESSURE, WIDTH, END = 100e3, 0.04, 0.01


def demo(step: float, **changes: Any) -> Plane:
    """The demo in steps of a given size (m), where nothing asks for smaller ones."""
    return build({"stepping": {"first_step": step, "max_step": step}, "output": {}, **changes}, DEMO)


def axial_stress(problem: Problem) -> float:
    """Compression over the initial width (Pa)."""
    return -problem.boundary_forces()["top"]["force2"] / WIDTH


def pushed(body: Plane) -> list[Step]:
    """Those of all steps in which a branch became unstable."""
    return [step for step in body.stepper if step.passages]


def test_long_steps_end_where_short_ones_do_and_the_primary_branch_does_not() -> None:
    """The axial stress after 10 mm within half a per cent; it is a sixth higher on the unstable branch."""
    short, long, primary = demo(1e-4), demo(4e-4), demo(4e-4, **{"stepping.branch": "primary"})
    for _ in short.stepper:
        pass
    reference = axial_stress(short.problem)
    assert reference == pytest.approx(357.5e3, rel=5e-3)
    passages = pushed(long)
    assert axial_stress(long.problem) == pytest.approx(reference, rel=5e-3)
    assert passages
    assert all(0.002 < step.travel < 0.005 for step in passages)
    stayed = pushed(primary)
    assert len(stayed) >= 1
    assert axial_stress(primary.problem) == pytest.approx(1.16 * reference, rel=0.03)


def lopsidedness(problem: Problem) -> float:
    """Largest difference of u1 at mirrored nodes over the largest u1."""
    nodes, values = problem.nodal_values("u1")
    order = np.lexsort(np.round(nodes, 9).T)
    mirrored = np.lexsort(np.round(nodes * [1, -1] + [0, 0.14], 9).T)
    return float(np.abs(values[order] - values[mirrored]).max() / np.abs(values).max())


def test_a_body_leaves_the_branch_that_is_as_symmetric_as_it_is() -> None:
    """A weak zone at mid-height. The pin at the foot does not count: it moves the body as a whole, nothing else.

    The primary branch keeps the symmetry; on the other one a single band runs through the body.
    """
    changes: dict[str, Any] = {
        "initial.zones": [{"x": [0.0, 0.0025], "y": [0.06875, 0.07125], "void_ratio": 0.7}],
        "geometry.cells": [16, 56],
        "boundaries.top.u2": -0.006,
        "points.pin.at": [0.0, 0.07],
    }
    stable, primary = demo(4e-4, **changes), demo(4e-4, **changes, **{"stepping.branch": "primary"})
    passages = pushed(stable)
    assert len(pushed(primary)) >= 1
    assert 0.003 < passages[0].travel < 0.005
    assert lopsidedness(primary.problem) < 1e-5
    assert lopsidedness(stable.problem) > 0.1
    assert axial_stress(stable.problem) < 0.99 * axial_stress(primary.problem)


def pushing(stiffness: float) -> Work:
    """Springs that turn grains on the further they have turned (N/m per rad)."""

    def work(u: Expr, w: Expr, v: Expr, q: Expr, ds: ufl.Measure) -> ufl.Form:
        return stiffness * w * q * ds

    return Work(work, "top")


def test_stability_is_the_sign_of_the_determinant() -> None:
    """Against that of the dense matrix: springs that push rotating grains on make more and more directions unstable."""
    material = Material.named("paper-sand", d50=1e-3)
    unit = material.shear_stiffness(PRESSURE, np.array([0.6]))[0] * material.d50
    counts = []
    for stiffness in np.array([0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0]) * unit:
        conditions: list[Condition] = [
            *fixed("bottom", "u1", "u2"),
            *fixed("left", "u1"),
            traction("right", lambda travel: (-PRESSURE, 0.0)),
            *fixed("top", "u1"),
            Prescribed("top", "u2", lambda travel: -travel),
            pushing(stiffness),
        ]
        body = geometry.rectangle(0.01, 0.01, (2, 2), MPI.COMM_SELF)
        numerics = Numerics(hourglass=0.005)
        problem = Problem(body, material, conditions, stress=-PRESSURE, void_ratio=0.6, numerics=numerics)
        solver = NewtonSolver(problem)
        problem.apply(1e-5)
        assert solver.predict()
        solution = solver.solve()
        assert solution.converged
        matrix = np.array(problem.matrix[:, :])
        counts.append(int(np.sum(np.linalg.eigvals(matrix).real < 0)))
        assert solution.stable == (np.linalg.slogdet(matrix)[0] > 0) == (counts[-1] % 2 == 0)
    assert counts[0] == 0
    assert {count % 2 for count in counts[1:]} == {0, 1}


def test_another_factorisation_tells_nothing_of_branches() -> None:
    """And the run goes on as it would where nothing is to be told."""
    results = []
    for options in ({}, {"petsc": {"pc_factor_mat_solver_type": "petsc"}}):
        body = build(BIAXIAL | {"solver": options})
        steps = list(body.stepper)
        assert body.stepper.solver.sees_branches is not bool(options)
        assert not any(step.passages for step in steps)
        results.append((len(steps), body.problem.boundary_forces()["top"]["force2"]))
    assert results[0][0] == results[1][0]
    assert results[1][1] == pytest.approx(results[0][1], rel=1e-9)
