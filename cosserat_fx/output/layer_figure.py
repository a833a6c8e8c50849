"""The picture of the deformed layer with its void ratio, the paper's figure 2.

VTK paints in a process of its own, because it may abort where it cannot render; matplotlib then paints instead.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.image import imread

from cosserat_fx.output.page import DPI, LOOSE, WIDTH, figure, labels, layer_height
from cosserat_fx.results import Run, Table
from cosserat_fx.typing import Array

type Renderer = Literal["pyvista", "matplotlib"]


@dataclass(frozen=True)
class _Column:
    """A piece of the layer in one state, placed on the sheet; arrays of shape ``(rows, lines)``, in mm."""

    label: str
    x: Array
    y: Array
    void_ratio: Array
    rows_per_square: int


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
    pad, height = 0.01 * float(np.ptp(x)), 1e3 * layer_height(run)
    with figure(file, 2.6 + 14.5 * float(np.ptp(y) / np.ptp(x))) as sheet:
        axes = sheet.add_subplot(aspect="equal")
        axes.axis("off")
        if image is not None:
            axes.imshow(image, extent=extent)
        for column in columns:
            if image is None:
                mesh = (column.x, column.y, column.void_ratio)
                axes.pcolormesh(*mesh, norm=colours, cmap=LOOSE, shading="gouraud")
            _draw_grid(axes, column)
        _draw_ruler(axes, extent[0] - 2.0 * pad, height)
        axes.set(xlim=(extent[0] - 3.0 * pad, extent[1] + pad), ylim=(extent[2] - pad, extent[3] + pad))
        shades = ScalarMappable(colours, LOOSE)
        sheet.colorbar(shades, ax=axes, label="void ratio $e$", location="bottom", shrink=0.5, aspect=40.0)
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
    pixels = 2 * int(WIDTH * DPI)
    plotter: Any = pyvista.Plotter(
        off_screen=True, window_size=[pixels, round(pixels * (top - bottom) / (right - left))]
    )
    plotter.set_background("white")
    for x, y, void_ratio in columns:
        grid = pyvista.StructuredGrid(x, y, np.zeros_like(x))
        grid["void ratio"] = void_ratio.ravel(order="F")
        plotter.add_mesh(grid, cmap=LOOSE, clim=limits, lighting=False, show_scalar_bar=False)
    middle = (0.5 * (left + right), 0.5 * (bottom + top))
    plotter.camera_position = [(*middle, right - left), (*middle, 0.0), (0.0, 1.0, 0.0)]
    plotter.enable_parallel_projection()
    plotter.parallel_scale = 0.5 * (top - bottom)
    plotter.screenshot(image)


def _vtk_image(columns: list[_Column], extent: tuple[float, ...], limits: tuple[float, float]) -> Array | None:
    """What VTK paints, of shape ``(pixels, pixels, channels)``; None where it fails, aborts or paints nothing."""
    arrays: dict[str, Any] = {f"column{n}": np.stack([c.x, c.y, c.void_ratio]) for n, c in enumerate(columns)}
    paint = "import sys; from cosserat_fx.output.layer_figure import paint_columns; paint_columns(*sys.argv[1:])"
    with tempfile.TemporaryDirectory() as folder:
        sheet, image = Path(folder, "sheet.npz"), Path(folder, "image.png")
        np.savez(sheet, extent=extent, limits=limits, **arrays)
        try:
            subprocess.run(
                [*_display(), sys.executable, "-c", paint, sheet, image],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
                capture_output=True,
                timeout=120.0,
                check=True,
            )
            painted = imread(image)
        except (OSError, subprocess.SubprocessError):
            return None
    return painted if np.ptp(painted) > 0.0 else None


def _display() -> list[str]:
    """The command that lends VTK a display, where there is none and one can be had: Debian's VTK needs one."""
    virtual = None if "DISPLAY" in os.environ else shutil.which("xvfb-run")
    return [virtual, "--auto-servernum"] if virtual else []


def _columns(run: Run) -> list[_Column]:
    """The undeformed layer and the requested states, side by side, in as many rows as they need."""
    height, blocks = 1e3 * layer_height(run), run.profile_blocks()
    points = blocks[0]["y_m"]
    start = {"y_m": points, "u1_m": np.zeros_like(points), "u2_m": np.zeros_like(points)}
    start["void_ratio"] = np.full_like(points, run.summary["scene"]["initial"]["void_ratio"])
    columns: list[_Column] = []
    edge, floor = 0.0, 0.0
    for label, block in zip(["start", *labels(run)], [start, *blocks], strict=True):
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
