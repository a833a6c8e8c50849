"""How time and memory of a Newton iteration grow with the unknowns of a plane body, with factors and with GMRES.

    python benchmarks/growth.py --out DIR

The biaxial specimen of the demo past its peak, with a shear band, on ever finer meshes. Each mesh has a process in
which both solutions of the same system take turns, and one for each of them alone, whose largest memory is noted.
Times are processor times of one rank on one thread.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import matplotlib.pyplot as plt
import numpy as np
import typer
from banded import CELLS, Band, band, put_on, scene
from timing_pairs import alternately, exponent, peak_memory, processor_seconds, ratio, spread, table, write

from cosserat_fx import plane
from cosserat_fx._compat import MPI

Kind = Literal["direct", "iterative"]
KINDS: tuple[Kind, ...] = "direct", "iterative"
REFINEMENTS = 2, 3, 6, 11, 19
QUICK = 1, 2
TRAVEL, QUICK_TRAVEL = 0.008, 0.0005
"""Of the platen (m)."""
ROUNDS = 5
FEW_ROUNDS, MANY_UNKNOWNS = 3, 200_000
UPDATE, SYSTEM = "strains and update", "residual and Jacobian"
WORDS = {"direct": "factors (MUMPS)", "iterative": "GMRES with multigrid"}


def measure(state: Band, refinement: int, kinds: tuple[Kind, ...]) -> dict[str, Any]:
    """Measure one mesh in this process.

    Args:
        state: of the specimen.
        refinement: of the demo's cells.
        kinds: which solutions take turns; the memory is that of all of them together.
    """
    body = plane.build(scene((CELLS[0] * refinement, CELLS[1] * refinement), linear="iterative"), MPI.COMM_SELF)
    problem, system = body.problem, body.stepper.solver.linear
    put_on(state, body)
    problem.state.restart_substeps()
    failure = problem.update(adapt=True)
    assert failure is None, str(failure)
    problem.assemble_residual(problem.vector)
    system.begin()
    system.assemble()
    b = problem.vector.copy()
    x = b.duplicate()

    def assemble() -> None:
        problem.assemble_residual(problem.vector)
        problem.assemble_jacobian()

    def iterative() -> None:
        problem.matrix.stateIncrease()  # or what was set up for it before would serve again
        system.begin()
        system.take()
        assert system.solve(b, x)

    def direct() -> None:
        problem.matrix.stateIncrease()
        assert system.factorise()
        assert system.solve(b, x)

    solutions = {"direct": direct, "iterative": iterative}
    calls = {UPDATE: lambda: problem.update(adapt=False), SYSTEM: assemble} | {k: solutions[k] for k in kinds}
    unknowns = problem.sizes["unknowns"]
    rounds = FEW_ROUNDS if unknowns > MANY_UNKNOWNS else ROUNDS
    cases = {name: (lambda call=call: processor_seconds(call)) for name, call in calls.items()}
    found: dict[str, Any] = {"unknowns": unknowns, "seconds": alternately(cases, rounds)}
    if "iterative" in kinds:
        iterative()
        found["krylov_iterations"] = body.stepper.solver.snes.getKSP().getIterationNumber()
    return found | {"memory": peak_memory(), "notes": system.notes}


def in_a_process(state: Path, refinement: int, kinds: tuple[Kind, ...]) -> dict[str, Any]:
    """:func:`measure` in a process of its own, with the state from a file."""
    command = [sys.executable, __file__, "--state", str(state), "--only", str(refinement), *kinds]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        raise RuntimeError(done.stderr)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def mesh(state: Path, refinement: int) -> dict[str, Any]:
    """What one mesh comes to.

    Args:
        state: file with that of the specimen.
        refinement: of the demo's cells.
    """
    together = in_a_process(state, refinement, KINDS)
    rounds = together["seconds"]
    rest = [update + system for update, system in zip(rounds[UPDATE], rounds[SYSTEM], strict=True)]
    iterations = {kind: [a + b for a, b in zip(rest, rounds[kind], strict=True)] for kind in KINDS}
    return {
        "unknowns": together["unknowns"],
        "krylov_iterations": together["krylov_iterations"],
        "rounds": rounds,
        "seconds": {name: spread(values)._asdict() for name, values in rounds.items()},
        "iteration_seconds": {kind: spread(iterations[kind])._asdict() for kind in KINDS},
        "iterative_over_direct": ratio(iterations["iterative"], iterations["direct"])._asdict(),
        "memory_bytes": {kind: in_a_process(state, refinement, (kind,))["memory"] for kind in KINDS},
        "notes": together["notes"],
    }


def fits(meshes: list[dict[str, Any]], empty: int) -> dict[str, dict[str, float]]:
    """Exponents of time and memory for each solution.

    Args:
        meshes: of :func:`mesh`.
        empty: memory of a process that holds the program and next to nothing else (bytes).
    """
    unknowns = [m["unknowns"] for m in meshes]
    return {
        kind: {
            "solution_time": exponent(unknowns, [m["seconds"][kind]["median"] for m in meshes]),
            "iteration_time": exponent(unknowns, [m["iteration_seconds"][kind]["median"] for m in meshes]),
            "memory": exponent(unknowns, [m["memory_bytes"][kind] - empty for m in meshes]),
        }
        for kind in KINDS
    }


def crossover(meshes: list[dict[str, Any]]) -> float | None:
    """Unknowns at which both take as long, by straight lines through the logarithms; None where they do not meet."""
    n = np.log([m["unknowns"] for m in meshes])
    lead = np.log([m["iterative_over_direct"]["median"] for m in meshes])
    for i in range(len(n) - 1, 0, -1):
        if lead[i] < 0 <= lead[i - 1]:
            return float(np.exp(n[i - 1] + (n[i] - n[i - 1]) * lead[i - 1] / (lead[i - 1] - lead[i])))
    return None


def report(meshes: list[dict[str, Any]], exponents: dict[str, dict[str, float]], met: float | None) -> str:
    """The text of the benchmark."""
    rows = []
    for m in meshes:
        shown = [f"{m['iteration_seconds'][kind]['median']:.3g}" for kind in KINDS]
        lead = m["iterative_over_direct"]
        rows.append(
            [
                m["unknowns"],
                *shown,
                f"{lead['median']:.2f} ({lead['lower']:.2f} to {lead['upper']:.2f})",
                m["krylov_iterations"],
                *(f"{m['memory_bytes'][kind] / 1e9:.2f}" for kind in KINDS),
            ]
        )
    headings = [
        "unknowns",
        "s, factors",
        "s, GMRES",
        "GMRES over factors",
        "GMRES iterations",
        "GB, factors",
        "GB, GMRES",
    ]
    kinds = [[WORDS[kind], *(f"{value:.2f}" for value in exponents[kind].values())] for kind in KINDS]
    where = "One is faster on all meshes" if met is None else f"Both take as long at about {met:.2g} unknowns"
    return (
        "The biaxial specimen with a shear band, refined: processor time of one Newton iteration (update with\n"
        "tangent, residual, Jacobian, solution), median; the ratio with its quartiles; largest resident memory.\n\n"
        + table(headings, rows)
        + f"\n{where}. They grow with these powers of the unknowns (memory without that of the program):\n\n"
        + table(["", "solution", "whole iteration", "memory"], kinds)
    )


def draw(file: Path, meshes: list[dict[str, Any]], exponents: dict[str, dict[str, float]]) -> None:
    """Draw time and memory over the unknowns."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), constrained_layout=True)
    n = [m["unknowns"] for m in meshes]
    for kind, colour, mark in zip(KINDS, ("tab:red", "tab:blue"), ("o", "s"), strict=True):
        told = exponents[kind]
        times = [m["iteration_seconds"][kind] for m in meshes]
        middle = [t["median"] for t in times]
        bars = [[t["median"] - t["lower"] for t in times], [t["upper"] - t["median"] for t in times]]
        label = f"{WORDS[kind]}, power {told['iteration_time']:.2f}"
        left.errorbar(n, middle, yerr=bars, color=colour, marker=mark, capsize=3, label=label)
        memory = [m["memory_bytes"][kind] / 1e9 for m in meshes]
        right.plot(n, memory, color=colour, marker=mark, label=f"{WORDS[kind]}, power {told['memory']:.2f}")
    for axes, label in ((left, "processor seconds of a Newton iteration"), (right, "largest memory / GB")):
        axes.set(xscale="log", yscale="log", xlabel="unknowns", ylabel=label)
        axes.grid(which="both", alpha=0.3)
        axes.legend(frameon=False)
    figure.savefig(file, dpi=150)
    plt.close(figure)


def main(
    out: Annotated[Path | None, typer.Option(help="Folder for figures, table and picture.")] = None,
    quick: Annotated[bool, typer.Option(help="Only the smallest meshes.")] = False,
    only: Annotated[int | None, typer.Option(hidden=True)] = None,
    state: Annotated[Path | None, typer.Option(hidden=True)] = None,
    kinds: Annotated[list[str] | None, typer.Argument(hidden=True)] = None,
) -> None:
    """Measure, and write growth.json, growth.md and growth.png."""
    if only is not None:
        specimen = Band.load(state) if state is not None else band()
        print(json.dumps(measure(specimen, only, tuple(kind for kind in KINDS if kind in (kinds or ())))))
        return
    if out is None:
        raise typer.BadParameter("must be given", param_hint="--out")
    out.mkdir(parents=True, exist_ok=True)
    file = out / "specimen.npz"
    band(QUICK_TRAVEL if quick else TRAVEL).save(file)
    empty = 0 if quick else in_a_process(file, 1, ("iterative",))["memory"]
    meshes = []
    for refinement in QUICK if quick else REFINEMENTS:
        meshes.append(mesh(file, refinement))
        print(f"{meshes[-1]['unknowns']} unknowns: {meshes[-1]['iterative_over_direct']}", flush=True)
    exponents, met = fits(meshes, empty), crossover(meshes)
    figures = {"meshes": meshes, "exponents": exponents, "crossover_unknowns": met, "program_bytes": empty}
    write(out, "growth", figures, report(meshes, exponents, met))
    draw(out / "growth.png", meshes, exponents)


if __name__ == "__main__":
    typer.run(main)
