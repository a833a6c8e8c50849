"""The page that figures are drawn for: text width, fonts, and the words that label a run's states."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from cosserat_fx.output.layer_bands import wall_travel
from cosserat_fx.results import Run
from cosserat_fx.typing import Array

_CM = 1.0 / 2.54
WIDTH = 16.0 * _CM
DPI = 200
STYLE: dict[Any, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 10.0,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.formatter.useoffset": False,
    "lines.linewidth": 1.2,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
}


GUIDE: dict[str, Any] = {"color": "0.6", "linewidth": 0.6, "zorder": 0}
"""Look of a line that only guides the eye."""
LOOSE = ListedColormap(mpl.colormaps["YlGnBu_r"](np.linspace(0.3, 1.0, 256)), "light where loose")
"""Colours of the void ratio."""


@contextmanager
def figure(file: Path, height: float) -> Iterator[Figure]:
    """A figure of the page's width and a height in cm, written to the file at the end."""
    with mpl.rc_context(STYLE):
        sheet = Figure(figsize=(WIDTH, height * _CM), layout="constrained")
        yield sheet
        sheet.savefig(file, dpi=DPI)


def layer_height(run: Run) -> float:
    """The layer's height in the reference configuration (m)."""
    return float(run.summary["scene"]["geometry"]["height"])


def labels(run: Run) -> list[str]:
    """The wall travel of each block of profiles; on a path with reversals also the step."""
    travel = wall_travel(run.history)
    reverses = np.any(np.diff(np.abs(travel)) < 0.0)
    words = []
    for block in run.profile_blocks():
        at = travel[run.history["step"] == block["step"][0]]
        label = f"{1e3 * (at if at.size else block['top_displacement_m'])[0]:.4g} mm".replace("-", "\u2212")
        words.append(f"{label} (step {block['step'][0]:.0f})" if reverses else label)
    return words


def axis_range(values: Array, least: float = 0.0) -> tuple[float, float]:
    """Limits of an axis that spans at least so much and two per cent of the values, so that noise stays flat."""
    low, high = float(values.min()), float(values.max())
    span = max(high - low, least, 0.02 * abs(low), 0.02 * abs(high)) or 1.0
    middle = 0.5 * (low + high)
    return middle - 0.56 * span, middle + 0.56 * span
