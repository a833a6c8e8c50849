"""One Newton iteration against what any code must pay: one linear elastic assembly, factorisation and solution.

    python benchmarks/newton_floor.py --out DIR

The floor is a linear elastic Cosserat body of small strains with 2 x 2 points in bilinear cells, on the same mesh with
the same unknowns and conditions. An iteration is the Jacobian's assembly, factorisation and solution, and one
evaluation of the residual (strains, constitutive update with tangent, assembly), as the line search asks for.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import matplotlib.pyplot as plt
import typer
import ufl
from banded import Band, band, put_on, scene
from timing_pairs import alternately, ratio, seconds, spread, table, write

from cosserat_fx import plane
from cosserat_fx._compat import MPI, PETSc, dolfinx
from cosserat_fx.linear_solver import factors
from cosserat_fx.problem import Problem

MESHES = (40, 80), (100, 200), (200, 400)
QUICK = ((8, 16),)
TRAVEL, QUICK_TRAVEL = 0.008, 0.0005
"""Of the platen (m)."""
ROUNDS = {40: 21, 100: 11, 200: 5}
LAMBDA, MU, MU_C, COUPLE = 60e6, 40e6, 20e6, 40.0
"""Of the elastic body: moduli (Pa) and couple modulus (N), about those of the sand at 100 kPa."""
PHASES = "strains", "constitutive update", "residual assembly", "Jacobian assembly", "factorisation and solution"


class Floor:
    """The linear elastic body on a problem's mesh, with its unknowns and held where it is held."""

    def __init__(self, problem: Problem) -> None:
        """Compile the form and make the matrix.

        Args:
            problem: whose mesh, space and prescribed values are taken.
        """
        (u, w), (v, q) = ufl.TrialFunctions(problem.space), ufl.TestFunctions(problem.space)
        turn = ufl.as_matrix([[0, 1], [-1, 0]])
        strain, virtual = ufl.grad(u) + w * turn, ufl.grad(v) + q * turn
        stress = LAMBDA * ufl.tr(strain) * ufl.Identity(2) + (MU + MU_C) * strain + (MU - MU_C) * strain.T
        four_points = ufl.dx(problem.geometry.mesh, metadata={"quadrature_degree": 3})
        work = (ufl.inner(stress, virtual) + COUPLE * ufl.inner(ufl.grad(w), ufl.grad(q))) * four_points
        self._form = dolfinx.fem.form(work)
        self._bcs = problem.prescribed.bcs
        self._matrix = dolfinx.fem.petsc.create_matrix(self._form)
        self._ksp: PETSc.KSP | None = None
        self._problem = problem
        self._b = problem.vector.copy()
        self._x = self._b.duplicate()

    def assemble(self) -> None:
        """Assemble the matrix."""
        self._matrix.zeroEntries()
        dolfinx.fem.petsc.assemble_matrix(self._matrix, self._form, bcs=self._bcs)
        self._matrix.assemble()

    def solve(self) -> None:
        """Factorise and solve; the matrix is analysed the first time only, as it is in a run."""
        if self._ksp is None:
            self._ksp = factors(self._problem)
        self._ksp.setOperators(self._matrix)
        self._ksp.solve(self._b, self._x)
        assert self._ksp.getConvergedReason() > 0


def measure(state: Band, cells: tuple[int, int], element: str, rounds: int) -> dict[str, Any]:
    """Measure one mesh.

    Args:
        state: of the body.
        cells: of the mesh.
        element: of the Newton iteration.
        rounds: how often.
    """
    body = plane.build(scene(cells, element, linear="direct"), MPI.COMM_SELF)
    problem, system = body.problem, body.stepper.solver.linear
    put_on(state, body)
    problem.state.restart_substeps()
    failure = problem.update(adapt=True)
    assert failure is None, str(failure)
    floor = Floor(problem)
    b = problem.vector.copy()
    x = b.duplicate()
    phases: defaultdict[str, list[float]] = defaultdict(list)

    def solve() -> None:
        system.take()
        assert system.solve(b, x)

    def timed(call: Callable[[], object]) -> dict[str, float]:
        watch = problem.stopwatch.seconds
        before = dict(watch)
        call()
        return {name: watch[name] - before.get(name, 0.0) for name in PHASES[:-1]}

    def iteration() -> float:
        def evaluate() -> None:
            problem.update(adapt=False)
            problem.assemble_residual(problem.vector)
            system.assemble()

        found: dict[str, float] = {}
        whole = seconds(lambda: found.update(timed(evaluate)))
        found["factorisation and solution"] = seconds(solve)
        for name, value in found.items():
            phases[name].append(value)
        return whole + found["factorisation and solution"]

    parts: defaultdict[str, list[float]] = defaultdict(list)

    def elastic() -> float:
        found = {"assembly": seconds(floor.assemble), "factorisation and solution": seconds(floor.solve)}
        for name, value in found.items():
            parts[name].append(value)
        return sum(found.values())

    times = alternately({"iteration": iteration, "floor": elastic}, rounds)
    return {
        "cells": cells,
        "element": element,
        "unknowns": problem.sizes["unknowns"],
        "substeps": float(problem.state.substeps.mean()),
        "ratio": ratio(times["iteration"], times["floor"])._asdict(),
        "seconds": {name: spread(values)._asdict() for name, values in times.items()},
        "phases": {name: spread(phases[name][1:]).median for name in PHASES},
        "floor_phases": {name: spread(values[1:]).median for name, values in parts.items()},
    }


def report(meshes: list[dict[str, Any]]) -> str:
    """The text of the benchmark."""
    rows = []
    for m in meshes:
        floor = m["seconds"]["floor"]["median"]
        of_floor = [f"{100 * m['phases'][name] / floor:.0f} %" for name in PHASES]
        lead = m["ratio"]
        told = f"{lead['median']:.2f} ({lead['lower']:.2f} to {lead['upper']:.2f})"
        elastic = [f"{100 * value / floor:.0f} %" for value in m["floor_phases"].values()]
        rows.append([f"{m['cells'][0]} x {m['cells'][1]}", m["element"], told, *of_floor, " + ".join(elastic)])
    headings = ["cells", "element", "ratio", *PHASES, "floor: assembly + factors"]
    return (
        "One whole Newton iteration over one linear elastic assembly (2 x 2 points), factorisation and solution on\n"
        "the same mesh: median of the ratios with their quartiles, and the phases of the iteration in per cent of the\n"
        "floor. The body is the biaxial specimen past its peak, where points take "
        f"{meshes[-1]['substeps']:.2g} local substeps in the mean.\n\n" + table(headings, rows)
    )


def draw(file: Path, meshes: list[dict[str, Any]]) -> None:
    """Draw the phases of both as bars, relative to the floor."""
    figure, axes = plt.subplots(figsize=(8, 0.9 + 0.75 * len(meshes)), constrained_layout=True)
    colours = dict(zip(PHASES, ("#9ecae1", "#3182bd", "#fdd0a2", "#e6550d", "#969696"), strict=True))
    labelled = set()
    for row, m in enumerate(meshes):
        floor = m["seconds"]["floor"]["median"]
        ours = m["phases"]
        theirs = {
            "Jacobian assembly": m["floor_phases"]["assembly"],
            "factorisation and solution": m["floor_phases"]["factorisation and solution"],
        }
        for shift, phases in ((-0.18, ours), (0.18, theirs)):
            left = 0.0
            for name, value in phases.items():
                label = None if name in labelled else name
                labelled.add(name)
                axes.barh(row + shift, value / floor, 0.32, left=left, color=colours[name], label=label)
                left += value / floor
    names = [f"{m['cells'][0]} x {m['cells'][1]}, {m['element']}" for m in meshes]
    axes.set_yticks(range(len(meshes)), names)
    axes.invert_yaxis()
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set_xlabel("time over the floor; upper bar: a Newton iteration, lower bar: the floor")
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize="small")
    figure.savefig(file, dpi=150)
    plt.close(figure)


def main(
    out: Annotated[Path, typer.Option(help="Folder for figures, table and picture.")],
    quick: Annotated[bool, typer.Option(help="Only a small mesh.")] = False,
) -> None:
    """Measure, and write newton_floor.json, newton_floor.md and newton_floor.png."""
    state, meshes = band(QUICK_TRAVEL if quick else TRAVEL), []
    for cells in QUICK if quick else MESHES:
        for element in ("Q1R",) if quick else ("Q1R", "Q1"):
            meshes.append(measure(state, cells, element, ROUNDS.get(cells[0], 3)))
            print(f"{cells} {element}: {meshes[-1]['ratio']}", flush=True)
    write(out, "newton_floor", {"meshes": meshes}, report(meshes))
    draw(out / "newton_floor.png", meshes)


if __name__ == "__main__":
    typer.run(main)
