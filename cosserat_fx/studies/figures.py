"""The figures of a study: error against seconds, the rate of each knob, where the seconds go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from cosserat_fx.output.page import GUIDE, figure
from cosserat_fx.studies.assessment import TARGETS, Assessment, Fit, Point, Role
from cosserat_fx.studies.choice import Spelling
from cosserat_fx.studies.plan import KNOBS, Knob
from cosserat_fx.studies.runs import OUTSIDE_THE_LOOP, Timing
from cosserat_fx.studies.tables import REFINED, rank
from cosserat_fx.typing import Array

_LOOKS: dict[str, tuple[str, str]] = {
    "cells": ("C0", "o"),
    "element": ("C4", "D"),
    "steps": ("C3", "s"),
    "local tolerance": ("C2", "^"),
    "effects": ("C1", "P"),
    "together": ("0.6", "."),
}
"""Colour and mark of what is varied."""
_LABELS = {"element": "element", "effects": "an effect left out", "together": "several together"}
_HORIZONTAL: dict[Knob, str] = {
    "cells": "size of the cells",
    "steps": "aims of the steps",
    "local tolerance": "local tolerance",
}
_MARKS = "osD^vP*Xhp"
_OUTSIDE = {"start-up and end": "0.85", "set-up": "0.7", "solver's loop": "C0", "output": "0.45"}
_INSIDE = {
    "constitutive update": "C0",
    "strains and assembly": "C2",
    "Newton, linear solves": "C3",
    "everything else": "0.7",
}
"""Colours of the phases of a process, and of the solver's loop."""


class _Panel(NamedTuple):
    """What one panel of the costs shows: the largest error of some quantities."""

    title: str
    names: list[str]


def draw(found: Assessment, spelling: Spelling, folder: Path) -> list[Path]:
    """Draw every figure for which there is something to show.

    Args:
        found: by the study.
        spelling: of its choices.
        folder: where the figures go.

    Returns:
        The files drawn.
    """
    drawn = []
    if panels := _panels(found):
        draw_costs(found, panels, folder / "cost.png")
        drawn.append(folder / "cost.png")
    if any(found.fit(knob, quantity) for knob in REFINED for quantity in found.quantities):
        draw_rates(found, folder / "rates.png")
        drawn.append(folder / "rates.png")
    draw_seconds(found, spelling, folder / "where.png")
    return [*drawn, folder / "where.png"]


def _panels(found: Assessment) -> list[_Panel]:
    """One for each stress, one for the band, one for the profiles."""
    panels = [_Panel(name, [name]) for name in found.names("stress")]
    band, profiles = found.names("band"), found.names("profiles")
    if band:
        panels.append(_Panel(band[0] if len(band) == 1 else "band: the largest error", band))
    if profiles:
        panels.append(_Panel(profiles[0] if len(profiles) == 1 else "profiles: the largest error", profiles))
    return panels


def draw_costs(found: Assessment, panels: Sequence[_Panel], file: Path) -> None:
    """Draw error against seconds of the solver's loop, with the Pareto front and the targets."""
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    with figure(file, 1.5 + 6.8 * rows) as sheet:
        grid = sheet.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for panel, axes in zip(panels, grid.flat, strict=False):
            _draw_cost(found, panel, axes)
        for axes in grid.flat[len(panels) :]:
            axes.axis("off")
        for axes in grid[:, 0]:
            axes.set_ylabel("error (%)")
        for axes in grid[-1]:
            axes.set_xlabel("seconds in the solver's loop")
        handles: dict[str, Any] = {}
        for axes in grid.flat:
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                handles.setdefault(label, handle)
        sheet.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=4, fontsize=9.0)
        _plain_ticks(grid[0, 0].xaxis)
        _plain_ticks(grid[0, 0].yaxis)


def _plain_ticks(axis: Axis) -> None:
    """Numbers without powers along a logarithmic axis, between the decades too where there are few."""
    low, high = axis.get_view_interval()
    between = (1.0, 2.0, 5.0) if np.log10(high / low) < 2.0 else (1.0,)
    axis.set_major_locator(LogLocator(subs=between))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("e-0", "e-")))
    axis.set_minor_formatter(NullFormatter())


def _draw_cost(found: Assessment, panel: _Panel, axes: Axes) -> None:
    axes.set(xscale="log", yscale="log")
    axes.set_title(panel.title, fontsize=10.0)
    for target in TARGETS:
        axes.axhline(target, linestyle="--", **GUIDE)
    (start,) = found.of("start")
    roles: list[Role] = ["together", *KNOBS]
    for role in roles:
        points = [point for point in found.of(role) if point.record.done]
        if role in REFINED:
            points = sorted([*points, start], key=rank)
        colour, mark = _LOOKS[role]
        line = "-" if role in REFINED else "none"
        _draw_points(axes, points, panel.names, _LABELS.get(role, role), color=colour, marker=mark, linestyle=line)
    _draw_points(
        axes,
        [start],
        panel.names,
        "the scene as it is",
        color="k",
        marker="*",
        linestyle="none",
        markersize=8.0,
        zorder=4,
    )
    front = found.front(panel.names)
    at = [(point.record.loop or np.nan, point.error(panel.names) or np.nan) for point in front]
    axes.step(*zip(*at, strict=True), "k-", where="post", linewidth=0.8, zorder=3, label="Pareto front")
    axes.plot(*zip(*at, strict=True), "ko", markersize=8.0, markerfacecolor="none", markeredgewidth=0.8, zorder=3)
    for point in found.points:
        if not point.record.done and point.record.loop is not None:
            axes.plot(point.record.loop, 0.97, "x", color="k", transform=axes.get_xaxis_transform(), label="stopped")


def _draw_points(axes: Axes, points: Sequence[Point], names: list[str], label: str, **look: Any) -> None:
    """Points joined by a line; those whose error the reference cannot tell hang from a bar at the bound."""
    rated = [(point, error) for point in points if (error := point.error(names)) is not None and point.record.loop]
    if not rated:
        return
    look = {"markersize": 4.5, "linewidth": 0.9, **look}
    seconds, errors = zip(*((point.record.loop, error) for point, error in rated), strict=True)
    bounds = [point.is_bound(names) for point, _ in rated]
    (line,) = axes.plot(seconds, errors, label=label, **look)
    axes.errorbar(
        np.array(seconds)[bounds],
        np.array(errors)[bounds],
        yerr=0.25 * np.array(errors)[bounds],
        uplims=True,
        fmt="none",
        ecolor=line.get_color(),
        elinewidth=0.8,
        capsize=2.0,
    )


def draw_rates(found: Assessment, file: Path) -> None:
    """Draw how errors fall with each knob while the others are fine, with the fitted powers."""
    quantities = found.quantities
    knobs = [knob for knob in REFINED if any(found.fit(knob, quantity) for quantity in quantities)]
    with figure(file, 13.0) as sheet:
        panels = sheet.subplots(1, len(knobs), sharey=True, squeeze=False)[0]
        for knob, axes in zip(knobs, panels, strict=True):
            axes.set(xscale="log", yscale="log", xlabel=f"{_HORIZONTAL[knob]}\nover the scene's own")
            for number, quantity in enumerate(quantities):
                fit = found.fit(knob, quantity)
                if fit is not None:
                    _draw_fit(axes, fit, quantity.name, f"C{number}", _MARKS[number % len(_MARKS)])
            _plain_ticks(axes.xaxis)
            if handles := axes.get_legend_handles_labels()[0]:
                look = {"fontsize": 8.0, "title_fontsize": 8.0, "handlelength": 1.2, "columnspacing": 1.0, "ncols": 2}
                place = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.24)}
                axes.legend(handles=handles, title="falls with the power", **place, **look)
        _plain_ticks(panels[0].yaxis)
        panels[0].set_ylabel("error due to the knob alone (%)")
        shown = {handle.get_gid(): handle for axes in panels for handle in axes.lines if handle.get_gid()}
        sheet.legend(list(shown.values()), list(shown), loc="outside upper center", ncols=3, fontsize=9.0)


def _draw_fit(axes: Axes, fit: Fit, name: str, colour: str, mark: str) -> None:
    """Certain errors filled, others open, the fit as a line."""
    at, errors, certain = np.array(fit.resolutions), np.array(fit.errors), np.array(fit.certain)
    label = f"{fit.rate}" if fit.rate else None
    axes.plot(at[certain], errors[certain], mark, color=colour, markersize=4.5, gid=name, label=label)
    axes.plot(at[~certain], errors[~certain], mark, color=colour, markersize=4.5, markerfacecolor="white")
    if fit.rate:
        ends = np.array([at[certain].min(), at[certain].max()])
        axes.plot(ends, fit.rate.factor * ends**fit.rate.order, "-", color=colour, linewidth=0.9)


def draw_seconds(found: Assessment, spelling: Spelling, file: Path) -> None:
    """Draw what part of the process each phase takes, and what part of the solver's loop, for what is turned alone."""
    points = [*found.of("start"), *(point for knob in KNOBS for point in sorted(found.of(knob), key=rank))]
    timed = [(spelling.words(point.choice), timing) for point in points if (timing := point.record.typical)]
    words, timings = zip(*timed, strict=True)
    places = np.arange(len(timed) - 1.0, -1.0, -1.0)
    with figure(file, 3.6 + 0.46 * len(timed)) as sheet:
        whole, loop = sheet.subplots(1, 2, sharey=True)
        _draw_bars(whole, places, _OUTSIDE, [_process_phases(timing) for timing in timings], "the process")
        _draw_bars(loop, places, _INSIDE, [_loop_phases(timing) for timing in timings], "the solver's loop")
        whole.set_yticks(places, words, fontsize=8.0)
        whole.set_ylim(-0.6, len(timed) - 0.4)


def _draw_bars(
    axes: Axes, places: Array, colours: Mapping[str, str], seconds: Sequence[Mapping[str, float]], words: str
) -> None:
    """Bars of 100 % made of phases, each with its whole in seconds behind it.

    Args:
        axes: where.
        places: of the bars.
        colours: of the phases.
        seconds: of the phases, for each bar.
        words: what the whole is.
    """
    totals, left = np.array([sum(phases.values()) for phases in seconds]), np.zeros(len(seconds))
    for phase, colour in colours.items():
        widths = 100 * np.array([phases[phase] for phases in seconds]) / totals
        axes.barh(places, widths, left=left, height=0.7, color=colour, label=phase)
        left += widths
    for place, total in zip(places, totals, strict=True):
        axes.annotate(f"{total:.3g} s", (100.0, place), (3, 0), textcoords="offset points", va="center", fontsize=8.0)
    axes.tick_params(axis="y", length=0.0)
    axes.set(xlim=(0.0, 100.0), xlabel=f"share of {words} (%)")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=8.0, handlelength=1.2)


def _process_phases(timing: Timing) -> dict[str, float]:
    """Seconds of a process by what it does."""
    seconds = {name: timing.phases.get(name, 0.0) for name in OUTSIDE_THE_LOOP}
    return {
        "start-up and end": timing.process - timing.phases["whole run"],
        "set-up": seconds["set-up"],
        "solver's loop": timing.loop,
        "output": sum(seconds.values()) - seconds["set-up"],
    }


def _loop_phases(timing: Timing) -> dict[str, float]:
    """Seconds of the solver's loop by what it does."""
    phases = {
        "constitutive update": ("constitutive update",),
        "strains and assembly": ("strains", "residual assembly", "Jacobian assembly"),
        "Newton, linear solves": ("Newton", "linear solve"),
    }
    seconds = {words: sum(timing.phases.get(name, 0.0) for name in names) for words, names in phases.items()}
    return seconds | {"everything else": max(0.0, timing.loop - sum(seconds.values()))}
