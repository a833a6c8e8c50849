"""The price of each effect: what a step takes with and without it, and what is wrong without it.

Runs the medium rough layer and the biaxial test as they are and with one effect left out or one element exchanged at a
time, in turn and again, in one process. Dimension: the layer against the middle of a strip of thirty heights, which it
stands for. Writes `effects_price.json`, `.md` and `.png`.

    python benchmarks/effects_price.py --out runs/effects_price
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from timing_pairs import Spread, alternately, ratio, spread, table, write

from cosserat_fx.output.page import GUIDE, figure
from cosserat_fx.results import read_run
from cosserat_fx.run import run
from cosserat_fx.scene import Scene, load_scene, parse_scene

DEMOS = Path(__file__).resolve().parents[1] / "demos"
LOOP = ("strains", "constitutive update", "residual assembly", "Jacobian assembly", "linear solve", "Newton")
"""Phases of run.json that make up the steps."""
HEIGHT, CELLS, TRAVEL, PRESSURE = 0.02, 10, 2e-3, 100e3
"""Of the layer that a strip stands for: height (m), cells, shear displacement (m), pressure (Pa)."""
QUIET = ("output.figures=false", "output.fields=false", 'output.checkpoints="off"')


@dataclass(frozen=True)
class Body:
    """Scenes that differ in one thing from the first.

    Attributes:
        stress: column of the history that is compared.
        variants: scenes by what is left out or exchanged.
    """

    stress: str
    variants: Mapping[str, Callable[[], Scene]]


def demo(name: str, common: tuple[str, ...], *overrides: str) -> Callable[[], Scene]:
    """A demo, changed."""
    return lambda: load_scene(DEMOS / f"{name}.toml", [*QUIET, *common, *overrides])


def strip(length: float | None) -> Callable[[], Scene]:
    """A layer between very rough walls, or a plane strip of so many heights in its place."""
    walls: dict[str, Any] = {"bottom": {"rolling": 0.0}, "top": {"rolling": 0.0}}
    if length is None:
        walls["top"] |= {"shear_displacement": TRAVEL, "normal_stress": -PRESSURE}
        kind = {"geometry": {"kind": "layer", "height": HEIGHT, "cells": CELLS}, "walls": walls}
    else:
        walls["top"] |= {"u1": TRAVEL, "pressure": PRESSURE}
        sides = {side: {"pressure": PRESSURE} for side in ("left", "right")}
        grid = {"width": length * HEIGHT, "height": HEIGHT, "cells": [round(length * CELLS), CELLS]}
        force = {"boundary": "top", "quantity": "force1", "factor": 1 / (length * HEIGHT)}
        kind = {
            "geometry": {"kind": "rectangle", **grid},
            "boundaries": {**{side: {"wall": wall} for side, wall in walls.items()}, **sides},
            "stepping": {"branch": "primary"},
            "output": {"columns": {"shear_stress_Pa": force}},
        }
    output = {"figures": False, "fields": False, "checkpoints": "off", **kind.pop("output", {})}
    common = {"initial": {"stress": -PRESSURE, "void_ratio": 0.6}, "effects": {"finite_strain": True}}
    return lambda: parse_scene({**common, **kind, "output": output})


_EFFECTS: dict[str, tuple[str, ...]] = {
    "small strain": ("effects.finite_strain=false",),
    "no spin": ('effects.spin="none"',),
    "spin of the grains": ('effects.spin="cosserat"',),
    "frozen void ratio": ("effects.void_ratio=false",),
}
_LAYER = {
    "as it is": (),
    "classical": ("effects.polar=false", "walls.top.rolling=0.0"),
    **_EFFECTS,
    "two points a cell": ("solver.integration_points=2",),
}
_BIAXIAL = {
    "as it is": (),
    "classical": ("effects.polar=false",),
    **_EFFECTS,
    "element Q1": ('solver.element="Q1"',),
    "element Q2Q1": ('solver.element="Q2Q1"',),
}
_SHORT = ("boundaries.top.u2=-0.005", "output.fields_at=[0.005]")
BODIES = {
    "layer": Body("shear_stress_Pa", {name: demo("layer_medium_rough", (), *how) for name, how in _LAYER.items()}),
    "biaxial test": Body("axial_stress_Pa", {name: demo("biaxial", _SHORT, *how) for name, how in _BIAXIAL.items()}),
    "layer 2 cm high": Body("shear_stress_Pa", {"as it is": strip(None), "a strip in its place": strip(30.0)}),
}


@dataclass
class Ran:
    """What a run came to: its steps, Newton iterations, peak and last stress (Pa), and why it ended early."""

    steps: int
    iterations: int
    peak: float
    residual: float
    reason: str | None


def walk(body: Body, name: str, folder: Path, kept: dict[str, Ran]) -> float:
    """Run a variant; the seconds of an iteration."""
    out = folder / name.replace(" ", "_")
    ledger = run(body.variants[name](), out, overwrite=True)
    ran = read_run(out)
    stress = np.abs(np.asarray(ran.history[body.stress]))
    seconds = sum(ran.summary["seconds"].get(phase, 0.0) for phase in LOOP)
    kept[name] = Ran(ledger.steps, ledger.iterations, stress.max(), stress[-1], ledger.reason)
    return seconds / ledger.iterations


def measure(body: Body, folder: Path, rounds: int) -> dict[str, Any]:
    """All variants of a body in turn."""
    kept: dict[str, Ran] = {}
    cases = {name: partial(walk, body, name, folder, kept) for name in body.variants}
    times = alternately(cases, rounds)
    full = kept["as it is"]
    entries = {}
    for name in body.variants:
        ran = kept[name]
        entries[name] = {
            "iteration": spread(times[name])._asdict(),
            "ratio": ratio(times[name], times["as it is"])._asdict(),
            "steps": ran.steps,
            "iterations": ran.iterations,
            "peak": ran.peak,
            "residual": ran.residual,
            "peak_error": ran.peak / full.peak - 1,
            "residual_error": ran.residual / full.residual - 1,
            "reason": ran.reason,
        }
    return entries


def report(measured: Mapping[str, Mapping[str, Any]]) -> str:
    """The table of the documentation."""
    rows = []
    for body, entries in measured.items():
        for name, entry in entries.items():
            first = name == "as it is"
            spreads = Spread(**entry["ratio"])
            end = "" if entry["reason"] is None else ", stopped early"
            rows.append(
                [
                    f"{body}: {name}{end}",
                    f"{1e3 * entry['iteration']['median']:.2f}",
                    "1" if first else str(spreads),
                    entry["steps"],
                    entry["iterations"],
                    "" if first else f"{100 * entry['peak_error']:+.1f} %",
                    "" if first or entry["reason"] else f"{100 * entry['residual_error']:+.1f} %",
                ]
            )
    headings = ["run", "ms an iteration", "ratio (quartiles)", "steps", "iterations", "peak", "residual"]
    return table(headings, rows)


def draw(measured: Mapping[str, Mapping[str, Any]], out: Path) -> None:
    """Time of an iteration and change of the answer of each variant, side by side."""
    labels = [(body, name) for body, entries in measured.items() for name in entries if name != "as it is"]
    with figure(out / "effects_price.png", 9.0) as page:
        left, right = page.subplots(1, 2, sharey=True)
        colours = dict(zip(measured, ("tab:blue", "tab:orange", "tab:green"), strict=False))
        for k, (body, name) in enumerate(labels):
            entry, colour = measured[body][name], colours[body]
            left.barh(k, entry["ratio"]["median"], color=colour, height=0.6)
            right.plot(100 * abs(entry["peak_error"]), k, "o", color=colour)
            if entry["reason"] is None:
                right.plot(100 * abs(entry["residual_error"]), k, "s", color=colour, markerfacecolor="none")
        left.axvline(1.0, **GUIDE)
        left.set_yticks(range(len(labels)), [f"{body}: {name}" for body, name in labels])
        left.invert_yaxis()
        left.set(xscale="log", xlabel="time of an iteration, ratio")
        right.set(xscale="log", xlabel="change of the peak (full) and\nthe residual stress (open), %")


def main(
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    quick: Annotated[bool, typer.Option(help="A coarse look at the layer alone.")] = False,
) -> None:
    """Measure and report."""
    with tempfile.TemporaryDirectory() as folder:
        bodies = {"layer": BODIES["layer"]} if quick else BODIES
        measured = {name: measure(body, Path(folder), 1 if quick else 5) for name, body in bodies.items()}
    text = report(measured)
    write(out, "effects_price", {"bodies": measured}, text)
    draw(measured, out)
    print(text)


if __name__ == "__main__":
    typer.run(main)
