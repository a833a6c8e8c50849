"""What a layer's run spends outside of PETSc's solver, compiled assembly and the kernel, and what starting it takes.

The steps of the demo's layers, whose stresses are within 0.1 % (docs/layer-accuracy.md), are walked again and again in
one process. Starts are processes of their own that make one step: the first with empty caches, as on a new machine,
the others with what it left there. Writes `overhead.json` and `.md`.

    python benchmarks/overhead.py --out runs/overhead
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer
from timing_pairs import Spread, spread, table, write

from cosserat_fx._compat import MPI, PETSc
from cosserat_fx.bodies import build
from cosserat_fx.scene import load_scene

DEMOS = Path(__file__).resolve().parents[1] / "demos"
WALLS = ("very_rough", "medium_rough")
COMPILED = ("strains", "constitutive update", "residual assembly", "Jacobian assembly")
"""Phases of a run that are calls of compiled code."""
SOLVER, CALLBACKS = "SNESSolve", ("SNESFunctionEval", "SNESJacobianEval")
"""PETSc's events: its solver, and what the solver leaves to the program."""
CACHES = {"numba's": "NUMBA_CACHE_DIR", "the forms'": "XDG_CACHE_HOME"}
STEP = "walls.top.shear_displacement=1e-5"
QUIET = ("output.figures=false", "output.fields=false", "output.profiles_at=[]")


def solver_seconds() -> float:
    """Time that PETSc has spent on its own: factorisations, solutions, norms (s)."""
    own, *left = (PETSc.Log.Event(name).getPerfInfo()["time"] for name in (SOLVER, *CALLBACKS))
    return float(own - sum(left))


def walk(wall: str) -> dict[str, float]:
    """Seconds of the steps of a layer, and of their parts."""
    body = build(load_scene(DEMOS / f"layer_{wall}.toml", QUIET), MPI.COMM_SELF)
    before, start = solver_seconds(), perf_counter()
    for _ in body.stepper:
        pass
    total = perf_counter() - start
    parts = {phase: body.problem.stopwatch.seconds[phase] for phase in COMPILED}
    parts["PETSc's solver"] = solver_seconds() - before
    body.stepper.solver.snes.destroy()
    return {**parts, "all else": total - sum(parts.values()), "steps": total}


def start(folder: Path, caches: Path, number: int) -> float:
    """Wall time of a process that makes one step (s)."""
    places = {variable: str(caches / variable) for variable in CACHES.values()}
    scene = DEMOS / "layer_medium_rough.toml"
    settings = [part for setting in (STEP, *QUIET) for part in ("--set", setting)]
    begin = perf_counter()
    subprocess.run(
        [sys.executable, "-m", "cosserat_fx", "run", scene, "--out", folder / str(number), *settings],
        env={**os.environ, **places, "OMP_NUM_THREADS": "1"},
        check=True,
        capture_output=True,
    )
    return perf_counter() - begin


def starts(repeats: int) -> tuple[float, Spread]:
    """Seconds of the first start with empty caches, and of those after it."""
    with tempfile.TemporaryDirectory() as folder:
        first, *others = (start(Path(folder), Path(folder) / "caches", number) for number in range(repeats + 1))
    return first, spread(others)


def main(
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    quick: Annotated[bool, typer.Option(help="A coarse look, without the starts.")] = False,
) -> None:
    """Measure and report."""
    PETSc.Log.begin()
    rounds = 2 if quick else 15
    walks = {wall: [walk(wall) for _ in range(rounds + 1)][1:] for wall in WALLS}
    shares = {
        wall: {part: spread([100 * one[part] / one["steps"] for one in done]) for part in done[0]}
        for wall, done in walks.items()
    }
    parts = [part for part in shares[WALLS[0]] if part != "steps"]
    text = table(
        ["share of the steps (%), quartiles", *(f"layer, {wall.replace('_', ' ')}" for wall in WALLS)],
        [[part, *(str(shares[wall][part]) for wall in WALLS)] for part in parts],
    )
    seconds = {wall: spread([one["steps"] for one in done]) for wall, done in walks.items()}
    text += "\nThe steps take " + " and ".join(f"{s} s ({w.replace('_', ' ')})" for w, s in seconds.items()) + ".\n"
    figures: dict[str, object] = {
        "shares": {wall: {part: s._asdict() for part, s in row.items()} for wall, row in shares.items()},
        "seconds": {wall: s._asdict() for wall, s in seconds.items()},
    }
    if not quick:
        first, warm = starts(5)
        text += (
            f"\nA process that makes one step takes {first:.0f} s with empty caches, as the first ever does, and "
            f"{warm} s with full ones.\n"
        )
        figures["first start (s)"], figures["warm start (s)"] = first, warm._asdict()
    write(out, "overhead", figures, text)
    print(text)


if __name__ == "__main__":
    typer.run(main)
