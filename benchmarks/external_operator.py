"""The same law behind dolfinx-external-operator: time of a Newton iteration and memory, against this project's way.

    pip install --no-deps dolfinx-external-operator
    python benchmarks/external_operator.py --out DIR

Both have the same mesh, unknowns, kinematics and conditions, and the same compiled update gives stress and tangent to
both. Behind the interface it is an external operator whose operand is the strain increment; its derivative hands back
stress and tangent together, so that the law is integrated once an iteration. Both solve with the same factors.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Annotated, Any

import basix.ufl
import matplotlib.pyplot as plt
import numpy as np
import typer
import ufl
from timing_pairs import alternately, peak_memory, ratio, seconds, spread, table, write

from cosserat_fx import geometry
from cosserat_fx._compat import MPI, PETSc, dolfinx
from cosserat_fx.conditions import Prescribed
from cosserat_fx.forms import balance, kinematics
from cosserat_fx.linear_solver import factors
from cosserat_fx.material import Material
from cosserat_fx.problem import Problem
from cosserat_fx.typing import Array
from cosserat_fx.weakform import Numerics, split

try:
    import dolfinx_external_operator as external
except ImportError:
    external = None

MISSING = "dolfinx-external-operator is not installed: pip install --no-deps dolfinx-external-operator"
CELLS, QUICK_CELLS = 200, 12
ROUNDS, QUICK_ROUNDS = 11, 3
SIZE, SHEAR, SCATTER = 0.1, 0.001, 0.02
"""Of the square (m), shear of its boundary (m) in a step, scatter of the void ratio."""
WAYS = {"ours": "cosserat_fx", "theirs": "dolfinx-external-operator"}
PHASES = "strains", "law", "residual", "Jacobian", "solution"
INTERFACE = "strains", "residual", "Jacobian"
"""What the two do differently: all but the law itself and the factors."""


def body(cells: int) -> Problem:
    """A square of Q1 cells with uneven void ratio, whose boundary is sheared."""

    def along(at: Array) -> Array:
        return at[:, 1:2] / SIZE

    sides = "bottom", "top", "left", "right"
    held: list[Prescribed] = []
    for side in sides:
        held.append(Prescribed(side, "u1", lambda travel: (travel,), profile=along))
        held.append(Prescribed(side, "u2", lambda travel: 0.0))
    points = 4 * cells**2
    void_ratio = 0.6 + SCATTER * np.random.default_rng(1).uniform(-1, 1, points)
    square = geometry.rectangle(SIZE, SIZE, (cells, cells), MPI.COMM_SELF)
    return Problem(
        square,
        Material.named("paper-sand", d50=1e-3),
        held,
        stress=-100e3,
        void_ratio=void_ratio,
        numerics=Numerics(degree=3),
    )


class Ours:
    """An iteration as the project makes it."""

    def __init__(self, problem: Problem) -> None:
        """Prepare.

        Args:
            problem: the body.
        """
        self._problem = problem
        self._ksp = factors(problem)
        self._x = problem.vector.duplicate()

    def iterate(self) -> tuple[dict[str, float], Array]:
        """Seconds by phase, and the change of the unknown."""
        problem = self._problem
        watch = problem.stopwatch.seconds
        before = dict(watch)
        failure = problem.update(adapt=False)
        assert failure is None, str(failure)
        problem.assemble_residual(problem.vector)
        problem.assemble_jacobian()
        self._ksp.setOperators(problem.matrix)
        solution = seconds(lambda: self._ksp.solve(problem.vector, self._x))
        names = {
            "strains": "strains",
            "law": "constitutive update",
            "residual": "residual assembly",
            "Jacobian": "Jacobian assembly",
        }
        phases = {mine: watch[name] - before.get(name, 0.0) for mine, name in names.items()}
        return phases | {"solution": solution}, self._x.array_r.copy()


class Theirs:
    """The same iteration with the law behind external operators."""

    def __init__(self, problem: Problem) -> None:
        """Write the forms anew, with an operator in place of the stresses.

        Args:
            problem: whose mesh, space, fields, conditions and constitutive state are taken; its own forms are not used.
        """
        self._problem = problem
        mesh, space, layout = problem.geometry.mesh, problem.space, problem.layout
        trial = ufl.TrialFunction(space)
        v, q = ufl.TestFunctions(space)
        q = q / problem.material.d50
        u, w = split(problem.unknown, polar=True)
        u_n, w_n = split(problem.committed, polar=True)
        step = kinematics.increments(u, u_n, w, w_n, "plane", finite=True)
        operand = kinematics.pack(
            (step.strain, layout.strain), (step.curvature, layout.curvature), (step.spin, layout.spin)
        )
        strain, curvature = kinematics.virtual_strain(v, q, u, "plane", finite=True)
        virtual = kinematics.pack((strain, layout.strain), (curvature, layout.curvature))
        volume = kinematics.determinant(kinematics.deformation_gradient(u, "plane", finite=True), "plane")
        degree = problem.numerics.degree
        dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": degree, "quadrature_scheme": "default"})
        conjugate = len(layout.strain_slots)
        at_points = basix.ufl.quadrature_element(mesh.basix_cell(), value_shape=(conjugate,), degree=degree)
        self._stress = external.FEMExternalOperator(
            operand, function_space=dolfinx.fem.functionspace(mesh, at_points), external_function=self._law
        )
        work = balance.internal_work(self._stress, range(conjugate), [1.0] * conjugate, virtual, volume, dx)
        residual, _ = external.replace_external_operators(work)
        jacobian = ufl.algorithms.expand_derivatives(ufl.derivative(work, problem.unknown, trial))
        jacobian, self._operators = external.replace_external_operators(jacobian)
        # The derivative's operators are those whose evaluation also hands back the stress.
        self._operators = [o for o in self._operators if any(o.derivatives)]
        self._residual, self._jacobian = dolfinx.fem.form(residual), dolfinx.fem.form(jacobian)
        self._matrix = dolfinx.fem.petsc.create_matrix(self._jacobian)
        self._b = problem.vector.duplicate()
        self._x = problem.vector.duplicate()
        self._ksp: PETSc.KSP = factors(problem)
        self._seconds = 0.0

    def _law(self, derivatives: tuple[int, ...]) -> Any:
        """What evaluates the operator's derivative."""
        assert any(derivatives)
        return self._tangent

    def _tangent(self, increments: Array) -> tuple[Array, Array]:
        """Tangent and stresses at all points."""
        state = self._problem.state
        rows = increments.reshape(len(state.points), -1)

        def update() -> None:
            state.update(rows, adapt=False)

        self._seconds = seconds(update)
        forces = state.forces.x.array.reshape(len(state.points), -1)
        return state.tangent.x.array, forces[:, self._problem.layout.strain_slots].reshape(-1)

    def iterate(self) -> tuple[dict[str, float], Array]:
        """Seconds by phase, and the change of the unknown."""
        phases: dict[str, float] = {}
        held = self._problem.prescribed

        def evaluate() -> None:
            operands = external.evaluate_operands(self._operators)
            [(_, stress)] = external.evaluate_external_operators(self._operators, operands)
            self._stress.ref_coefficient.x.array[:] = stress

        def assemble_residual() -> None:
            self._b.set(0.0)
            dolfinx.fem.petsc.assemble_vector(self._b, self._residual)
            self._b.array_w[held.dofs] = self._problem.unknown.x.array[held.dofs] - held.values

        def assemble_jacobian() -> None:
            self._matrix.zeroEntries()
            dolfinx.fem.petsc.assemble_matrix(self._matrix, self._jacobian, bcs=held.bcs)
            self._matrix.assemble()

        def solve() -> None:
            self._ksp.setOperators(self._matrix)
            self._ksp.solve(self._b, self._x)

        phases["strains"] = seconds(evaluate) - self._seconds
        phases["law"] = self._seconds
        phases["residual"] = seconds(assemble_residual)
        phases["Jacobian"] = seconds(assemble_jacobian)
        phases["solution"] = seconds(solve)
        return phases, self._x.array_r.copy()


def prepared(cells: int) -> Problem:
    """The body in the middle of a step."""
    problem = body(cells)
    problem.apply(SHEAR * SIZE)
    place = problem.fields["u1"]
    problem.unknown.x.array[place.dofs] = SHEAR * place.coordinates[:, 1]
    problem.state.restart_substeps()
    failure = problem.update(adapt=True)
    assert failure is None, str(failure)
    return problem


def measure(cells: int, rounds: int) -> dict[str, Any]:
    """Both ways in turn, in this process."""
    problem = prepared(cells)
    ways = {"ours": Ours(problem), "theirs": Theirs(problem)}
    changes = {name: way.iterate()[1] for name, way in ways.items()}
    difference = np.linalg.norm(changes["ours"] - changes["theirs"]) / np.linalg.norm(changes["ours"])
    phases: dict[str, defaultdict[str, list[float]]] = {name: defaultdict(list) for name in ways}

    def case(name: str) -> float:
        found, _ = ways[name].iterate()
        for phase, value in found.items():
            phases[name][phase].append(value)
        return sum(found.values())

    times = alternately({name: (lambda name=name: case(name)) for name in ways}, rounds)
    interface = {
        name: [sum(parts) for parts in zip(*(phases[name][phase][1:] for phase in INTERFACE), strict=True)]
        for name in ways
    }
    return {
        "cells": cells,
        "unknowns": problem.sizes["unknowns"],
        "points": problem.sizes["quadrature_points"],
        "difference_of_solutions": float(difference),
        "ours_over_theirs": ratio(times["ours"], times["theirs"])._asdict(),
        "ours_over_theirs_around_the_law": ratio(interface["ours"], interface["theirs"])._asdict(),
        "seconds": {name: spread(times[name])._asdict() for name in ways},
        "phases": {name: {phase: spread(phases[name][phase][1:]).median for phase in PHASES} for name in ways},
    }


def memory_of(cells: int, way: str) -> int:
    """Largest memory of a process that makes two iterations in one way (bytes)."""
    problem = prepared(cells)
    iteration = Ours(problem) if way == "ours" else Theirs(problem)
    if way == "theirs":
        problem.matrix.destroy()  # they have one of their own
    for _ in range(2):
        iteration.iterate()
    return peak_memory()


def in_a_process(cells: int, way: str) -> int:
    """:func:`memory_of` in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, "--memory-of", way, "--cells", str(cells)],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(done.stderr)
    return int(json.loads(done.stdout.splitlines()[-1]))


def report(found: dict[str, Any]) -> str:
    """The text of the benchmark."""
    rows = []
    for way, name in WAYS.items():
        phases = [f"{1e3 * found['phases'][way][phase]:.3g}" for phase in PHASES]
        whole = f"{1e3 * found['seconds'][way]['median']:.3g}"
        rows.append([name, *phases, whole, f"{found['memory'][way] / 1e6:.0f}"])
    leads = found["ours_over_theirs"], found["ours_over_theirs_around_the_law"]
    told = [f"{lead['median']:.2f} ({lead['lower']:.2f} to {lead['upper']:.2f})" for lead in leads]
    cells, unknowns, points = (found[key] for key in ("cells", "unknowns", "points"))
    return (
        f"A square of {cells} x {cells} Q1 cells ({unknowns} unknowns, {points} points): milliseconds of a Newton\n"
        "iteration by phase, medians, and the largest memory of a process (MB).\n\n"
        + table(["", *PHASES, "all", "memory"], rows)
        + f"\nThe iteration takes {told[0]} of the other's time. Law and factors are the same in both;\n"
        f"what remains takes {told[1]} of the other's time (median of the ratios with their quartiles).\n"
        f"The solutions differ by {found['difference_of_solutions']:.1g}, relatively.\n"
    )


def draw(file: Path, found: dict[str, Any]) -> None:
    """Draw phases and memory of both."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 2.6), width_ratios=(2, 1), constrained_layout=True)
    colours = dict(zip(PHASES, ("#9ecae1", "#3182bd", "#fdd0a2", "#e6550d", "#969696"), strict=True))
    for row, way in enumerate(WAYS):
        start = 0.0
        for phase in PHASES:
            value = 1e3 * found["phases"][way][phase]
            left.barh(row, value, 0.6, left=start, color=colours[phase], label=None if row else phase)
            start += value
    left.set(yticks=range(len(WAYS)), yticklabels=list(WAYS.values()), xlabel="milliseconds of a Newton iteration")
    right.barh(range(len(WAYS)), [found["memory"][way] / 1e6 for way in WAYS], 0.6, color="#74a9cf")
    right.set(yticks=[], xlabel="largest memory / MB")
    for axes in (left, right):
        axes.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=len(PHASES), frameon=False)
    figure.savefig(file, dpi=150)
    plt.close(figure)


def main(
    out: Annotated[Path | None, typer.Option(help="Folder for figures, table and picture.")] = None,
    quick: Annotated[bool, typer.Option(help="Only a small mesh.")] = False,
    memory_way: Annotated[str | None, typer.Option("--memory-of", hidden=True)] = None,
    cells: Annotated[int, typer.Option(hidden=True)] = CELLS,
) -> None:
    """Measure, and write external_operator.json, external_operator.md and external_operator.png."""
    if external is None:
        print(f"skipped: {MISSING}")
        return
    if memory_way is not None:
        print(json.dumps(memory_of(cells, memory_way)))
        return
    if out is None:
        raise typer.BadParameter("must be given", param_hint="--out")
    cells, rounds = (QUICK_CELLS, QUICK_ROUNDS) if quick else (cells, ROUNDS)
    found = measure(cells, rounds)
    found["memory"] = {way: in_a_process(cells, way) for way in WAYS}
    print(f"ours over theirs: {found['ours_over_theirs']}", flush=True)
    write(out, "external_operator", found, report(found))
    draw(out / "external_operator.png", found)


if __name__ == "__main__":
    typer.run(main)
