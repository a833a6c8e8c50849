"""What checkpoints cost: their part of a run's time, at the default interval and with one after every step.

Walks a layer, the biaxial test and the biaxial test on a fine mesh; from the second row of each on the same scene is
walked with one after every step. Writes `tables.md`, which docs/reliability.md shows. On several ranks rank 0 speaks:

    python benchmarks/checkpoint_cost.py --out runs/checkpoint_cost
    mpiexec -n 2 python benchmarks/checkpoint_cost.py --out runs/checkpoint_cost_2
"""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import Annotated, Any
from unittest.mock import patch

import typer

from cosserat_fx._compat import MPI
from cosserat_fx.checkpoint import SHARE, Checkpoints
from cosserat_fx.results import read_run
from cosserat_fx.run import run
from cosserat_fx.scene import load_scene

DEMOS = Path(__file__).resolve().parents[1] / "demos"
FINE = ("geometry.cells=[96, 336]", "stepping.max_steps=12")
CASES: dict[str, tuple[str, tuple[str, ...]]] = {
    "layer": ("layer_medium_rough.toml", ()),
    "biaxial": ("biaxial.toml", ()),
    "biaxial, 36 times the cells": ("biaxial.toml", FINE),
}
INTERVALS = {"auto": "the default", "0": "every step"}
QUIET = ("output.figures=false", "output.frames=0")


def walk(scene: str, out: Path, *changes: str) -> tuple[dict[str, Any], list[int]]:
    """Run a scene; its summary, and the size of each of its checkpoints (bytes)."""
    sizes: list[int] = []
    save = Checkpoints.save

    def weighed(self: Checkpoints, notes: dict[str, Any]) -> None:
        save(self, notes)
        if MPI.COMM_WORLD.rank == 0:
            sizes.append((out / "checkpoint.bin").stat().st_size)

    quiet = [it for it in QUIET if "frames" not in it or "layer" not in scene]
    with patch.object(Checkpoints, "save", weighed):
        run(load_scene(DEMOS / scene, [*quiet, *changes]), out, overwrite=True)
    return read_run(out).summary, sizes


def row(case: str, interval: str, summary: dict[str, Any], sizes: list[int]) -> str:
    """A row of the table."""
    seconds = summary["seconds"]
    loop = seconds["whole run"] - seconds["set-up"]
    spent = seconds.get("checkpoints", 0.0)
    cells = [
        case,
        f"{summary['sizes']['quadrature_points']}",
        INTERVALS[interval],
        f"{summary['steps']}",
        f"{len(sizes)}",
        f"{1e-6 * median(sizes):.2g}",
        f"{1e3 * spent / len(sizes):.1f}",
        f"{100 * spent / loop:.2g} %",
    ]
    return f"| {' | '.join(cells)} |"


def main(out: Annotated[Path, typer.Option(help="Folder for the runs and the table.")]) -> None:
    """Walk all cases and write the table."""
    lines = [
        "| scene | points | interval | steps | checkpoints | MB | ms each | of the steps' time |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for case, (scene, changes) in CASES.items():
        for number, interval in enumerate(INTERVALS):
            folder = out / f"{Path(scene).stem}_{len(changes)}_{number}"
            summary, sizes = walk(scene, folder, f"output.checkpoints={interval}", *changes)
            if MPI.COMM_WORLD.rank == 0:
                lines.append(row(case, interval, summary, sizes))
                print(lines[-1], flush=True)
    if MPI.COMM_WORLD.rank == 0:
        note = f"By default they may take {100 * SHARE:g} % of the time; ranks: {MPI.COMM_WORLD.size}."
        (out / "tables.md").write_text("\n".join([*lines, "", note, ""]))


if __name__ == "__main__":
    typer.run(main)
