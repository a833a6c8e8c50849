"""Figures of the elements' accuracy and cost."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from element_report import MM, WORDS, Quantity, Report, rotation
from element_runs import CASES, ElementRun
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection, TriMesh
from matplotlib.ticker import LogLocator, NullFormatter
from matplotlib.tri import Triangulation

from cosserat_fx.output.page import figure
from cosserat_fx.scenes.plane import PlaneSolver

_MARKS: dict[str, tuple[str, str]] = {
    "Q1R": ("C0", "o"),
    "Q1": ("C3", "s"),
    "Q2Q1": ("C2", "D"),
    "P1": ("C1", "^"),
    "P2P1": ("C4", "v"),
}
"""Colour and mark of each element."""
_DEFAULT = PlaneSolver().hourglass
_GUIDE: dict[str, Any] = {"color": "0.6", "linewidth": 0.6, "linestyle": "--", "zorder": 0}


def draw_costs(report: Report, file: Path) -> None:
    """Error of stress and band thickness against processor time, log-log, one panel for each case and quantity."""
    panels: list[tuple[str, Quantity]] = [(case, "stress") for case in report.cases]
    panels[1:1] = [(case, "thickness") for case in report.cases if CASES[case].band]
    with figure(file, 15.0) as sheet:
        grid = sheet.subplots(2, 2).flat
        for axes, (case, quantity) in zip(grid, panels, strict=False):
            _draw_cost(report, axes, case, quantity)
        for axes in list(grid)[len(panels) :]:
            axes.remove()
        sheet.legend(*sheet.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5, fontsize=9.0)


def _draw_cost(report: Report, axes: Axes, case: str, quantity: Quantity) -> None:
    runs = report.of("elements", case)
    for (element, pattern), (colour, mark) in {
        **{(name, "squares"): look for name, look in _MARKS.items() if name.startswith("Q")},
        **{(name, "rising"): look for name, look in _MARKS.items() if name.startswith("P")},
        **{(name, "crossed"): look for name, look in _MARKS.items() if name.startswith("P")},
    }.items():
        chosen = [run for run in runs if (run.element, run.pattern) == (element, pattern)]
        time = [report.relative_time(run) for run in chosen]
        error = [abs(report.error(run, quantity)) or np.nan for run in chosen]
        crossed = pattern == "crossed"
        axes.loglog(
            *(time, error),
            marker=mark,
            color=colour,
            mfc=colour if crossed else "white",
            ms=4.5,
            lw=1.0,
            label=f"{element}, crossed" if crossed else element,
        )
    reference = report.reference(case, quantity)
    axes.axhline(100 * reference.error / reference.value, **_GUIDE)
    axes.set_title(f"{case}: {'stress' if quantity == 'stress' else 'thickness of the band'}", fontsize=10.0)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("processor time over that of Q1R")
    axes.set_ylabel("error (%)")


def draw_bands(report: Report, file: Path) -> None:
    """Mean shear strain of the cells on the deformed body for the elements side by side, and the finest mesh."""
    case = next(case for case in report.cases if CASES[case].band)
    finest = report.finest(case)
    runs = {f"{finest.element}\n{finest.side:g} d50": finest}
    for run in report.of("elements", case):
        if run.side == report.side or run.pattern not in ("squares", "rising"):
            runs[f"{run.element} {WORDS[run.pattern]}\n{run.side:g} d50"] = run
    highest = float(np.quantile(finest.state.means["shear_strain"], 0.995))
    with figure(file, 6.2) as sheet:
        panels = sheet.subplots(1, len(runs), sharex=True, sharey=True)
        for axes, (title, run) in zip(panels, runs.items(), strict=True):
            state = run.state
            cells = list(MM * state.deformed[state.cells])
            shown = PolyCollection(cells, cmap="magma_r", edgecolors="face", linewidths=0.1)
            shown.set_array(state.means["shear_strain"])
            shown.set_clim(0.0, highest)
            axes.add_collection(shown)
            _plain(axes, title)
            axes.autoscale_view()
        sheet.colorbar(shown, ax=panels, label="shear strain", pad=0.01)


def draw_sawtooth(report: Report, file: Path) -> None:
    """Rotation for some factors of the hourglass resistance: maps, and along the line of nodes in the middle."""
    case = next(case for case in report.cases if CASES[case].band)
    without, *resisted = report.of("hourglass", case)
    largest = max(float(np.abs(rotation(run)).max()) for run in resisted)
    mapped = [resisted[0], *(run for run in resisted[1:-1] if run.hourglass == _DEFAULT), resisted[-1]]
    with figure(file, 9.0) as sheet:
        panels = sheet.subplots(1, len(mapped) + 2, width_ratios=[*(1.0 for _ in mapped), 1.7, 1.7])
        for axes, run in zip(panels, mapped, strict=False):
            drawn = _draw_map(axes, run, largest)
        sheet.colorbar(drawn, ax=panels[: len(mapped)], label="rotation (degrees)", location="bottom", pad=0.02)
        _draw_middle(panels[-2], resisted)
        _draw_middle(panels[-1], [without])
        panels[-2].set_ylabel("$x_2$ of the undeformed body (mm)")
        panels[-1].set_yticklabels([])


def _draw_map(axes: Axes, run: ElementRun, largest: float) -> TriMesh:
    """Rotation on the deformed body, on a scale of degrees to both sides."""
    state = run.state
    x, y = MM * state.deformed.T
    triangles = np.concatenate([state.cells[:, [0, 1, 2]], state.cells[:, [0, 2, 3]]])
    drawn = axes.tripcolor(Triangulation(x, y, triangles), rotation(run), shading="gouraud", cmap="RdBu")
    drawn.set_clim(-largest, largest)
    _plain(axes, f"$c$ = {run.hourglass:g}")
    return drawn


def _draw_middle(axes: Axes, runs: Sequence[ElementRun]) -> None:
    """Rotation of the nodes along x1 = half the width."""
    for number, run in enumerate(runs):
        state = run.state
        column = np.flatnonzero(np.isclose(state.points[:, 0], np.median(np.unique(state.points[:, 0].round(9)))))
        height = MM * state.points[column, 1]
        axes.plot(rotation(run)[column], height, f"C{number}.-", ms=3.0, lw=0.8, label=f"$c$ = {run.hourglass:g}")
    axes.set_xlabel("rotation (degrees)")
    axes.set_title("$c$ = 0" if len(runs) == 1 else "", fontsize=8.0)
    if len(runs) > 1:
        axes.legend(fontsize=8.0, loc="upper left")


def _plain(axes: Axes, title: str) -> None:
    """A body without a frame."""
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(title, fontsize=8.0)
