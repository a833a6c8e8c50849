"""What is told, and done, where there is no equilibrium to be found or a linear system is not solved."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from ranks import on_ranks

from cosserat_fx import geometry
from cosserat_fx._compat import MPI
from cosserat_fx.conditions import Condition, Prescribed, traction
from cosserat_fx.diagnosis import failure_with_state, imbalance, is_elliptic
from cosserat_fx.hypoplasticity import Status
from cosserat_fx.layer import build
from cosserat_fx.layout import layout
from cosserat_fx.material import Material
from cosserat_fx.newton import NewtonSolver
from cosserat_fx.problem import Failure, Problem
from cosserat_fx.relaxation import relax
from cosserat_fx.scene import LayerScene, parse_scene
from cosserat_fx.stepping import SteppingError
from cosserat_fx.weakform import Numerics

SAND = Material.named("paper-sand")
PRESSURE = 100e3


def layer(*, void_ratio: float = 0.6, moved: float = 0.0) -> Problem:
    """One centimetre high; carried along as a whole, at once, where asked for (m)."""
    body = geometry.layer(0.01, 20, MPI.COMM_SELF)
    conditions: list[Condition] = [
        Prescribed("bottom", "u1", lambda travel: moved),
        *(Prescribed("bottom", field, lambda travel: 0.0) for field in ("u2", "w")),
        Prescribed("top", "u1", lambda travel: moved + travel),
        Prescribed("top", "w", lambda travel: 0.0),
        traction("top", lambda travel: (0.0, -PRESSURE)),
    ]
    exactly = Numerics(local_tolerance=1e-7)
    return Problem(body, SAND, conditions, stress=-PRESSURE, void_ratio=void_ratio, numerics=exactly)


def scene(**solver: Any) -> LayerScene:
    tables = {
        "geometry": {"height": 0.04, "cells": 20_000},
        "material": {"constants": "paper-sand"},
        "initial": {"stress": -PRESSURE, "void_ratio": 0.6},
        "walls": {"top": {"normal_stress": -PRESSURE, "shear_displacement": 1e-3}},
        "solver": solver,
    }
    parsed = parse_scene(tables)
    assert isinstance(parsed, LayerScene)
    return parsed


def test_a_body_moves_to_the_equilibrium_that_newton_finds() -> None:
    """Where there is one only; each chooses its own local substeps, whose error is small here."""
    problem = layer()
    solver = NewtonSolver(problem)
    problem.apply(1e-5)
    assert solver.predict()
    assert solver.solve().converged
    found = problem.unknown.x.array.copy()
    moved = relax(problem, solver, np.inf)
    assert moved is not None
    assert moved.converged
    assert moved.iterations > 3
    np.testing.assert_allclose(problem.unknown.x.array, found, atol=1e-4 * np.abs(found).max())


def test_a_body_is_not_moved_over_steps_that_strain_it_too_much() -> None:
    problem = layer()
    problem.apply(1e-4)
    assert relax(problem, NewtonSolver(problem), 1e-3) is None


def test_what_rounding_makes_is_not_asked_of_newton() -> None:
    """A layer that is carried along by 10 m has lost the digits in which its forces would be in balance to 1e-9."""
    carried = layer(moved=10.0)
    solver = NewtonSolver(carried)
    carried.apply(1e-5)
    assert solver.predict()
    solution = solver.solve()
    assert solution.converged
    assert 1e-9 < solution.residual < 1e-6

    resting = layer()
    resting.apply(1e-5)
    solver = NewtonSolver(resting)
    assert solver.predict()
    assert solver.solve().residual < 1e-9
    here, there = (problem.state.forces.x.array.reshape(-1, 7)[:, 3] for problem in (carried, resting))
    np.testing.assert_allclose(here, there, rtol=1e-4)


MOVED = """
import sys
from cosserat_fx import stepping
from cosserat_fx._compat import MPI
from cosserat_fx.layer import build
from cosserat_fx.scene import parse_scene

relax, resting = stepping.relax, []
def count(*arguments):
    moved = relax(*arguments)
    resting.append(moved is not None)
    return moved
stepping.relax = count
dense = {"geometry": {"height": 0.004, "cells": 80}, "material": {"constants": "paper-sand", "phi_c": 45, "a_c": 0.5},
         "initial": {"stress": -10.0, "void_ratio": 0.5125},
         "walls": {"top": {"normal_stress": -10.0, "shear_displacement": 0.01}}}
layer = build(parse_scene(dense), MPI.COMM_WORLD)
for step in layer.stepper:
    if any(resting):
        break
force = layer.problem.reactions()["top", "u1"]
if MPI.COMM_WORLD.rank == 0:
    print(sum(resting), step.number, step.travel, force)
"""


def test_a_dense_layer_moves_beyond_its_peak_on_any_number_of_ranks() -> None:
    """Of very dense sand at 10 Pa, whose path of equilibria turns back; to the same state."""
    one, two = (np.array(on_ranks(ranks, MOVED).split(), dtype=float) for ranks in (1, 2))
    assert one[0] == 1
    np.testing.assert_allclose(two, one, rtol=1e-6)


def test_too_little_memory_ends_the_run_at_once_and_is_told_in_words() -> None:
    """MUMPS is allowed one megabyte for 60 000 equations; a shorter step would need as much."""
    stepper = build(scene(petsc={"mat_mumps_icntl_23": 1}), MPI.COMM_SELF).stepper
    with pytest.raises(SteppingError, match=r"failed: MUMPS .* memory .*INFOG\(1\) = -\d+"):
        next(iter(stepper))
    assert stepper.position.number == 0


def test_an_iterative_solver_that_gives_up_is_told_in_words() -> None:
    problem = layer()
    solver = NewtonSolver(problem, options={"ksp_type": "gmres", "pc_type": "none", "ksp_max_it": 2})
    problem.apply(1e-5)
    assert not solver.predict()
    failed = solver.failed_prediction()
    assert failed.reason == "the linear solver (gmres, none) failed: diverged max it"
    assert not failed.hopeless


def test_newton_says_what_it_came_to_and_where() -> None:
    """One iteration is not enough for a step of 1 % shear."""
    problem = layer()
    solver = NewtonSolver(problem, max_iterations=1)
    problem.apply(1e-4)
    assert solver.predict()
    solution = solver.solve()
    assert not solution.converged
    assert solution.reason.startswith("there was no equilibrium within the allowed number of Newton iterations")
    assert "the forces are out of balance most at " in solver.explanation()


@pytest.mark.parametrize(
    ("void_ratio", "cause"),
    [
        (1.2, "exceeds e_i = 1.11"),
        (0.475, "is next to e_d = 0.47"),
        (0.6, "the mean pressure is 1e+05 Pa and the void"),
    ],
)
def test_the_state_is_told_where_the_forces_are_out_of_balance(void_ratio: float, cause: str) -> None:
    """A node is pulled at a third of the height."""
    problem = layer(void_ratio=void_ratio)
    problem.apply(0.0)
    assert problem.update(adapt=True) is None
    problem.assemble_residual(problem.vector)
    pulled = problem.fields["u1"]
    node = int(np.argmin(np.abs(pulled.coordinates[:, 0] - 0.003)))
    problem.vector.array_w[pulled.dofs[node]] = 1e9
    told = imbalance(problem)
    assert told.startswith(f"the forces are out of balance most at {pulled.coordinates[node, 0]:.6g} m, where")
    assert cause in told


def test_a_law_that_fails_for_no_reason_of_its_own_tells_the_state() -> None:
    """Sand next to e_d whose local iteration stops; one that fell below e_d has said it all."""
    problem = layer(void_ratio=0.475)
    stopped = failure_with_state(problem, Failure(Status.LOCAL_NEWTON, (0.00225,)))
    assert stopped.startswith("the local Newton iteration did not converge at 0.00225 m, where the void ratio 0.475 is")
    fallen = Failure(Status.DENSER_THAN_E_D, (0.00225,))
    assert failure_with_state(problem, fallen) == str(fallen)


def test_the_laws_linear_part_is_elliptic_and_a_softening_shear_is_not() -> None:
    """Of the four moduli that meet a plane's normal in a layer, one less than nothing is enough."""
    problem = layer()
    problem.apply(0.0)
    assert problem.update(adapt=True) is None
    tangent = problem.state.tangent.x.array.reshape(-1, 4, 5)[0].copy()
    components = layout("layer")
    assert is_elliptic(tangent, components)
    shear = components.strain.index((0, 1))
    tangent[shear, shear] *= -1
    assert not is_elliptic(tangent, components)


def test_every_normal_is_tried_in_the_plane() -> None:
    """Moduli that soften in the shear at 45 degrees alone, of which the axes know nothing."""
    components = layout("plane")
    number = {component: k for k, component in enumerate(components.strain)}
    elastic = np.zeros((6, 7))
    for component in components.strain:
        elastic[number[component], number[component]] = 1.0
    assert is_elliptic(elastic, components)
    axial, lateral = number[0, 0], number[1, 1]
    softening = elastic.copy()
    softening[axial, lateral] = softening[lateral, axial] = -3.5
    assert not is_elliptic(softening, components)
