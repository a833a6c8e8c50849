"""How much of a second rank's work arrives: a plane body's Newton iteration on one rank and on two.

    python benchmarks/ranks.py --out DIR

Wants a machine with as many idle cores as ranks. Runs on one rank and on more take turns, each in processes of their
own; a run tells the median of its iterations by phase, of its slowest rank. The efficiency on n ranks is the time on
one over n times that on n.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import typer
from timing_pairs import ratio, seconds, spread, table, write

from cosserat_fx import plane
from cosserat_fx._compat import MPI
from cosserat_fx.scene import PlaneScene, parse_scene

CELLS, QUICK_CELLS = (100, 200), (12, 24)
RANKS = 2
ROUNDS, QUICK_ROUNDS = 7, 2
ITERATIONS = 9
SHEAR = 2e-3
"""Of the body in the increment."""
UPDATE, ASSEMBLY, SOLUTION = "strains and update", "assembly", "solution"
GROUPS = {
    "update and assembly": (UPDATE, ASSEMBLY),
    "update": (UPDATE,),
    "assembly": (ASSEMBLY,),
    "whole iteration": (UPDATE, ASSEMBLY, SOLUTION),
}


def scene(cells: tuple[int, int]) -> PlaneScene:
    """A specimen between smooth platens, about to be compressed."""
    parsed = parse_scene(
        {
            "geometry": {"kind": "rectangle", "width": 0.04, "height": 0.08, "cells": list(cells)},
            "material": {"constants": "paper-sand", "d50": 1e-3},
            "initial": {"stress": -100e3, "void_ratio": 0.6},
            "boundaries": {
                "bottom": {"u2": 0.0},
                "top": {"u2": -0.001},
                "left": {"pressure": 100e3},
                "right": {"pressure": 100e3},
            },
            "points": {"pin": {"at": [0.0, 0.0], "u1": 0.0}},
            "solver": {"linear": "direct"},
            "output": {"fields": False, "figures": False},
        }
    )
    assert isinstance(parsed, PlaneScene)
    return parsed


def measure(cells: tuple[int, int]) -> dict[str, float]:
    """Median seconds of an iteration by phase on the ranks of this run, of the slowest one in every iteration."""
    comm = MPI.COMM_WORLD
    body = plane.build(scene(cells), comm)
    problem, system = body.problem, body.stepper.solver.linear
    for name, (first, second) in {"u1": (0.3, 1.0), "u2": (-1.0, 0.2), "w": (0.5, -0.5)}.items():
        part = problem.fields[name]  # type: ignore[index]
        x, y = part.coordinates.T
        problem.unknown.x.array[part.dofs] = SHEAR * (first * x + second * y if name != "w" else first)
    problem.unknown.x.scatter_forward()
    failure = problem.update(adapt=True)
    assert failure is None, str(failure)
    b = problem.vector.copy()
    x = b.duplicate()
    found: defaultdict[str, list[float]] = defaultdict(list)

    def assemble() -> None:
        problem.assemble_residual(problem.vector)
        system.assemble()

    def solve() -> None:
        system.take()
        assert system.solve(b, x)

    calls = {UPDATE: lambda: problem.update(adapt=False), ASSEMBLY: assemble, SOLUTION: solve}
    for _ in range(ITERATIONS + 1):
        for name, call in calls.items():
            comm.barrier()
            found[name].append(comm.allreduce(seconds(call), op=MPI.MAX))
    return {name: float(np.median(values[1:])) for name, values in found.items()}


def on_ranks(ranks: int, cells: tuple[int, int]) -> dict[str, float]:
    """:func:`measure` on so many ranks."""
    beside = Path(sys.executable).with_name("mpiexec")
    launcher = str(beside) if beside.exists() else shutil.which("mpiexec")
    if launcher is None:
        raise RuntimeError("there is no mpiexec")
    command = [launcher, "-n", str(ranks), sys.executable, __file__, "--measure", *map(str, cells)]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        raise RuntimeError(done.stderr)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def compare(cells: tuple[int, int], ranks: int, rounds: int) -> dict[str, Any]:
    """Efficiencies, from runs that take turns."""
    runs: dict[int, list[dict[str, float]]] = {1: [], ranks: []}
    for number in range(rounds):
        for n, kept in runs.items():
            kept.append(on_ranks(n, cells))
        print(f"round {number + 1} of {rounds}", flush=True)
    times = {
        n: {group: [sum(run[p] for p in parts) for run in kept] for group, parts in GROUPS.items()}
        for n, kept in runs.items()
    }
    return {
        "cells": cells,
        "ranks": ranks,
        "seconds": {str(n): {g: spread(values)._asdict() for g, values in by.items()} for n, by in times.items()},
        "efficiency": {g: ratio([t / ranks for t in times[1][g]], times[ranks][g])._asdict() for g in GROUPS},
    }


def report(found: dict[str, Any]) -> str:
    """The text of the benchmark."""
    n = str(found["ranks"])
    rows = []
    for group in GROUPS:
        e = found["efficiency"][group]
        times = [f"{1e3 * found['seconds'][ranks][group]['median']:.3g}" for ranks in ("1", n)]
        rows.append([group, *times, f"{e['median']:.2f} ({e['lower']:.2f} to {e['upper']:.2f})"])
    nx, ny = found["cells"]
    return (
        f"A plane body of {nx} x {ny} cells: milliseconds of a Newton iteration on 1 and on {n} ranks, and the\n"
        "efficiency, its median with the quartiles.\n\n" + table(["", "1 rank", f"{n} ranks", "efficiency"], rows)
    )


def draw(file: Path, found: dict[str, Any]) -> None:
    """Draw the efficiencies."""
    figure, axes = plt.subplots(figsize=(6.5, 2.4), constrained_layout=True)
    for row, group in enumerate(GROUPS):
        e = found["efficiency"][group]
        bars = [[e["median"] - e["lower"]], [e["upper"] - e["median"]]]
        axes.barh(row, e["median"], 0.6, xerr=bars, color="#74a9cf", capsize=3)
    axes.set_yticks(range(len(GROUPS)), list(GROUPS))
    axes.invert_yaxis()
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set_xlabel(f"efficiency on {found['ranks']} ranks")
    figure.savefig(file, dpi=150)
    plt.close(figure)


def main(
    out: Annotated[Path | None, typer.Option(help="Folder for figures, table and picture.")] = None,
    quick: Annotated[bool, typer.Option(help="Only a small mesh.")] = False,
    ranks: Annotated[int, typer.Option(help="How many, against one.", min=2)] = RANKS,
    measured: Annotated[tuple[int, int] | None, typer.Option("--measure", hidden=True)] = None,
) -> None:
    """Measure, and write ranks.json, ranks.md and ranks.png."""
    if measured is not None:
        found = measure(measured)
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps(found))
        return
    if out is None:
        raise typer.BadParameter("must be given", param_hint="--out")
    compared = compare(QUICK_CELLS if quick else CELLS, ranks, QUICK_ROUNDS if quick else ROUNDS)
    print(f"efficiency: {compared['efficiency']['update and assembly']}")
    write(out, "ranks", compared, report(compared))
    draw(out / "ranks.png", compared)


if __name__ == "__main__":
    typer.run(main)
