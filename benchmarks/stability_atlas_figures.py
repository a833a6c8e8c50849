"""Heat maps of the stability atlas."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from stability_atlas_runs import Entry, Outcome
from stability_atlas_scenes import AXES, Axis

from cosserat_fx.output.page import figure
from cosserat_fx.typing import Array

_BINS = 6
_PAIRS: Final = (("pressure", "density"), ("height", "fineness"), ("rolling", "phi_c"), ("a_c", "target"))
_AXIS: Final = {axis.key: axis for axis in AXES}


class _Map(NamedTuple):
    """What a figure shows.

    Attributes:
        name: of the file.
        title: of the colour bar.
        colours: name of matplotlib's colour map.
        norm: from values to colours.
    """

    name: str
    title: str
    colours: str
    norm: Normalize

    def value(self, outcomes: Sequence[Outcome]) -> float:
        """What the scenes of one field come to: the part of them that is done in %, or the median of a quantity."""
        if self.name == "endings":
            return 100 * float(np.mean([outcome.ending == "done" for outcome in outcomes]))
        return float(np.median([getattr(outcome, self.name) for outcome in outcomes]))


_MAPS: Final = (
    _Map("endings", "scenes that reach the end (%)", "RdYlGn", Normalize(50.0, 100.0)),
    _Map("steps", "steps, median", "viridis", LogNorm(1.0, 1000.0)),
    _Map("iterations", "Newton iterations, median", "viridis", LogNorm(1.0, 1000.0)),
    _Map("cutbacks", "cutbacks, median", "magma_r", Normalize(0.0, 20.0)),
)


def draw_maps(entries: Sequence[Entry], folder: Path) -> None:
    """Draw `stability_<quantity>.png`, each over four pairs of parameters; corners count into the outermost fields.

    Args:
        entries: scenes with their outcomes.
        folder: where to.
    """
    for shown in _MAPS:
        with figure(folder / f"stability_{shown.name}.png", 15.0) as sheet:
            panels = sheet.subplots(2, 2)
            for axes, (across, up) in zip(panels.flat, _PAIRS, strict=True):
                _draw(axes, entries, _AXIS[across], _AXIS[up], shown)
            colours = ScalarMappable(shown.norm, shown.colours)
            beyond = "min" if shown.name == "endings" else "max"
            sheet.colorbar(colours, ax=panels, label=shown.title, extend=beyond, shrink=0.8)


def _draw(axes: Axes, entries: Sequence[Entry], across: Axis, up: Axis, shown: _Map) -> None:
    """One panel: fields coloured by what their scenes come to, their number inside, and a cross for every failure."""
    fields: dict[tuple[int, int], list[Outcome]] = {}
    for entry in entries:
        place = _bin(across, entry), _bin(up, entry)
        fields.setdefault(place, []).append(entry.outcome)
    values = np.full((_BINS, _BINS), np.nan)
    for (i, j), outcomes in fields.items():
        values[j, i] = shown.value(outcomes)
    axes.pcolormesh(_edges(across), _edges(up), values, norm=shown.norm, cmap=shown.colours)
    for place, outcomes in fields.items():
        x, y = (axis.at((k + 0.5) / _BINS) for axis, k in zip((across, up), place, strict=True))
        text = f"{shown.value(outcomes):.0f}"
        axes.text(
            x, y, text, ha="center", va="center", fontsize=8.0, bbox={"fc": "w", "ec": "none", "alpha": 0.6, "pad": 1}
        )
    failed = [entry.scene for entry in entries if entry.outcome.ending != "done"]
    points = [[getattr(scene, axis.key) for scene in failed] for axis in (across, up)]
    axes.plot(*points, "x", color="k", markersize=7.0, clip_on=False, label="did not reach the end")
    axes.set(xlabel=across.label, ylabel=up.label)
    axes.set(xscale="log" if across.logarithmic else "linear", yscale="log" if up.logarithmic else "linear")


def _bin(axis: Axis, entry: Entry) -> int:
    """Which of the equal parts of an axis a scene lies in."""
    return min(int(_BINS * axis.part(getattr(entry.scene, axis.key))), _BINS - 1)


def _edges(axis: Axis) -> Array:
    return np.array([axis.at(k / _BINS) for k in range(_BINS + 1)])
