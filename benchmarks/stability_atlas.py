"""Whether hard layers reach their end: hundreds of scenes over a wide box of parameters, and what became of each.

Writes a row of `atlas.csv` as soon as a scene is done, and goes on where it was interrupted if started again; then
`tables.md` and the heat maps. Runs serially, in about an hour; docs/stability.md shows and discusses the result.

    python benchmarks/stability_atlas.py --out runs/stability_atlas
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from stability_atlas_figures import draw_maps
from stability_atlas_report import Report
from stability_atlas_runs import MAX_SECONDS, Entry, Log, walk
from stability_atlas_scenes import AtlasScene, corners, samples

SAMPLES, QUICK_SAMPLES = 512, 16


def main(
    out: Annotated[Path, typer.Option(help="Folder for rows, tables and figures.")] = Path("runs/stability_atlas"),
    quick: Annotated[bool, typer.Option("--quick", help="Few scenes and no corners, to see that it works.")] = False,
    max_seconds: Annotated[float, typer.Option(help="Time of the processor after which a scene hangs.")] = MAX_SECONDS,
) -> None:
    """Walks the scenes of the atlas that are not yet walked, and draws it."""
    scenes = samples(QUICK_SAMPLES) if quick else _mixed(samples(SAMPLES), corners(SAMPLES))
    out.mkdir(parents=True, exist_ok=True)
    log = Log(out / "atlas.csv")
    console = Console(soft_wrap=True)
    _walk_all(scenes, log, max_seconds, console)
    report = Report(log.read())
    (out / "tables.md").write_text(report.tables(), encoding="utf-8")
    draw_maps(report.entries, out)
    console.print(report.tables(), highlight=False)


def _mixed(*groups: Sequence[AtlasScene]) -> list[AtlasScene]:
    """All scenes, in an order in which every part of the way is a picture of the whole."""
    places = [(k / len(group), scene) for group in groups for k, scene in enumerate(group)]
    return [scene for _, scene in sorted(places, key=lambda it: (it[0], it[1].number))]


def _walk_all(scenes: list[AtlasScene], log: Log, max_seconds: float, console: Console) -> None:
    """Walk the scenes that the log lacks, under a progress bar."""
    known = {entry.scene.number for entry in log.read()}
    columns = (
        TextColumn("scene {task.fields[number]}"),
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("", total=len(scenes), completed=len(known), number=len(known))
        for scene in scenes:
            if scene.number in known:
                continue
            progress.update(task, number=scene.number)
            outcome = walk(scene, max_seconds=max_seconds)
            log.append(Entry(scene, outcome))
            if outcome.ending != "done":
                console.print(f"{scene}\n{outcome}", highlight=False)
            progress.advance(task)


if __name__ == "__main__":
    typer.run(main)
