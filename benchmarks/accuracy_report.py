"""Tables and figures of the layer's accuracy and cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from measured import QUANTITIES, Converged, Measured, Quantity

from cosserat_fx.output.page import figure
from cosserat_fx.studies.convergence import limit
from cosserat_fx.studies.tables import markdown
from cosserat_fx.typing import Array

LIMIT = 0.2
"""Error of the shear stresses that a default scene may have (%)."""
SHEAR_STRESSES: tuple[Quantity, ...] = ("peak", "residual")


class Report:
    """Tables of the runs made.

    Attributes:
        walls: in the order of the tables.
    """

    def __init__(self, runs: Sequence[Measured], converged: Sequence[Converged]) -> None:
        """Keep what is to be shown."""
        self.walls = list(dict.fromkeys(c.wall for c in converged))
        self._runs, self._converged = runs, converged
        self._exact = {(c.wall, c.quantity): c.value for c in converged}

    def of(self, study: str, wall: str, points: int = 1) -> list[Measured]:
        """The runs of one study under one wall with one integration."""
        return [run for run in self._runs if (run.study, run.wall, run.points) == (study, wall, points)]

    def default(self, wall: str) -> Measured:
        """The run of the scene as it is."""
        return self.of("default", wall)[0]

    def error(self, run: Measured, quantity: Quantity) -> float:
        """Error in % of what the run itself reports; its peak is the largest of its steps."""
        value = run.peak if quantity == "peak" else run.value(quantity)
        return 100 * (value / self._exact[run.wall, quantity] - 1)

    def mesh_errors(self, wall: str, points: int, quantity: Quantity) -> tuple[Array, Array]:
        """Cells and error in % that is due to the mesh alone, at equal steps."""
        runs = self.of("mesh refinement", wall, points)
        exact = limit([run.value(quantity) for run in self.of("mesh refinement", wall)])[0]
        return np.array([r.cells for r in runs]), np.array([100 * (r.value(quantity) / exact - 1) for r in runs])

    def tables(self) -> str:
        """All tables, in Markdown."""
        sections = {
            "Converged values": self._converged_table(),
            "Default scenes": self._default_table(),
            **{f"Integration points and cells, {wall} wall": self._integration_table(wall) for wall in self.walls},
            "Hard cases, 80 cells": self._hard_table(),
            **{f"Steps and local tolerance, {wall} wall": self._knob_table(wall) for wall in self.walls},
        }
        return "\n\n".join(f"### {title}\n\n{table}" for title, table in sections.items()) + "\n"

    def _converged_table(self) -> str:
        heads = ["wall", "quantity", "value", "error", "error (%)", "of it: steps", "mesh", "local tolerance"]
        rows = []
        for c in self._converged:
            unit, scale, digits = ("mm", 1e3, 4) if QUANTITIES[c.quantity] == "m" else ("Pa", 1.0, 1)
            parts = [f"{scale * part:.{digits + 1}f}" for part in (c.step_error, c.mesh_error, c.local_error)]
            shown = [
                f"{scale * c.value:.{digits}f}",
                f"{scale * c.error:.{digits + 1}f}",
                f"{100 * c.error / c.value:.4f}",
            ]
            rates = ["" if math.isnan(rate) else f"{rate:.2f}" for rate in (c.step_rate, c.mesh_rate)]
            rows.append([c.wall, f"{c.quantity} ({unit})", *shown, *parts, *rates])
        return markdown([*heads, "rate in steps", "rate in mesh"], rows)

    def _default_table(self) -> str:
        heads = ["wall", "peak error (%)", "residual error (%)", f"both within {LIMIT:g} %"]
        rows = []
        for wall in self.walls:
            run = self.default(wall)
            errors = [self.error(run, quantity) for quantity in SHEAR_STRESSES]
            within = "yes" if max(map(abs, errors)) <= LIMIT else "no"
            counts = [str(run.steps), str(run.iterations), str(run.cutbacks)]
            rows.append([wall, *(f"{error:+.3f}" for error in errors), within, *counts])
        return markdown([*heads, "steps", "iterations", "cutbacks"], rows)

    def _integration_table(self, wall: str) -> str:
        rows = []
        for run in self.of("integration", wall) + self.of("integration", wall, 2):
            errors = [f"{self.error(run, quantity):+.3f}" for quantity in QUANTITIES]
            effort = _effort(run, self.default(wall))
            rows.append([str(run.points), str(run.cells), *errors, f"{1e3 * run.thickness:.3f}", *effort])
        heads = ["points", "cells", *(f"{quantity} error (%)" for quantity in QUANTITIES), "thickness (mm)"]
        return markdown([*heads, *_EFFORT], rows)

    def _hard_table(self) -> str:
        rows = []
        for run in (run for run in self._runs if run.study == "hard case"):
            outcome = f"fails at {1e3 * run.end:.2f} mm" if run.failure else "done"
            rows.append([run.case, str(run.points), outcome, *_effort(run, self.default(run.wall))])
        return markdown(["case", "points", "outcome", *_EFFORT], rows)

    def _knob_table(self, wall: str) -> str:
        rows = []
        for run in self.of("steps", wall) + self.of("local tolerance", wall):
            errors = [f"{self.error(run, quantity):+.4f}" for quantity in QUANTITIES]
            counts = [str(n) for n in (run.steps, run.iterations, run.cutbacks, run.substeps)]
            rows.append(
                [f"{run.study} {run.case}", *errors, *counts, f"{run.seconds / self.default(wall).seconds:.1f}"]
            )
        heads = ["varied alone", *(f"{quantity} error (%)" for quantity in QUANTITIES)]
        return markdown([*heads, "steps", "iterations", "cutbacks", "most substeps", "relative time"], rows)


_EFFORT = ["s12 uneven (% of p)", "s21 jump (% of p)", "steps", "iterations", "cutbacks", "relative time"]


def _effort(run: Measured, default: Measured) -> list[str]:
    counts = [str(run.steps), str(run.iterations), str(run.cutbacks)]
    jump = _small(run.jump) if run.points > 1 else "none"
    return [_small(run.unevenness), jump, *counts, f"{run.seconds / default.seconds:.1f}"]


def _small(percent: float) -> str:
    return f"{percent:.1f}" if percent > 0.05 else f"{percent:.0e}"


# -- figures -----------------------------------------------------------------------------------------------------------

_KNOBS = {
    "integration": ("mesh", "C0", "o"),
    "steps": ("steps", "C3", "s"),
    "local tolerance": ("local tolerance", "C2", "^"),
}
"""Label, colour and mark of what is varied alone, by the study that does it."""
_GUIDE: dict[str, Any] = {"color": "0.6", "linewidth": 0.6, "linestyle": "--", "zorder": 0}


def draw_mesh_errors(report: Report, file: Path) -> None:
    """Error due to the mesh against cells, log-log, for both integrations and both walls."""
    with figure(file, 8.5) as sheet:
        panels = sheet.subplots(1, 2, sharey=True)
        for axes, quantity in zip(panels, SHEAR_STRESSES, strict=True):
            for points, colour in ((1, "C0"), (2, "C3")):
                for wall, mark in zip(report.walls, "os", strict=True):
                    cells, error = report.mesh_errors(wall, points, quantity)
                    label = f"{points} point{'s' * (points - 1)}, {wall}"
                    fill = colour if mark == "o" else "white"
                    axes.loglog(cells, abs(error), marker=mark, color=colour, mfc=fill, ms=4.5, lw=1.0, label=label)
            axes.loglog([80, 640], [3.2e-4, 5e-6], color="0.5", lw=0.8)
            axes.annotate("slope \u22122", (160, 8e-5), (-4, -4), textcoords="offset points", ha="right", va="top")
            _frame(axes, f"{quantity} shear stress", [20, 40, 80, 160, 320, 640, 1280])
            axes.axhline(LIMIT, **_GUIDE)
            axes.set_xlabel("cells over the height")
        panels[0].set_ylabel("error due to the mesh (%)")
        sheet.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, fontsize=9.0)


def draw_costs(report: Report, file: Path) -> None:
    """Error against processor time when mesh, steps or local tolerance alone are varied from the default."""
    with figure(file, 13.0) as sheet:
        grid = sheet.subplots(2, 2, sharex=True, sharey=True)
        for row, wall in zip(grid, report.walls, strict=True):
            default = report.default(wall)
            for axes, quantity in zip(row, SHEAR_STRESSES, strict=True):
                for study, (label, colour, mark) in _KNOBS.items():
                    runs = report.of(study, wall)
                    time = [run.seconds / default.seconds for run in runs]
                    error = [report.error(run, quantity) for run in runs]
                    axes.semilogx(time, error, marker=mark, color=colour, mfc="white", ms=4.5, lw=1.0, label=label)
                axes.semilogx(1.0, report.error(default, quantity), "k*", ms=9.0, label="default")
                axes.set_ylim(-1.25 * LIMIT, 1.25 * LIMIT)
                for level in (-LIMIT, 0.0, LIMIT):
                    axes.axhline(level, **_GUIDE)
                _frame(axes, f"{quantity} shear stress, {wall} wall", [0.5, 1, 2, 4, 8])
            row[0].set_ylabel("error (%)")
        for axes in grid[-1]:
            axes.set_xlabel("processor time over that of the default")
        sheet.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=9.0)


def _frame(axes: Axes, title: str, ticks: Sequence[float]) -> None:
    """Title, and ticks along the abscissa."""
    axes.set_title(title, fontsize=10.0)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
