"""Tables and figure of the promise: requested, estimated and true errors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from cosserat_fx.output.page import figure

PART_KEPT, PART_CLOSE = 19 / 20, 1 / 2
"""Part of the layers whose true error is at most the requested one, and at least a tenth of it."""

PERCENT = FuncFormatter(lambda value, _: f"{value:g}")

type Records = Mapping[str, dict[str, Any]]


class Dot(NamedTuple):
    """A run whose true error is known. Errors are the larger ones of peak and residual, relative."""

    number: int
    asked: float
    true: float
    estimated: float
    warned: bool
    made: Mapping[str, Any]


def dots(records: Records, name: str) -> list[Dot]:
    """The runs of a set whose reference is certain to a fifth of what was asked for."""
    found = []
    for record in records.values():
        for asked, made in record["runs"].items():
            certain = record["reference"].get("uncertainty", np.inf) <= float(asked) / 5
            if record["set"] == name and certain and made.get("estimated_error"):
                estimated = max(it["total"] for it in made["estimated_error"].values())
                true = max(made["true_error"].values())
                warned = any(it.startswith("accuracy") for it in made["warnings"])
                found.append(Dot(record["number"], float(asked), true, estimated, warned, made))
    return sorted(found, key=lambda dot: (dot.asked, dot.number))


def tables(records: Records, name: str) -> str:
    """The verdict for every accuracy, and a row for every run, in Markdown."""
    shown = dots(records, name)
    heads = ("requested", "layers", "within", "closer than ten times", "median true/requested", "median estimated/true",
             "estimated >= true", "without a certain reference", "verdict")  # fmt: skip
    lines = ["### Verdict\n", _row(heads), _row(["---"] * len(heads))]
    for asked in sorted({dot.asked for dot in shown}):
        lines.append(_verdict([dot for dot in shown if dot.asked == asked], _uncertain(records, name, asked)))
    heads = ("layer", "requested (%)", "true: peak", "residual", "estimated: peak", "residual", "cells", "cell/d50",
             "aim of steps", "local tolerance", "trial runs", "seconds", "of them trial runs", "warned")  # fmt: skip
    lines += ["\n### Layers\n", "Errors in per cent.\n", _row(heads), _row(["---"] * len(heads))]
    for dot in shown:
        true, told, it = dot.made["true_error"], dot.made["estimated_error"], dot.made["chosen"]
        errors = (true["peak"], true["residual"], told["peak"]["total"], told["residual"]["total"])
        lines.append(_row([
            dot.number, f"{100 * dot.asked:g}", *(f"{100 * error:.3f}" for error in errors), it["cells"],
            f"{it['cell_d50']:.2f}", f"{it['tolerance']:.3f}", f"{it['local_tolerance']:.0e}", dot.made["trial_runs"],
            f"{dot.made['seconds']:.1f}", f"{dot.made['seconds_of_trials']:.1f}", "yes" if dot.warned else "no",
        ]))  # fmt: skip
    return "\n".join(lines) + "\n"


def _verdict(shown: list[Dot], uncertain: str) -> str:
    ratios = np.array([dot.true / dot.asked for dot in shown])
    sharpness = np.array([dot.estimated / dot.true for dot in shown])
    kept, close = np.mean(ratios <= 1), np.mean(ratios >= 0.1)
    verdict = "kept" if kept >= PART_KEPT and close >= PART_CLOSE else "not kept"
    return _row([
        f"{100 * shown[0].asked:g} %", len(shown), f"{np.sum(ratios <= 1)}", f"{np.sum(ratios >= 0.1)}",
        f"{np.median(ratios):.2f}", f"{np.median(sharpness):.2f}", f"{np.sum(sharpness >= 1)}", uncertain, verdict,
    ])  # fmt: skip


def _uncertain(records: Records, name: str, asked: float) -> str:
    """How many layers have no reference that is certain enough, and in how many of them the run warned."""
    made = [
        record["runs"][str(asked)]
        for record in records.values()
        if record["set"] == name
        and str(asked) in record["runs"]
        and record["reference"].get("uncertainty", np.inf) > asked / 5
    ]
    warned = sum(any(it.startswith("accuracy") for it in run["warnings"]) for run in made)
    return f"{len(made)}, of which {warned} warn" if made else "0"


def _row(cells: Any) -> str:
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def draw(records: Records, name: str, file: Path) -> None:
    """Draw requested against true errors, and estimated against true ones, a dot for every run."""
    shown = dots(records, name)
    with figure(file, 7.5) as fig:
        left, right = fig.subplots(1, 2)
        levels = sorted({dot.asked for dot in shown})
        _draw_requested(left, shown, levels)
        _draw_estimated(right, shown, levels)
        for axes in (left, right):
            axes.set(xscale="log", yscale="log")
            axes.xaxis.set_major_formatter(PERCENT)
            axes.yaxis.set_major_formatter(PERCENT)
            axes.legend(fontsize=8, loc="best")
        left.set_xticks([100 * level for level in levels])
        left.minorticks_off()


def _draw_requested(axes: Axes, shown: list[Dot], levels: list[float]) -> None:
    """The true error over the requested one, beside the range that was promised."""
    span = 100 * np.array([0.6 * levels[0], 1.6 * levels[-1]])
    axes.fill_between(span, span / 10, span, color="tab:green", alpha=0.12, lw=0, label="one to ten times smaller")
    axes.plot(span, span, "k--", lw=1)
    spread = np.random.default_rng(0).uniform(0.88, 1.14, len(shown))  # or the dots would hide each other
    asked, true = (100 * np.array([getattr(dot, key) for dot in shown]) for key in ("asked", "true"))
    axes.plot(asked * spread, true, "o", ms=4, mfc="none", color="tab:blue", label="a layer")
    axes.set(xlim=span, xlabel="requested error (%)", ylabel="true error (%)")


def _draw_estimated(axes: Axes, shown: list[Dot], levels: list[float]) -> None:
    """The estimated error over the true one."""
    for level, colour in zip(levels, ("tab:purple", "tab:blue", "tab:orange"), strict=False):
        pairs = 100 * np.array([(dot.true, dot.estimated) for dot in shown if dot.asked == level])
        axes.plot(*pairs.T, "o", ms=4, mfc="none", color=colour, label=f"{100 * level:g} % requested")
    errors = 100 * np.array([(dot.true, dot.estimated) for dot in shown])
    ends = np.array([errors.min() / 1.3, errors.max() * 1.3])
    axes.plot(ends, ends, "k--", lw=1)
    axes.set(xlabel="true error (%)", ylabel="estimated error (%)")
