"""How linear systems are solved: the choice, the iterative solver against factors, and factors where it fails."""

import json
from typing import get_args

import numpy as np
import pytest
from planes import BIAXIAL, D50, DEMO, PRESSURE, build
from ranks import on_ranks
from scenes import change

from cosserat_fx import geometry, memory, plane
from cosserat_fx._compat import MPI, PETSc
from cosserat_fx.elements import ELEMENTS
from cosserat_fx.linear_solver import CROSSOVER, FACTORS_PREFIX, Kind, LinearSolver, choose
from cosserat_fx.material import Material
from cosserat_fx.memory import Sizes, footprint
from cosserat_fx.newton import NewtonSolver
from cosserat_fx.numerics import numerics
from cosserat_fx.plane import Plane
from cosserat_fx.problem import Problem
from cosserat_fx.scene import PlaneScene, parse_scene
from cosserat_fx.typing import Array
from cosserat_fx.weakform import Numerics

ITERATIVE = {"solver.linear": "iterative"}
REFINED = {"output": {"figures": False, "fields": False}, "stepping.max_steps": 4}


# -- what multigrid is told --------------------------------------------------------------------------------------------


def free_body(element: str) -> Problem:
    """Four by six cells of small strain that nothing holds."""
    chosen = ELEMENTS[element]
    kind = Numerics(
        finite=False, spin="none", order=chosen.order, degree=chosen.degree, hourglass=0.01 * chosen.stabilised
    )
    body = geometry.rectangle(0.02, 0.03, (4, 6), MPI.COMM_SELF)
    return Problem(body, Material.named("paper-sand", d50=D50), [], stress=-PRESSURE, void_ratio=0.6, numerics=kind)


def motions(problem: Problem) -> dict[str, Array]:
    """Translations, the rotation of body and grains together, and that of the grains' centres alone."""
    found = {name: np.zeros(problem.vector.getLocalSize()) for name in ("u1", "u2", "rigid", "centres")}
    for name in ("u1", "u2"):
        part = problem.fields[name]
        found[name][part.dofs] = 1.0
        x, y = part.coordinates.T
        for motion in ("rigid", "centres"):
            found[motion][part.dofs] = -y if name == "u1" else x
    found["rigid"][problem.fields["w"].dofs] = 1.0
    return found


@pytest.mark.parametrize("element", ["Q1R", "Q1", "Q2Q1"])
def test_translations_are_all_that_the_displacements_alone_do_not_resist(element: str) -> None:
    """A rotation of the centres that the grains do not follow shears a Cosserat continuum."""
    problem = free_body(element)
    assert problem.update(adapt=True) is None
    problem.assemble_jacobian()
    held = problem.fields["w"].dofs
    forces = {}
    for name, motion in motions(problem).items():
        given, answer = problem.matrix.createVecs()
        given.array_w[:] = motion
        problem.matrix.mult(given, answer)
        answer.array_w[held] = 0.0  # the block of the displacements
        forces[name] = answer.norm() / motion.max()
    scale = forces["centres"]
    assert scale > 1.0
    assert all(forces[name] < 1e-9 * scale for name in ("u1", "u2", "rigid"))


# -- the choice --------------------------------------------------------------------------------------------------------


def test_size_decides() -> None:
    below, above = (choose("auto", "plane", n) for n in (CROSSOVER - 1, CROSSOVER))
    assert (below.kind, above.kind) == ("direct", "iterative")
    assert above.beside
    assert str(CROSSOVER - 1) in below.reason
    assert str(CROSSOVER) in above.reason
    assert choose("auto", "layer", 10 * CROSSOVER).kind == "direct"


def test_where_factors_do_not_fit_none_are_made() -> None:
    small = choose("auto", "plane", 100, factors_fit=False, beside_fit=False)
    assert (small.kind, small.beside) == ("iterative", False)
    assert not choose("auto", "plane", CROSSOVER, beside_fit=False).beside


@pytest.mark.parametrize("wish", ["direct", "iterative"])
def test_the_scene_decides(wish: str) -> None:
    for unknowns in (100, 10 * CROSSOVER):
        assert choose(wish, "plane", unknowns).kind == wish  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"pc_type": "jacobi"}, "given"),
        ({"pc_factor_mat_solver_type": "petsc"}, "direct"),
        ({"ksp_type": "gmres"}, "direct"),
        ({"mat_mumps_icntl_7": 5}, "direct"),
        ({"snes_monitor": ""}, "iterative"),
        ({"ksp_rtol": 1e-8}, "iterative"),
    ],
)
def test_options_for_petsc_go_first(options: dict[str, str | int | float], kind: str) -> None:
    assert choose("iterative", "plane", 100, options=options).kind == kind


def test_options_reach_petsc() -> None:
    ksp = build(BIAXIAL | ITERATIVE | {"solver.petsc": {"ksp_rtol": 1e-7}}).stepper.solver.snes.getKSP()
    assert (ksp.getType(), ksp.getPC().getType()) == ("gmres", "fieldsplit")
    assert ksp.getTolerances()[0] == 1e-7
    given = build(BIAXIAL | ITERATIVE | {"solver.petsc": {"ksp_type": "cg", "pc_type": "jacobi"}})
    assert given.stepper.solver.snes.getKSP().getType() == "cg"
    assert given.stepper.solver.linear.choice.kind == "given"


# -- the solution ------------------------------------------------------------------------------------------------------


def linear_iterations(body: Plane) -> int:
    """Of GMRES in the linear answer to the first step, to eight digits."""
    body.problem.apply(body.path.corners[0] + body.stepper.control.first)
    body.stepper.solver.snes.getKSP().setTolerances(rtol=1e-8)
    assert body.stepper.solver.predict()
    assert not body.stepper.solver.linear.notes
    return int(body.stepper.solver.snes.getKSP().getIterationNumber())


@pytest.mark.parametrize("polar", [True, False])
@pytest.mark.parametrize("element", ["Q1R", "Q1"])
def test_iterations_do_not_grow_with_the_mesh(element: str, polar: bool) -> None:
    changes = {"solver.element": element, "effects.polar": polar, **ITERATIVE}
    found = [
        linear_iterations(build(changes | {"geometry.cells": [8 * n, 28 * n]}, change(DEMO, REFINED)))
        for n in (1, 2, 4)
    ]
    assert max(found) <= 1.3 * found[0]
    assert max(found) < 50


PROGRAM = """
import json, sys
from cosserat_fx import plane
from cosserat_fx._compat import MPI
from cosserat_fx.scene import parse_scene
body = plane.build(parse_scene(json.loads(sys.argv[1])), MPI.COMM_WORLD)
steps = []
try:
    for step in body.stepper:
        force = body.problem.boundary_forces()["top"]["force2"]
        steps.append([step.travel, force])
except Exception as stopped:
    assert "limit" in str(stopped), stopped
if MPI.COMM_WORLD.rank == 0:
    solver = body.stepper.solver
    print(json.dumps([steps, solver.snes.getKSP().getType(), solver.sees_branches, solver.linear.notes]))
"""


@pytest.mark.parametrize("ranks", [1, 2])
def test_both_solvers_find_the_same_equilibria(ranks: int) -> None:
    """To the tolerance of Newton's iteration; branches are watched either way."""
    tables = change(DEMO, {"geometry.cells": [8, 28], "initial.zones": [], "stepping.max_steps": 8})
    found = [
        json.loads(on_ranks(ranks, PROGRAM, json.dumps(change(tables, {"solver.linear": wish}))))
        for wish in ("direct", "iterative")
    ]
    (direct, *_), (iterative, _, sees, notes) = found
    assert np.asarray(iterative) == pytest.approx(np.asarray(direct), rel=1e-6)
    assert len(direct) == 8
    assert sees
    assert not notes


def test_options_outlive_the_making_of_another_solver() -> None:
    """Multigrid asks for its options when it is used first."""
    lone = linear_iterations(build(BIAXIAL | ITERATIVE))
    body = build(BIAXIAL | ITERATIVE)
    build(BIAXIAL)
    assert linear_iterations(body) == lone


# -- where it fails ----------------------------------------------------------------------------------------------------


def test_factors_stand_in_where_the_iterative_solver_fails() -> None:
    hasty = BIAXIAL | ITERATIVE | {"solver.petsc": {"ksp_max_it": 2, "ksp_rtol": 1e-9}}
    bodies = [build(changes) for changes in (BIAXIAL, hasty)]
    forces = []
    for body in bodies:
        steps = [step for step, _ in zip(body.stepper, range(3), strict=False)]
        assert not any(step.cutbacks for step in steps)
        forces.append(body.problem.boundary_forces()["top"]["force2"])
    assert forces[1] == pytest.approx(forces[0], rel=1e-6)
    [note] = bodies[1].stepper.solver.linear.notes
    assert (
        note
        == "the linear solver (gmres, fieldsplit) failed: diverged max it; where it fails, systems are solved directly"
    )


def test_where_the_factors_beside_fail_branches_are_not_watched_and_the_run_says_so() -> None:
    """MUMPS is allowed one megabyte."""
    database = PETSc.Options(FACTORS_PREFIX)
    database.setValue("mat_mumps_icntl_23", 1)
    try:
        body = build(BIAXIAL | ITERATIVE | {"geometry.cells": [60, 60]})
        body.problem.apply(body.path.corners[0] + body.stepper.control.first)
        assert body.stepper.solver.predict()
        assert body.stepper.solver.solve().converged
    finally:
        database.delValue("mat_mumps_icntl_23")
    [note] = body.stepper.solver.linear.notes
    assert "MUMPS could not factorise the tangent" in note
    assert note.endswith("branches of equilibrium are not watched")


def test_without_memory_for_factors_the_failure_is_told() -> None:
    problem = build(BIAXIAL).problem
    problem.apply(1e-5)
    alone = LinearSolver("iterative", "")
    solver = NewtonSolver(problem, options={"ksp_max_it": 2, "ksp_rtol": 1e-9}, linear=alone)
    assert not solver.predict()
    assert "the linear solver (gmres, fieldsplit) failed" in solver.failed_prediction().reason
    assert not solver.linear.notes
    assert not solver.sees_branches


def test_scarce_memory_makes_the_solution_iterative_and_the_run_says_what_is_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = parse_scene(change(DEMO, {"geometry.cells": [64, 224], "output.figures": False}))
    assert isinstance(scene, PlaneScene)
    sizes = Sizes("plane", "quadrilateral", 65 * 225, 64 * 224, 65)
    alone, iterative = (
        footprint(scene, numerics(scene, 1.0, sizes.cell), sizes, ranks=1, linear=LinearSolver(kind, "")).total
        for kind in get_args(Kind)[:2]
    )
    monkeypatch.setattr(memory, "memory_of_node", lambda: (alone + iterative) / 2)
    body = plane.build(scene, MPI.COMM_SELF)
    choice = body.stepper.solver.linear.choice
    assert (choice.kind, choice.beside) == ("iterative", False)
    assert "do not fit into the memory" in str(choice)
    assert any("no memory for the factors that would tell the tangent's determinant" in told for told in body.warnings)


def test_branches_are_watched_with_factors_beside() -> None:
    """Of a matrix with negative determinant, of one with a positive one."""
    body = build(BIAXIAL | ITERATIVE)
    solver, problem = body.stepper.solver, body.problem
    problem.apply(body.path.corners[0] + body.stepper.control.first)
    assert solver.predict()
    assert solver.solve().stable
    for sign in (-1.0, 1.0):
        row = int(problem.prescribed.dofs[0])
        solver.linear.assemble()
        problem.matrix.setValue(row, row, sign)
        problem.matrix.assemble()
        assert solver.linear.factorise()
        assert solver.linear.determinant_is_positive() is (sign > 0)
    assert isinstance(solver.snes, PETSc.SNES)
