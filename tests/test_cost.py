"""What a run is expected to cost, against what it does cost."""

from pathlib import Path

import pytest
from layers import DEMOS, NOTHING_TO_LOOK_AT

from cosserat_fx._compat import MPI, PETSc
from cosserat_fx.bodies import build
from cosserat_fx.cost import expected_cost
from cosserat_fx.results import read_run
from cosserat_fx.run import run
from cosserat_fx.scene import load_scene
from cosserat_fx.timing import duration

SCENES = ("layer_very_rough", "biaxial")


@pytest.mark.parametrize("name", SCENES)
def test_a_run_costs_about_what_was_expected(name: str, tmp_path: Path) -> None:
    """Sizes exactly, steps to a factor of two; seconds are for benchmarks."""
    scene = load_scene(DEMOS / f"{name}.toml", NOTHING_TO_LOOK_AT)
    body = build(scene, MPI.COMM_SELF)
    cost = expected_cost(body)
    info = body.problem.matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)
    assert cost.nonzeros == info["nz_used"]
    sizes = body.problem.sizes
    assert cost.state_bytes == sizes["quadrature_points"] * sizes["bytes_per_quadrature_point"]
    assert cost.factor_bytes is not None
    # MUMPS counts in megabytes, of which a layer may have none; factors fill in, so they outgrow the matrix.
    assert cost.factor_bytes > 8 * cost.nonzeros or name == "layer_very_rough"
    run(scene, tmp_path / "run")
    summary = read_run(tmp_path / "run").summary
    assert 0.5 < cost.steps / summary["steps"] < 2
    assert cost.update_seconds > 0
    assert cost.solver_seconds > 0


@pytest.mark.parametrize("name", SCENES)
def test_looking_at_the_cost_leaves_the_body_as_it_was(name: str) -> None:
    body = build(load_scene(DEMOS / f"{name}.toml", NOTHING_TO_LOOK_AT), MPI.COMM_SELF)
    problem = body.problem
    before = [a.copy() for a in (problem.unknown.x.array, problem.committed.x.array, problem.state.forces.x.array)]
    expected_cost(body)
    after = (problem.unknown.x.array, problem.committed.x.array, problem.state.forces.x.array)
    assert all((a == b).all() for a, b in zip(before, after, strict=True))


def test_another_solver_does_not_tell_the_size_of_its_factors() -> None:
    options = [*NOTHING_TO_LOOK_AT, 'solver.petsc.pc_factor_mat_solver_type="petsc"']
    cost = expected_cost(build(load_scene(DEMOS / "layer_very_rough.toml", options), MPI.COMM_SELF))
    assert cost.factor_bytes is None
    assert "factors" not in str(cost)


def test_no_more_steps_are_expected_than_are_allowed() -> None:
    options = [*NOTHING_TO_LOOK_AT, "stepping.max_steps=3"]
    assert expected_cost(build(load_scene(DEMOS / "layer_very_rough.toml", options), MPI.COMM_SELF)).steps == 3


def test_durations_are_told_to_two_digits() -> None:
    told = {0.1234: "0.12 s", 85.4: "85 s", 125.0: "2.1 min", 5399.0: "90 min", 7300.0: "2 h", 443_000.0: "120 h"}
    assert {seconds: duration(seconds) for seconds in told} == told
