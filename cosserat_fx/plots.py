"""Figures of a run: its history, the profiles across the layer and the deformed layer.

Everything is drawn from the run's folder, at the width of a printed page's text (16 cm). No display is needed:
matplotlib draws on its Agg canvas, and VTK paints the layer in a process of its own, because it may abort where it
cannot render; matplotlib then paints the layer instead.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import imread

from cosserat_fx.bands import wall_travel
from cosserat_fx.results import OutputError, Run, RunFolder, Table, read_run
from cosserat_fx.typing import Array

type Renderer = Literal["pyvista", "matplotlib"]

_CM = 1.0 / 2.54
_WIDTH = 16.0 * _CM
_DPI = 200
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
_DASHES = ("-", (0, (6, 1.5)), (0, (5, 1.5, 1, 1.5)), (0, (1, 1)), (0, (9, 1.5, 1, 1.5, 1, 1.5)), (0, (3, 1)))
_GUIDE = {"color": "0.6", "linewidth": 0.6, "zorder": 0}
_SHADES = mpl.colormaps["cividis"]
_MAP = ListedColormap(mpl.colormaps["YlGnBu_r"](np.linspace(0.3, 1.0, 256)), "light where loose")


class _Quantity(NamedTuple):
    """What one panel of the profiles shows; quantities of one ``scale`` share the limits of their axis."""

    column: str
    label: str
    factor: float
    scale: str


_PANELS = (
    _Quantity("u1_m", "$u_1$ (mm)", 1e3, "displacement"),
    _Quantity("void_ratio", "void ratio $e$", 1.0, "void ratio"),
    _Quantity("omega_rad", r"$\omega_3^c$ (rad)", 1.0, "rotation"),
    _Quantity("s11_Pa", r"$\sigma_{11}$ (kPa)", 1e-3, "normal stress"),
    _Quantity("s22_Pa", r"$\sigma_{22}$ (kPa)", 1e-3, "normal stress"),
    _Quantity("s33_Pa", r"$\sigma_{33}$ (kPa)", 1e-3, "normal stress"),
    _Quantity("s12_Pa", r"$\sigma_{12}$ (kPa)", 1e-3, "shear stress"),
    _Quantity("s21_Pa", r"$\sigma_{21}$ (kPa)", 1e-3, "shear stress"),
    _Quantity("m32_N_per_m", r"$\mu_{32}$ (N/m)", 1.0, "couple stress"),
)


@dataclass(frozen=True)
class _Column:
    """A piece of the layer in one state, placed on the sheet; arrays of shape ``(rows, lines)``, in mm."""

    label: str
    x: Array
    y: Array
    void_ratio: Array
    rows_per_square: int


def draw_all(run_folder: Path) -> list[Path]:
    """Draw every figure which the run has data for into its folder ``figures``.

    Args:
        run_folder: the run's folder.

    Returns:
        The files drawn: ``history.png``, ``profiles.png``, ``layer.png``; fewer where the run ended early.

    Raises:
        OutputError: the folder is not a run, or a figure cannot be written.
    """
    run = read_run(run_folder)
    folder = RunFolder(run_folder).figures
    drawn = []
    try:
        folder.mkdir(exist_ok=True)
        if run.history["step"].size:
            drawn.append(folder / "history.png")
            draw_history(run, drawn[-1])
        if run.profile_blocks():
            drawn += [folder / "profiles.png", folder / "layer.png"]
            draw_profiles(run, drawn[-2])
            draw_layer(run, drawn[-1])
    except OSError as error:
        raise OutputError(f"{folder}: figures cannot be written: {error.strerror or error}") from error
    return drawn


def draw_history(run: Run, file: Path) -> None:
    """Draw shear stress, mobilised friction and height change against the relative travel of the walls.

    Where the normal stress is constant, friction is the same curve on the right-hand scale; otherwise it has a
    curve of its own. The curves start at rest, free of shear stress. Circles mark the requested profiles.

    Args:
        run: a run with at least one step.
        file: the PNG to write.
    """
    history = {name: np.concatenate([[0.0], column]) for name, column in run.history.items()}
    history["normal_stress_Pa"][0] = history["normal_stress_Pa"][1]
    travel, shear = 1e3 * wall_travel(history), 1e-3 * history["shear_stress_Pa"]
    normal, rise = 1e-3 * np.abs(history["normal_stress_Pa"]), 1e3 * history["height_change_m"]
    with _figure(file, 11.0) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        curves = above.plot(travel, shear, "k-", label=r"shear stress $\sigma_{12}$")
        above.set_ylabel(r"shear stress $\sigma_{12}$ (kPa)")
        above.set_ylim(*_range(shear))
        above.tick_params(right=False)
        below.plot(travel, rise, "k-")
        below.set_ylabel(r"height change $\Delta h$ (mm)")
        below.set_ylim(*_range(rise, least=_height(run)))
        below.set_xlabel("travel of the top wall relative to the bottom wall (mm)")
        friction = r"mobilised friction $\sigma_{12}\,/\,|\sigma_{22}|$"
        if np.ptp(normal) <= 1e-6 * normal.max():
            mean = float(normal.mean())
            above.secondary_yaxis("right", functions=(lambda s: s / mean, lambda f: f * mean)).set_ylabel(friction)
        else:
            right = above.twinx()
            curves += right.plot(travel, shear / normal, color="0.45", linestyle=_DASHES[1], label=friction)
            right.set_ylabel(friction)
            right.set_ylim(*_range(shear / normal))
            above.legend(handles=curves)
        marked = np.isin(history["step"], run.profiles["step"])
        for axes, values in ((above, shear), (below, rise)):
            axes.axhline(0.0, **_GUIDE)
            axes.plot(travel[marked], values[marked], "ko", markerfacecolor="white", markersize=4.0)


def draw_profiles(run: Run, file: Path) -> None:
    """Draw what the paper's figures 3 and 4 show: nine quantities over the height, one line per displacement.

    The critical void ratio in the middle of the band is drawn where the summary tells it.

    Args:
        run: a run with at least one block of profiles.
        file: the PNG to write.
    """
    blocks, labels = run.profile_blocks(), _labels(run)
    height = 1e3 * _height(run)
    critical = (run.summary.get("band") or {}).get("critical_void_ratio")
    with _figure(file, 19.0) as figure:
        grid = figure.subplots(3, 3, sharey=True)
        for panel, axes in zip(_PANELS, grid.flat, strict=True):
            for number, block in enumerate(blocks):
                shade = 0.75 * (1.0 - number / max(len(blocks) - 1, 1))
                axes.plot(
                    panel.factor * block[panel.column],
                    1e3 * block["y_m"],
                    color=_SHADES(shade),
                    linestyle=_DASHES[(len(blocks) - 1 - number) % len(_DASHES)],
                )
            shared = [panel.factor * run.profiles[other.column] for other in _PANELS if other.scale == panel.scale]
            if panel.column == "void_ratio" and critical is not None:
                shared.append(np.array([critical]))
                axes.axvline(critical, **_GUIDE)
                axes.annotate("$e_c$", (critical, height), (-2, -3), textcoords="offset points", ha="right", va="top")
            axes.set_xlim(*_range(np.concatenate(shared)))
            axes.axvline(0.0, **_GUIDE)
            axes.set_xlabel(panel.label)
        for axes in grid[:, 0]:
            axes.set_ylabel("height $y$ (mm)")
            axes.set_ylim(0.0, height)
        figure.legend(
            grid[0, 0].lines[: len(blocks)],
            labels,
            title="travel of the top wall relative to the bottom wall",
            loc="outside upper center",
            ncols=4,
            fontsize=9.0,
            handlelength=3.2,
            columnspacing=1.2,
        )


def draw_layer(run: Run, file: Path, renderer: Renderer | None = None) -> Renderer:
    """Draw a piece of the layer, as it was and at each requested displacement, coloured by its void ratio.

    Lines that were a square grid at the start show the shear.

    Args:
        run: a run with at least one block of profiles.
        file: the PNG to write.
        renderer: what paints the void ratio; by default pyvista where VTK can render here, else matplotlib.

    Returns:
        What painted it.

    Raises:
        RuntimeError: pyvista was asked for and VTK cannot render here.
    """
    columns = _columns(run)
    x, y, void_ratio = (
        np.concatenate([getattr(c, name).ravel() for c in columns]) for name in ("x", "y", "void_ratio")
    )
    extent = (float(x.min()), float(x.max()), float(y.min()), float(y.max()))
    limits = float(void_ratio.min()), max(float(void_ratio.max()), float(void_ratio.min()) + 0.01)
    colours = Normalize(*limits)
    image = None if renderer == "matplotlib" else _vtk_image(columns, extent, limits)
    if image is None and renderer == "pyvista":
        raise RuntimeError("VTK cannot render here")
    pad, height = 0.01 * float(np.ptp(x)), 1e3 * _height(run)
    with _figure(file, 2.6 + 14.5 * float(np.ptp(y) / np.ptp(x))) as figure:
        axes = figure.add_subplot(aspect="equal")
        axes.axis("off")
        if image is not None:
            axes.imshow(image, extent=extent)
        for column in columns:
            if image is None:
                mesh = (column.x, column.y, column.void_ratio)
                axes.pcolormesh(*mesh, norm=colours, cmap=_MAP, shading="gouraud")
            _draw_grid(axes, column)
        _draw_ruler(axes, extent[0] - 2.0 * pad, height)
        axes.set(xlim=(extent[0] - 3.0 * pad, extent[1] + pad), ylim=(extent[2] - pad, extent[3] + pad))
        shades = ScalarMappable(colours, _MAP)
        figure.colorbar(shades, ax=axes, label="void ratio $e$", location="bottom", shrink=0.5, aspect=40.0)
    return "matplotlib" if image is None else "pyvista"


def paint_columns(sheet: str, image: str) -> None:
    """Paint the void ratio of the layer's columns with VTK; called in a process of its own.

    Args:
        sheet: an NPZ file: ``extent`` (left, right, bottom, top), ``limits`` of the colours, and for each column
            an array of shape ``(3, heights, widths)`` with x, y and void ratio.
        image: the PNG to write, which covers the extent.
    """
    import pyvista

    with np.load(sheet) as arrays:
        (left, right, bottom, top), limits = arrays["extent"], arrays["limits"].tolist()
        columns = [arrays[name] for name in arrays.files if name.startswith("column")]
    pixels = 2 * int(_WIDTH * _DPI)
    plotter: Any = pyvista.Plotter(
        off_screen=True, window_size=[pixels, round(pixels * (top - bottom) / (right - left))]
    )
    plotter.set_background("white")
    for x, y, void_ratio in columns:
        grid = pyvista.StructuredGrid(x, y, np.zeros_like(x))
        grid["void ratio"] = void_ratio.ravel(order="F")
        plotter.add_mesh(grid, cmap=_MAP, clim=limits, lighting=False, show_scalar_bar=False)
    middle = (0.5 * (left + right), 0.5 * (bottom + top))
    plotter.camera_position = [(*middle, right - left), (*middle, 0.0), (0.0, 1.0, 0.0)]
    plotter.enable_parallel_projection()
    plotter.parallel_scale = 0.5 * (top - bottom)
    plotter.screenshot(image)


def _vtk_image(columns: list[_Column], extent: tuple[float, ...], limits: tuple[float, float]) -> Array | None:
    """What VTK paints, of shape ``(pixels, pixels, channels)``; None where it fails, aborts or paints nothing."""
    arrays: dict[str, Any] = {f"column{n}": np.stack([c.x, c.y, c.void_ratio]) for n, c in enumerate(columns)}
    paint = "import sys; from cosserat_fx.plots import paint_columns; paint_columns(*sys.argv[1:])"
    with tempfile.TemporaryDirectory() as folder:
        sheet, image = Path(folder, "sheet.npz"), Path(folder, "image.png")
        np.savez(sheet, extent=extent, limits=limits, **arrays)
        try:
            subprocess.run(
                [sys.executable, "-c", paint, sheet, image],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
                capture_output=True,
                timeout=120.0,
                check=True,
            )
            painted = imread(image)
        except (OSError, subprocess.SubprocessError):
            return None
    return painted if np.ptp(painted) > 0.0 else None


def _columns(run: Run) -> list[_Column]:
    """The undeformed layer and the requested states, side by side, in as many rows as they need."""
    height, blocks = 1e3 * _height(run), run.profile_blocks()
    points = blocks[0]["y_m"]
    start = {"y_m": points, "u1_m": np.zeros_like(points), "u2_m": np.zeros_like(points)}
    start["void_ratio"] = np.full_like(points, run.summary["scene"]["initial"]["void_ratio"])
    columns: list[_Column] = []
    edge, floor = 0.0, 0.0
    for label, block in zip(["start", *_labels(run)], [start, *blocks], strict=True):
        column = _column(label, block, height)
        width = float(np.ptp(column.x))
        if edge > 0.0 and edge + width > 6.0 * height:
            edge, floor = 0.0, floor - 1.4 * height
        columns.append(replace(column, x=column.x + edge - column.x.min(), y=column.y + floor))
        edge += width + 0.15 * height
    return columns


def _column(label: str, block: Table, height: float) -> _Column:
    """A piece of the layer, half as wide as high (mm), deformed; squares of a sixteenth of the height."""
    points, squares = 1e3 * block["y_m"], 16
    rows_per_square = -(-points.size // squares)
    y = np.linspace(0.0, height, squares * rows_per_square + 1)
    x = np.linspace(0.0, 0.5 * height, squares // 2 + 1)
    u1, u2 = (1e3 * _to_walls(y, points, block[name]) for name in ("u1_m", "u2_m"))
    void_ratio = np.interp(y, points, block["void_ratio"])
    ones = np.ones_like(x)
    return _Column(
        label, x + u1[:, None], np.outer(y + u2, ones), np.outer(void_ratio, ones), rows_per_square=rows_per_square
    )


def _draw_grid(axes: Axes, column: _Column) -> None:
    """The lines that were a square grid at the start, and the label under the column."""
    lines_x = [*column.x.T, *column.x[:: column.rows_per_square]]
    lines_y = [*column.y.T, *column.y[:: column.rows_per_square]]
    for x, y in zip(lines_x, lines_y, strict=True):
        axes.plot(x, y, color="black", linewidth=0.4)
    foot, label = (column.x[0].mean(), column.y[0, 0]), column.label.replace(" (", "\n(")
    axes.annotate(label, foot, (0, -4), textcoords="offset points", ha="center", va="top", linespacing=0.9)


def _draw_ruler(axes: Axes, x: float, height: float) -> None:
    """A vertical measure of the layer's height (mm) beside the first column."""
    axes.plot([x, x], [0.0, height], "k_-", linewidth=0.6, markersize=4.0)
    where, label = (x, 0.5 * height), f"{height:.4g} mm"
    axes.annotate(label, where, (-3, 0), textcoords="offset points", rotation=90.0, ha="right", va="center")


def _to_walls(y: Array, points: Array, values: Array) -> Array:
    """Linear interpolation, and extrapolation from the outermost points to the walls."""
    if points.size == 1:
        return np.full_like(y, values[0])
    slope = np.gradient(values, points)
    beyond = np.minimum(y - points[0], 0.0) * slope[0] + np.maximum(y - points[-1], 0.0) * slope[-1]
    return np.asarray(np.interp(y, points, values) + beyond)


def _height(run: Run) -> float:
    """The layer's height in the reference configuration (m)."""
    return float(run.summary["scene"]["geometry"]["height"])


def _labels(run: Run) -> list[str]:
    """The wall travel of each block of profiles; on a path with reversals also the step."""
    travel = wall_travel(run.history)
    reverses = np.any(np.diff(np.abs(travel)) < 0.0)
    labels = []
    for block in run.profile_blocks():
        at = travel[run.history["step"] == block["step"][0]]
        label = f"{1e3 * (at if at.size else block['top_displacement_m'])[0]:.4g} mm".replace("-", "\u2212")
        labels.append(f"{label} (step {block['step'][0]:.0f})" if reverses else label)
    return labels


def _range(values: Array, least: float = 0.0) -> tuple[float, float]:
    """Limits of an axis that spans at least so much and two per cent of the values, so that noise stays flat."""
    low, high = float(values.min()), float(values.max())
    span = max(high - low, least, 0.02 * abs(low), 0.02 * abs(high)) or 1.0
    middle = 0.5 * (low + high)
    return middle - 0.56 * span, middle + 0.56 * span


@contextmanager
def _figure(file: Path, height: float) -> Iterator[Figure]:
    """A figure of the page's width and a height in cm, written to the file at the end."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH, height * _CM), layout="constrained")
        yield figure
        figure.savefig(file, dpi=_DPI)
