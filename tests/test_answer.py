"""The audit of the answer: what holds in a run that went well, and that every fault is found, with its number."""

import json
import re
from math import log
from pathlib import Path
from typing import Any

import numpy as np
import pages
import planes
import pytest
import reference_law
from answers import SHORT, TOLERANCE, assert_holds, checked, sheared, squeezed
from console import STOPPED, Call, quick
from halves import first_half
from layers import D50, SAND, demo, scene
from planes import BIAXIAL, PRESSURE
from points import components, draw, increment_tensors, tensors
from ranks import on_ranks
from reference_law import contract
from scenes import change

from cosserat_fx import layer
from cosserat_fx._compat import MPI
from cosserat_fx.answer.accounts import Accounts
from cosserat_fx.answer.power import build_power
from cosserat_fx.answer.report import Answer
from cosserat_fx.layout import Dimension, layout
from cosserat_fx.results import Run, read_run
from cosserat_fx.run import run
from cosserat_fx.scene import parse_scene

CHECKS = ("equilibrium", "reactions", "mass", "range", "energy", "dissipation")


# -- runs that went well -----------------------------------------------------------------------------------------------


def test_the_demos_answers_hold(default_run: Run) -> None:
    found = default_run.summary["answer"]
    assert tuple(found) == CHECKS
    assert all(it["holds"] for it in found.values())
    assert found["mass"]["limit"] < 1e-4
    assert found["energy"]["limit"] < 100 * TOLERANCE


def test_the_work_put_in_is_that_of_the_walls(default_runs: dict[str, Run]) -> None:
    """Under a very rough wall that is the area under the curve of the history, and the pressure's on the rise."""
    run = default_runs["very_rough"]
    u, shear, rise = (
        np.concatenate([[0.0], run.history[name]])
        for name in ("top_displacement_m", "shear_stress_Pa", "height_change_m")
    )
    work = np.trapezoid(shear, u) - PRESSURE * rise[-1]
    assert run.summary["answer"]["energy"]["put_in_J_per_m2"] == pytest.approx(work, rel=1e-7)


def test_what_a_layer_dissipates_is_nearly_all_that_is_put_in(default_run: Run) -> None:
    """The elastic energy of a layer of height h is of the order of tau^2 h/(2 G), a few J/m2."""
    found = default_run.summary["answer"]
    put_in, dissipated = found["energy"]["put_in_J_per_m2"], found["dissipation"]["dissipated_J_per_m2"]
    stiffness = SAND.shear_stiffness(PRESSURE, np.array([0.6]))[0]
    assert 0 < put_in - dissipated < 5 * (0.6 * PRESSURE) ** 2 * 0.04 / (2 * stiffness)


LAYERS = {
    "small strain": ("effects.finite_strain=false",),
    "classical": ("effects.polar=false", "walls.top.rolling=0"),
    "spin of the grains": ('effects.spin="cosserat"',),
    "no spin": ('effects.spin="none"',),
    "frozen void ratio": ("effects.void_ratio=false",),
    "two points": ("solver.integration_points=2",),
    "weight": ("weight.density=1700",),
    "raised pressure": ("walls.top.normal_stress=-300e3",),
    "constant height": ("walls.top={constant_height=true, shear_displacement=0.002}",),
    "to and fro": ("walls.top.shear_displacement=[3e-4, -3e-4, 3e-4]",),
}


@pytest.mark.parametrize("case", LAYERS)
def test_the_answer_of_a_layer_holds(case: str) -> None:
    _, answer = sheared("geometry.cells=20", *LAYERS[case])
    found = assert_holds(answer)
    assert ("mass" in found) == (case != "frozen void ratio")
    assert found["dissipation"]["dissipated_J_per_m2"] > 0
    if case == "small strain":
        assert found["mass"]["limit"] < 1e-11  # the sum of the traces is the trace of the sum


SHEARED = {
    "boundaries": {
        "bottom": {"wall": {"rolling": 0.0}},
        "top": {"wall": {"rolling": 0.02, "u1": 0.002, "pressure": PRESSURE}},
        "left": {"pressure": PRESSURE},
        "right": {"t1": -PRESSURE, "rotational_resistance": 10.0},
    },
    "weight": {"density": 1700.0},
    "points": {},
}
"""Between a wall at rest and a rolling one that carries a pressure, with a dead traction, springs and weight."""
PLANES: dict[str, dict[str, Any]] = {
    "squeezed between plates and held at a point": {},
    "walls, pressures, springs and weight": SHEARED,
    "the same of small strain": SHEARED | {"effects.finite_strain": False},
    "classical": {"effects.polar": False},
    "spin of the grains": SHEARED | {"effects.spin": "cosserat"},
    "no spin": SHEARED | {"effects.spin": "none"},
    "frozen void ratio": {"effects.void_ratio": False},
    "2 x 2 points": {"solver.element": "Q1", "weight": {"density": 1700.0}},
    "quadratic": {"solver.element": "Q2Q1", "weight": {"density": 1700.0}},
    "couple": {"boundaries.right.couple": [5.0]},
}


@pytest.mark.parametrize("case", PLANES)
def test_the_answer_of_a_plane_body_holds(case: str) -> None:
    _, answer = squeezed(PLANES[case])
    found = assert_holds(answer)
    assert ("mass" in found) == (case != "frozen void ratio")
    assert found["dissipation"]["dissipated_J_per_m"] > 0


def test_forces_and_moments_balance_in_a_body_that_has_turned() -> None:
    """By more than 20 degrees about a corner, under a pressure that follows it all around and points that hold it."""
    everywhere = {name: {"pressure": PRESSURE} for name in ("bottom", "top", "left", "right")}
    points = {"hinge": {"at": [0.0, 0.0], "u1": 0.0, "u2": 0.0}, "end": {"at": [0.02, 0.0], "u2": 0.008}}
    body, answer = squeezed({"boundaries": everywhere, "points": points, "effects.finite_strain": True})
    assert body.problem.boundary_mean("right", "u2") > 0.02 * np.sin(np.radians(20))
    found = assert_holds(answer)
    assert found["reactions"]["value"] < TOLERANCE


# -- how it is worked out ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("polar", [True, False])
@pytest.mark.parametrize("dimension", ["layer", "plane"])
def test_the_dissipated_part_of_a_small_step_is_what_the_theory_says(dimension: Dimension, polar: bool) -> None:
    """Of random states and directions, against the closed form, with rates of the reference law."""
    one = layout(dimension, polar=polar)
    forces, e, increments = draw(one, 40, (1e-9, 1e-9), seed=11)
    state, step = tensors(one, forces, e), increment_tensors(one, increments)
    rates = reference_law.rate(state, step, SAND)
    power = build_power(one, finite=False)
    none, one_point = np.zeros((1, 4)), np.zeros(1, dtype=np.int32)
    dissipated = []
    for row, change_ in enumerate(components(one, rates)):
        n = forces[[row]], e[[row]]
        end = n[0] + change_, n[1] + rates.void_ratio[row]
        constants = SAND.kernel_parameters()
        work, recoverable, _ = power(increments[[row]], one_point, *n, *end, none, none, np.ones(1), constants)
        dissipated.append(work - recoverable)
    sigma_kk = reference_law.trace(state.stress)
    s, m = reference_law.scaled(1 / sigma_kk, state.stress), reference_law.scaled(1 / (D50 * sigma_kk), state.couple)
    d, k = step.strain, D50 * step.curvature
    a, (_, f_d) = reference_law.critical_factor(s, SAND), reference_law.factors(sigma_kk, e, SAND)
    ss, mm, norm = contract(s, s), contract(m, m), np.sqrt(contract(d, d) + contract(k, k))
    numerator = (2 * ss - 1 / 3) / a + 2 * mm / SAND.a_c
    expected = -sigma_kk * f_d * norm * numerator / (1 + ss / a**2 + mm / SAND.a_c**2)
    assert np.all(expected > 0)
    assert dissipated == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("finite", [True, False])
def test_the_sums_over_points_and_over_nodes_are_one(finite: bool) -> None:
    """Of a body that has been turned by half a radian and then bends, stretches and turns on, to rounding."""
    problem = planes.build(SHEARED | {"effects.finite_strain": finite}).problem
    if finite:
        turn = np.array([[np.cos(0.5) - 1, -np.sin(0.5)], [np.sin(0.5), np.cos(0.5) - 1]])
        for row, name in zip(turn, ("u1", "u2"), strict=True):
            part = problem.fields[name]  # type: ignore[index]
            problem.committed.x.array[part.dofs] = part.coordinates @ row
        problem.resume(0.0)
    accounts = Accounts(problem)
    problem.before_commit = accounts.add
    rng = np.random.default_rng(5)
    for _ in range(3):
        problem.unknown.x.array[:] += rng.uniform(-1, 1, len(problem.unknown.x.array)) * 2e-5
        assert problem.update(adapt=True) is None
        problem.commit()
    assert accounts.sums.turnover > 1e-3
    work = accounts.sums.stresses + problem.hourglass_energy()
    assert work == pytest.approx(problem.internal_work, rel=1e-10)


def test_the_rule_for_the_volume_is_bounded_by_its_error() -> None:
    """One step of uniaxial compression by 20 %: the law sees -0.2/0.9 and not log 0.8."""
    one = layout("layer", polar=False)
    power = build_power(one, finite=True)
    forces = np.full((1, len(one.forces)), -PRESSURE)
    shrunk = np.array([[0.0, 0.0, 0.0, -0.2]])
    increments = np.array([[-0.2 / 0.9, 0.0, 0.0]])
    void_ratio, point = np.full(1, 0.8), np.zeros(1, dtype=np.int32)
    state = forces, void_ratio, forces, void_ratio
    _, _, rule = power(increments, point, *state, 0 * shrunk, shrunk, np.ones(1), SAND.kernel_parameters())
    assert rule == pytest.approx(-0.2 / 0.9 - log(0.8), rel=1e-12)
    assert rule == pytest.approx((0.2 / 0.9) ** 3 / 12, rel=0.05)


# -- where it is told --------------------------------------------------------------------------------------------------


def test_the_accounts_go_on_where_a_memento_was_taken() -> None:
    body = layer.build(scene("medium_rough", *SHORT), MPI.COMM_SELF)
    answer = Answer(body)
    for step in body.stepper:
        answer.observe(step)
        memento = json.loads(json.dumps(answer.memento()))
        answer._accounts = Accounts(body.problem)
        body.problem.before_commit = answer._accounts.add
        answer.restore(memento)
    _, uninterrupted = sheared()
    assert answer._accounts.sums == uninterrupted._accounts.sums
    assert checked(answer) == checked(uninterrupted)


@pytest.mark.parametrize("changes", [BIAXIAL, BIAXIAL | SHEARED])
def test_a_run_in_two_halves_gives_the_answer_of_one(changes: dict[str, Any], tmp_path: Path) -> None:
    """A run that was interrupted says what it knows, and once it has been gone on with, what it would have said."""
    quiet = {"figures": False, "fields": False}
    tables = parse_scene(change(planes.BASE, changes | {"output": quiet}))
    first_half(tables, tmp_path / "halves")
    half = read_run(tmp_path / "halves").summary["answer"]
    run(tables, tmp_path / "halves", resume=True, comm=MPI.COMM_SELF)
    run(tables, tmp_path / "whole", comm=MPI.COMM_SELF)
    halves, whole = (read_run(tmp_path / it).summary["answer"] for it in ("halves", "whole"))
    assert all(it["holds"] for it in half.values())
    assert halves == whole
    assert 0 < half["energy"]["put_in_J_per_m"] < whole["energy"]["put_in_J_per_m"]


_SEVERAL = """
import json, sys
sys.path.insert(0, sys.argv[1])
import planes
from cosserat_fx import plane
from cosserat_fx._compat import MPI
from cosserat_fx.answer.report import Answer
from cosserat_fx.scene import parse_scene
body = plane.build(parse_scene(json.loads(sys.argv[2])), MPI.COMM_WORLD)
answer = Answer(body)
for step in body.stepper:
    answer.observe(step)
    if step.number == 4:
        break
state = body.problem.state
if len(state.cells) and MPI.COMM_WORLD.rank == MPI.COMM_WORLD.size - 1:
    state.e_n[state.points[-1]] *= 1.01
answer.check()
found = MPI.COMM_WORLD.gather([answer.entries(), answer.warnings(), answer.line()])
if found:
    print(json.dumps(found))
"""


@pytest.mark.parametrize("ranks", [2, 3])
def test_several_ranks_find_the_same(ranks: int) -> None:
    """Every rank says what one alone does; a fault on the last one is found by all."""
    tables = change(change(planes.BASE, BIAXIAL), SHEARED)
    found = json.loads(on_ranks(ranks, _SEVERAL, Path(__file__).parent, json.dumps(tables)))
    entries, warnings, line = found[0]
    assert found == [[entries, warnings, line]] * ranks
    assert len(warnings) == 1
    assert warnings[0].startswith("mass is not conserved")
    _, alone = squeezed(SHEARED, steps=4)
    for name, it in checked(alone).items():
        assert entries[name]["holds"] == (name != "mass")
        for key, value in it.items():
            if key.endswith("_J_per_m"):
                assert entries[name][key] == pytest.approx(value, rel=1e-7)


def test_a_run_says_it_in_one_line(call: Call, tmp_path: Path) -> None:
    outcome = call("run", demo("very_rough"), "--out", tmp_path / "run", *quick())
    [line] = [it for it in outcome.out.splitlines() if it.startswith("answer: ")]
    number = r"\de[+-]\d\d"
    expected = rf"equilibrium {number}, reactions {number}, mass {number}, energy {number}, \S+ J/m2 dissipated, "
    assert re.fullmatch(f"answer: {expected}all points admissible", line)


def test_a_run_that_stops_says_it_too(call: Call, tmp_path: Path) -> None:
    outcome = call("run", demo("very_rough"), "--out", tmp_path / "run", *quick("stepping.max_steps=1"))
    assert outcome.status == STOPPED
    assert "answer: equilibrium " in outcome.out
    assert all(it["holds"] for it in read_run(tmp_path / "run").summary["answer"].values())


def test_a_violated_check_is_told_with_its_limit() -> None:
    body, answer = sheared()
    answer._accounts.sums.external *= 1.001
    answer.check()
    assert re.search(r"energy \de-04 \(limit \de-\d\d\)", answer.line())
    body.problem.state.e_n[body.problem.state.points[:8]] *= 2
    answer.check()
    assert answer.line().endswith("10 % of the points not admissible")


def test_the_page_lists_the_checks() -> None:
    _, answer = sheared("geometry.cells=4")
    found = checked(answer)
    assert pages.column("docs/output.md", "answer") == list(found)
    numbers = {key.removesuffix("_J_per_m2") for it in found.values() for key in it}
    told = pages.column("docs/output.md", "answer", 2) + pages.column("docs/output.md", "entries of a check")
    assert {it.removesuffix("_J_per_m2") for it in told} >= numbers
