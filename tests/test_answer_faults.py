"""Faults that the checks of the answer find."""

from math import log1p
from typing import Any

import numpy as np
import pytest
from answers import checked, sheared, squeezed
from layers import SAND
from planes import PRESSURE


def test_a_stress_that_is_off_in_one_cell_of_a_layer_is_found() -> None:
    body, answer = sheared()
    state, slot = body.problem.state, body.problem.layout.stress_index(0, 1)
    point = state.points[37]
    before = state.forces_n[point, slot]
    state.forces_n[point, slot] *= 1.001
    found = checked(answer)["equilibrium"]
    assert found["value"] * body.problem.force_scale() == pytest.approx(1e-3 * abs(before), rel=1e-4)
    assert found["where"] == f"s12 at y = {state.coordinates[37, 0]:.6g} m"
    [warning] = answer.warnings()
    assert f"out of balance by {found['value']:.3g} of the internal forces" in warning


def test_a_stress_that_is_off_in_one_cell_of_a_plane_body_is_found() -> None:
    body, answer = squeezed()
    state = body.problem.state
    state.forces_n[state.points[5], 0] *= 1.01
    found = checked(answer)
    assert not found["equilibrium"]["holds"]
    assert found["equilibrium"]["value"] > 1e-4
    near = [float(part.split(" = ")[1].removesuffix(" m")) for part in found["equilibrium"]["where"].split(", ")]
    assert np.abs(state.coordinates[5] - near).max() < 0.6 * 0.005  # a corner of the cell of 5 mm
    assert found["reactions"]["holds"]  # inside the body it changes no resultant
    assert any(it.startswith("the answer is not in equilibrium") for it in answer.warnings())


@pytest.mark.parametrize("kind", ["layer", "plane"])
def test_a_load_that_is_not_the_one_applied_is_found(kind: str) -> None:
    """A weight that the solution has not seen is missing in the reactions, all of it."""
    if kind == "layer":
        body, answer = sheared("weight.density=1700", "geometry.cells=20")
        volume, hanging = 0.04, 1 - 1 / 40
    else:
        body, answer = squeezed({"weight": {"density": 1700.0}})
        volume, hanging = 0.02**2, 1 - 2 / 8
    problem = body.problem
    [weight] = [load for load, _ in problem._form.loads if load.boundary is None]
    applied = weight.value
    object.__setattr__(weight, "value", lambda travel: [1.1 * it for it in applied(travel)])
    found = checked(answer)["reactions"]
    missing = 0.1 * 1700 * 9.81 * volume * hanging  # what lies on nodes that are held goes into what holds them
    assert found["where"] == "the force along x2"
    assert found["value"] * problem.force_scale() == pytest.approx(missing, rel=1e-3)
    assert any(it.startswith("what acts on the body does not balance: the force along x2") for it in answer.warnings())


@pytest.mark.parametrize("make", [sheared, squeezed])
def test_a_void_ratio_that_is_off_in_one_cell_is_found(make: Any) -> None:
    body, answer = make()
    state = body.problem.state
    before = float(state.e_n[state.points[11]])
    state.e_n[state.points[11]] *= 1.01
    found = checked(answer)["mass"]
    assert found["value"] == pytest.approx(log1p(1.01 * before) - log1p(before), abs=2 * found["limit"])
    names = ("y",) if len(state.coordinates[11]) == 1 else ("x", "y")
    place = ", ".join(f"{name} = {x:.6g} m" for name, x in zip(names, state.coordinates[11], strict=True))
    assert found["where"] == place
    [warning] = answer.warnings()
    assert warning.startswith(f"mass is not conserved: void ratio and displacements disagree by {found['value']:.3g}")


def test_points_outside_the_laws_range_are_counted() -> None:
    """One point whose largest principal stress is tensile though its normal stresses are not, one that is too dense."""
    body, answer = sheared()
    state, layout_ = body.problem.state, body.problem.layout
    for component in ((0, 1), (1, 0)):
        state.forces_n[state.points[3], layout_.stress_index(*component)] = 1.2 * PRESSURE
    e_d = SAND.characteristic_void_ratios(PRESSURE).e_d
    state.e_n[state.points[9]] = 0.9 * e_d
    found = checked(answer)["range"]
    assert found["value"] == 2 / 80
    assert (found["points_in_tension"], found["points_denser_than_e_d"], found["points_looser_than_e_i"]) == (1, 1, 0)
    [warning] = [it for it in answer.warnings() if "range" in it]
    assert "1 points in tension, 1 points denser than e d, the first at y = 0.00175 m" in warning


def test_a_cell_turned_inside_out_is_found() -> None:
    body, answer = sheared()
    answer._accounts.gradients[7] = [0.0, 0.0, 0.0, -1.5]
    found = checked(answer)["mass"]
    assert (found["value"], found["holds"]) == (None, False)
    assert found["where"] == f"y = {body.problem.state.coordinates[7, 0]:.6g} m"
    assert any("disagree by inf in the volume" in it for it in answer.warnings())


def test_a_wrong_account_is_found() -> None:
    _, answer = sheared()
    sums = answer._accounts.sums
    share = sums.external / sums.turnover
    assert 0.5 < share <= 1
    sums.external *= 1 + 1e-6
    found = checked(answer)["energy"]
    assert found["value"] == pytest.approx(1e-6 * share, rel=1e-3)
    told = f"the work put in and that of the stresses differ by {found['value']:.3g} of the energy turned over"
    assert any(it.startswith(told) for it in answer.warnings())
    sums.external *= -1 / (1 + 1e-6)
    assert checked(answer)["energy"]["value"] == pytest.approx(2 * share, rel=1e-6)


def test_stresses_that_give_back_more_than_they_took_are_found() -> None:
    _, answer = sheared()
    sums = answer._accounts.sums
    sums.recoverable = 1.5 * sums.stresses
    found = checked(answer)["dissipation"]
    assert not found["holds"]
    assert found["value"] == pytest.approx(0.5 * sums.stresses / sums.turnover)
    told = f"the stresses give back more than was put in, by {found['value']:.3g} of the energy turned over"
    assert any(it.startswith(told) for it in answer.warnings())


def test_a_solver_that_was_told_to_give_up_early_is_found() -> None:
    """Whoever loosens the solver behind the scene's back is told how far from equilibrium the answer is."""
    _, answer = sheared('solver.petsc={snes_convergence_test="skip", snes_max_it=2}', "geometry.cells=20")
    found = checked(answer)
    assert found["equilibrium"]["value"] > 10 * found["equilibrium"]["limit"]
    assert any(it.startswith("the answer is not in equilibrium") for it in answer.warnings())
