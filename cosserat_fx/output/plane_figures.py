"""Figures of a plane body: its history, its states at the stations, and an animation of its shear strain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure

from cosserat_fx.output.page import GUIDE, LOOSE, STYLE, WIDTH, axis_range, figure
from cosserat_fx.output.plane_fields import PlaneState, read_states
from cosserat_fx.results import PLANE_COLUMNS, Run, RunFolder
from cosserat_fx.typing import Array

_UNITS = {
    "_N_per_m": (" (kN/m)", 1e-3),
    "_J_per_m": (" (J/m)", 1.0),
    "_kPa": (" (kPa)", 1.0),
    "_Pa": (" (kPa)", 1e-3),
    "_rad": (" (rad)", 1.0),
    "_mm": (" (mm)", 1.0),
    "_N": (" (N)", 1.0),
    "_m": (" (mm)", 1e3),
}
"""What the name of a column ends with: how its axis says that, and the factor to that unit."""
_STRAIN_MAP = mpl.colormaps["YlOrBr"]
_FRAMES_PER_SECOND = 8
_ANIMATION_DPI = 100


class _Panel(NamedTuple):
    """A quantity on the deformed body: its name, the label of its scale, colours and what they span."""

    name: Literal["void_ratio", "rotation", "shear_strain"]
    label: str
    colours: Colormap
    limits: Normalize


@dataclass(frozen=True)
class _Window:
    """What all pictures of a run show: limits of the axes (mm)."""

    left: float
    right: float
    bottom: float
    top: float

    @classmethod
    def around(cls, states: Sequence[PlaneState]) -> _Window:
        """The window that holds all states, undeformed and deformed, with a margin."""
        points = 1e3 * np.concatenate([states[0].points, *(state.deformed for state in states)])
        (left, bottom), (right, top) = points.min(axis=0), points.max(axis=0)
        margin = 0.03 * max(right - left, top - bottom)
        return cls(left - margin, right + margin, bottom - margin, top + margin)

    @property
    def slenderness(self) -> float:
        """Height over width."""
        return (self.top - self.bottom) / (self.right - self.left)


def draw_plane(run: Run, folder: Path, *, animation: bool) -> list[Path]:
    """Draw all figures of a plane body which the run has data for.

    Args:
        run: the run.
        folder: where to.
        animation: whether to draw that as well.

    Returns:
        The files drawn.

    Raises:
        OSError: a figure cannot be written.
        OutputError: the fields are damaged.
    """
    drawn = []
    if run.history["step"].size:
        drawn.append(folder / "history.png")
        draw_history(run, drawn[-1])
    states = read_states(RunFolder(run.path).fields)
    if len(states) > 1:
        asked = {*_stations(run), states[-1].travel}
        chosen = [state for state in states if state.travel in asked]
        for number, state in enumerate(chosen, start=1):
            drawn.append(folder / f"state_{number:02d}.png")
            draw_state(state, chosen, drawn[-1])
        if animation:
            drawn.append(folder / "shear_strain.gif")
            draw_animation(states, drawn[-1])
    return drawn


def draw_history(run: Run, file: Path) -> None:
    """Draw the scene's own columns, or else the forces on the boundaries, against the travel.

    Circles mark the stations, dashed lines the passages to another branch.

    Args:
        run: a run with at least one step.
        file: the PNG to write.
    """
    history = run.history
    own = list(run.summary.get("scene", {}).get("output", {}).get("columns", {}))
    groups = [[name] for name in own] or _forces(run)
    travel = 1e3 * history["travel_m"]
    marked = np.isin(history["travel_m"], _stations(run))
    with figure(file, 2.0 + 5.0 * len(groups)) as sheet:
        panels = sheet.subplots(len(groups), 1, sharex=True, squeeze=False)[:, 0]
        for axes, names in zip(panels, groups, strict=True):
            words, unit, factor = _spell(names[0])
            for name in names:
                values = factor * history[name]
                (curve,) = axes.plot(travel, values, label=_spell(name)[0], color="k" if len(names) == 1 else None)
                axes.plot(travel[marked], values[marked], "o", color=curve.get_color(), mfc="white", markersize=4.0)
            axes.set_ylabel((words if len(names) == 1 else "force on the body") + unit)
            axes.set_ylim(*axis_range(factor * np.concatenate([history[name] for name in names])))
            if len(names) > 1:
                axes.legend(fontsize=9.0)
            axes.axhline(0.0, **GUIDE)
            for at in travel[history["branch_passages"] > 0]:
                axes.axvline(at, **GUIDE | {"linestyle": "--"})
        panels[-1].set_xlabel("travel (mm)")


def draw_state(state: PlaneState, states: Sequence[PlaneState], file: Path) -> None:
    """Draw void ratio, rotation and shear strain on the deformed body, with the outline of the undeformed one.

    Args:
        state: what to draw.
        states: all those that share the scales of the colours.
        file: the PNG to write.
    """
    window, panels = _Window.around(states), _panels(states)
    beside = window.slenderness > 0.6
    width = 15.0 / len(panels) if beside else 13.0
    height = min(width * window.slenderness, 18.0) * (1 if beside else len(panels))
    with figure(file, height + (2.5 if beside else 1.5)) as sheet:
        grid = sheet.subplots(*((1, len(panels)) if beside else (len(panels), 1)), sharex=True, sharey=True)
        for panel, axes in zip(panels, np.ravel(grid), strict=True):
            picture = _paint(axes, state, panel, window)
            sheet.colorbar(picture, ax=axes, label=panel.label, location="bottom" if beside else "right", aspect=20.0)
        sheet.suptitle(_label(state), fontsize=10.0)


def draw_animation(states: Sequence[PlaneState], file: Path) -> None:
    """Draw the shear strain on the deformed body, frame by frame.

    Args:
        states: the frames.
        file: the GIF to write.
    """
    window, panel = _Window.around(states), _panels(states)[-1]
    height = min(0.9 * WIDTH, WIDTH * window.slenderness + 1.0)
    width = min(WIDTH, (height - 0.6) / window.slenderness + 1.6)
    writer = PillowWriter(fps=_FRAMES_PER_SECOND)
    with mpl.rc_context(STYLE):
        sheet = Figure(figsize=(width, height), layout="constrained")
        axes = sheet.add_subplot()
        picture = _paint(axes, states[0], panel, window)
        sheet.colorbar(picture, ax=axes, label=panel.label)
        with writer.saving(sheet, str(file), dpi=_ANIMATION_DPI):
            for state in states:
                picture.set_verts(list(1e3 * state.deformed[state.cells]))
                picture.set_array(_values(state, panel))
                axes.set_title(_label(state), fontsize=10.0)
                writer.grab_frame()


def _panels(states: Sequence[PlaneState]) -> list[_Panel]:
    """The quantities with limits that span all states; without polar effects there is no rotation."""
    e = np.concatenate([state.means["void_ratio"] for state in states])
    span = Normalize(float(e.min()), max(float(e.max()), float(e.min()) + 0.01))
    panels = [_Panel("void_ratio", "void ratio $e$", LOOSE, span)]
    rotations = [state.rotation for state in states if state.rotation is not None]
    if rotations:
        largest = max(float(np.abs(np.concatenate(rotations)).max()), 1e-3)
        label, colours = r"rotation $\omega_3^c$ (rad)", mpl.colormaps["RdBu_r"]
        panels.append(_Panel("rotation", label, colours, Normalize(-largest, largest)))
    strain = max(float(state.means["shear_strain"].max()) for state in states)
    return [*panels, _Panel("shear_strain", "shear strain", _STRAIN_MAP, Normalize(0.0, max(strain, 1e-3)))]


def _values(state: PlaneState, panel: _Panel) -> Array:
    """(m,) what a panel shows in each cell; of the rotation the mean of its nodes."""
    if panel.name == "rotation" and state.rotation is not None:
        return np.asarray(state.rotation[state.cells].mean(axis=1))
    return state.means[panel.name]


def _paint(axes: Axes, state: PlaneState, panel: _Panel, window: _Window) -> PolyCollection:
    """Paint the cells of the deformed body and the outline of the undeformed one."""
    picture = PolyCollection(
        list(1e3 * state.deformed[state.cells]),
        array=_values(state, panel),
        cmap=panel.colours,
        norm=panel.limits,
        antialiaseds=False,  # or the seams between the cells would show
    )
    axes.add_collection(LineCollection(list(1e3 * _outline(state)), colors="0.6", linewidths=0.6))
    axes.add_collection(picture)
    axes.set(aspect="equal", xlim=(window.left, window.right), ylim=(window.bottom, window.top))
    axes.axis("off")
    return picture


def _outline(state: PlaneState) -> Array:
    """(k, 2, 2) both ends of the sides that belong to one cell only, on the undeformed body (m)."""
    sides = np.stack([state.cells, np.roll(state.cells, -1, axis=1)], axis=2).reshape(-1, 2)
    unique, count = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    return np.asarray(state.points[unique[count == 1]])


def _label(state: PlaneState) -> str:
    return f"travel {1e3 * state.travel:.4g} mm".replace("-", "\u2212")


def _stations(run: Run) -> list[float]:
    """Travels at which states were asked for (m)."""
    return list(run.summary.get("stations_m", []))


def _forces(run: Run) -> list[list[str]]:
    """The history's columns of forces that differ from zero: first those along x1, then those along x2."""
    names = [name for name in run.history if name not in PLANE_COLUMNS and np.any(run.history[name])]
    groups = [[name for name in names if name.endswith(f"_force{axis}_N_per_m")] for axis in (1, 2)]
    return [group for group in groups if group] or [["internal_work_J_per_m"]]


def _spell(name: str) -> tuple[str, str, float]:
    """A column's name in words, its unit, and the factor to that."""
    for ending, (unit, factor) in _UNITS.items():
        if name.endswith(ending):
            return name.removesuffix(ending).replace("_", " "), unit, factor
    return name.replace("_", " "), "", 1.0
