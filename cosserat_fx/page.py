"""The page that figures are drawn for: text width, fonts, and the words that label a run's states."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from cosserat_fx.bands import wall_travel
from cosserat_fx.results import Run

_CM = 1.0 / 2.54
WIDTH = 16.0 * _CM
DPI = 200
_STYLE: dict[Any, Any] = {
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


@contextmanager
def figure(file: Path, height: float) -> Iterator[Figure]:
    """A figure of the page's width and a height in cm, written to the file at the end."""
    with mpl.rc_context(_STYLE):
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
