"""What the pages of the shear box and of the rough strip show: boxes of three lengths beside the layer, both strips.

Runs demos/shear_box.toml with lengths of 2, 4 and 8 heights, an infinite layer of the same cells, and both scenes of
the strip. Writes the tables `shear-box.md` and `rough-strip.md` and the figures `shear_box_length.png` and
`rough_strip.png`; docs/shear-box.md and docs/rough-strip.md show them. Runs serially, in about two minutes.

    python benchmarks/plane_demos.py --out runs/plane_demos
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from cosserat_fx._compat import MPI
from cosserat_fx.output.page import figure
from cosserat_fx.output.plane_fields import PlaneState, read_states
from cosserat_fx.results import Run, read_run
from cosserat_fx.run import run
from cosserat_fx.scene import load_scene
from cosserat_fx.typing import Array

DEMOS = Path(__file__).resolve().parents[1] / "demos"
HEIGHT = 0.02
"""Of the shear box (m)."""
CELLS = 20
"""Over its height."""
RATIOS = (2, 4, 8)
"""Lengths of the box over its height."""
STATIONS = (0.001, 0.002, 0.005)
"""Shear displacements at which stresses are compared (m)."""
D50 = 1.0
"""Of the sand beside the strip (mm)."""
STRIPS = ("very_rough", "medium_rough")
NO_FRAMES = ("output.frames=0", "output.animation=false")


def make(scene: str, out: Path, *changes: str) -> Run:
    """Run a demo with changes, serially."""
    run(load_scene(DEMOS / scene, changes), out, overwrite=True, comm=MPI.COMM_SELF)
    return read_run(out)


def layer(out: Path) -> Run:
    """An infinite layer of the box's height, cells, grains and displacement."""
    return make(
        "layer_very_rough.toml",
        out,
        f"geometry.height={HEIGHT}",
        f"geometry.cells={CELLS}",
        f"walls.top.shear_displacement={STATIONS[-1]}",
        f"output.profiles_at={list(STATIONS)}",
    )


def box(ratio: int, out: Path) -> Run:
    """The shear box with a length of so many heights."""
    return make(
        "shear_box.toml",
        out,
        f"geometry.width={ratio * HEIGHT}",
        f"geometry.cells=[{ratio * CELLS}, {CELLS}]",
        f"output.columns.shear_stress_Pa.factor={1 / (ratio * HEIGHT)}",
        *NO_FRAMES,
    )


def at_stations(history_of: Run) -> list[float]:
    """Shear stress at the stations (kPa)."""
    history = history_of.history
    found = dict(zip(np.round(history["top_displacement_m"], 9), history["shear_stress_Pa"], strict=True))
    return [1e-3 * float(found[at]) for at in STATIONS]


def stress_in_the_middle(state: PlaneState) -> float:
    """Force along x1 per undeformed length that the middle of the box transmits, mean over the height (kPa).

    This is the component J sigma_1j (F^-T)_j2 = sigma_12 F_11 - sigma_11 F_21 of the first Piola-Kirchhoff stress, in
    the two columns of cells beside the middle.
    """
    centre = 0.5 * float(state.points[:, 0].max())
    beside = np.abs(state.centroids[:, 0] - centre) < HEIGHT / CELLS
    corners, moves = state.points[state.cells[beside]], state.displacement[state.cells[beside]]
    right = corners[..., 0] > corners[..., 0].mean(axis=1, keepdims=True)
    difference = (moves[right].reshape(-1, 2, 2) - moves[~right].reshape(-1, 2, 2)).mean(axis=1) / (HEIGHT / CELLS)
    s11, s12 = state.means["s11_Pa"][beside], state.means["s12_Pa"][beside]
    return 1e-3 * float(np.mean(s12 * (1 + difference[:, 0]) - s11 * difference[:, 1]))


def shear_box_table(reference: Run, boxes: dict[int, Run]) -> str:
    """Shear stresses of the boxes beside the layer's, in Markdown."""
    names = [f"{kind} at {1e3 * at:.0f} mm" for kind in ("mean", "middle") for at in STATIONS]
    infinite = at_stations(reference)
    rows = [["infinite", *(f"{value:.2f}" for value in infinite * 2)]]
    for ratio, done in boxes.items():
        states = {round(state.travel, 9): state for state in read_states(done.path / "fields")}
        values = at_stations(done) + [stress_in_the_middle(states[at]) for at in STATIONS]
        shown = [f"{v:.2f} ({100 * (v / i - 1):+.1f} %)" for v, i in zip(values, infinite * 2, strict=True)]
        rows.append([str(ratio), *shown])
    lines = [f"| {' | '.join(row)} |" for row in (["length / height", *names], *rows)]
    return "\n".join([lines[0], "|" + "---|" * (1 + len(names)), *lines[1:]]) + "\n"


def draw_lengths(reference: Run, boxes: dict[int, Run], file: Path) -> None:
    """Mean shear stress on the top against its displacement, and what it lacks against the length."""
    peak = 1e-3 * reference.history["shear_stress_Pa"].max()
    with figure(file, 7.0) as sheet:
        curves, lacks = sheet.subplots(1, 2, width_ratios=[1.4, 1])
        drawn = [("infinite layer", reference), *((f"{r} heights", boxes[r]) for r in reversed(RATIOS))]
        for (label, done), style in zip(drawn, ("-", "--", "-.", ":"), strict=True):
            curves.plot(
                1e3 * done.history["top_displacement_m"],
                1e-3 * done.history["shear_stress_Pa"],
                "k" + style,
                label=label,
            )
        curves.set(xlabel="shear displacement (mm)", ylabel="mean shear stress (kPa)", xlim=(0, 5), ylim=(0, 70))
        curves.legend(loc="lower right")
        ratios = np.array(RATIOS)
        lack = np.array([100 * (1 - 1e-3 * boxes[r].history["shear_stress_Pa"].max() / peak) for r in RATIOS])
        lacks.plot(1 / ratios, lack, "ko", mfc="white")
        lacks.plot([0, 0.7], [0, 0.7 * lack[-1] * ratios[-1]], color="0.6", linewidth=0.6, zorder=0)
        for ratio, value in zip(ratios, lack, strict=True):
            lacks.annotate(
                f"{ratio} heights", (1 / ratio, value), xytext=(-6, 4), textcoords="offset points", ha="right"
            )
        lacks.set(xlabel="height / length", ylabel="lack of peak shear stress (%)", xlim=(0, 0.7), ylim=(0, None))


def profile(state: PlaneState) -> tuple[Array, Array]:
    """Distance from the strip (mm) and the shear strain there, mean over the middle third of the height."""
    x, y = state.centroids.T
    middle = np.abs(y - y.mean()) < state.points[:, 1].max() / 6
    columns, index = np.unique(np.round(1e6 * x[middle]), return_inverse=True)
    strain = np.bincount(index, state.means["shear_strain"][middle]) / np.bincount(index)
    return 1e-3 * columns, strain


def strips_table(strips: dict[str, Run]) -> str:
    """Resistances, place of the largest shear strain and width at half of it, in Markdown."""
    heads = ["strip", "peak resistance (kPa)", "at 8 mm (kPa)", "band from (d50)", "largest at (d50)", "to (d50)"]
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for name, done in strips.items():
        resistance = 1e-3 * done.history["resistance_Pa"]
        distance, strain = profile(read_states(done.path / "fields")[-1])
        fine = np.linspace(0, distance[-1], 4001)
        inside = fine[np.interp(fine, distance, strain) > 0.5 * strain.max()]
        places = (inside[0], distance[strain.argmax()], inside[-1])
        values = [resistance.max(), resistance[-1], *(place / D50 for place in places)]
        lines.append(f"| {name.replace('_', ' ')} | {' | '.join(f'{value:.1f}' for value in values)} |")
    return "\n".join(lines) + "\n"


def draw_strips(strips: dict[str, Run], file: Path) -> None:
    """Resistance against displacement, and the shear strain across the band at the end."""
    with figure(file, 7.0) as sheet:
        resistance, across = sheet.subplots(1, 2, width_ratios=[1.4, 1])
        for (name, done), style in zip(strips.items(), ("-", "--"), strict=True):
            label = name.replace("_", " ")
            history = done.history
            resistance.plot(1e3 * history["displacement_m"], 1e-3 * history["resistance_Pa"], "k" + style, label=label)
            across.plot(*profile(read_states(done.path / "fields")[-1]), "k" + style, label=label)
        resistance.set(xlabel="displacement of the strip (mm)", ylabel="resistance (kPa)", xlim=(0, 8), ylim=(0, None))
        across.set(xlabel="distance from the strip (mm)", ylabel="shear strain", xlim=(0, 40), ylim=(0, None))
        resistance.legend(loc="lower right")


def main(out: Annotated[Path, typer.Option(help="Folder for the runs, the table and the figures.")]) -> None:
    """Make all runs, and from them table and figures."""
    out.mkdir(parents=True, exist_ok=True)
    reference = layer(out / "layer")
    boxes = {ratio: box(ratio, out / f"shear_box_{ratio}") for ratio in RATIOS}
    (out / "shear-box.md").write_text(shear_box_table(reference, boxes))
    draw_lengths(reference, boxes, out / "shear_box_length.png")
    strips = {name: make(f"rough_strip_{name}.toml", out / f"rough_strip_{name}", *NO_FRAMES) for name in STRIPS}
    (out / "rough-strip.md").write_text(strips_table(strips))
    draw_strips(strips, out / "rough_strip.png")


if __name__ == "__main__":
    typer.run(main)
