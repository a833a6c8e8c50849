"""Figures of a run; of a layer: its history, the profiles across it and the deformed layer.

Everything is drawn from the run's folder, at the width of a printed page's text (16 cm). No display is needed:
matplotlib draws on its Agg canvas.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np

from cosserat_fx.output.layer_bands import wall_travel
from cosserat_fx.output.layer_figure import draw_layer
from cosserat_fx.output.page import GUIDE, axis_range, figure, labels, layer_height
from cosserat_fx.output.plane_figures import draw_plane
from cosserat_fx.results import OutputError, Run, RunFolder, read_run

_DASHES = ("-", (0, (6, 1.5)), (0, (5, 1.5, 1, 1.5)), (0, (1, 1)), (0, (9, 1.5, 1, 1.5, 1, 1.5)), (0, (3, 1)))
_SHADES = mpl.colormaps["cividis"]


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


def draw_all(run_folder: Path) -> list[Path]:
    """Draw every figure which the run has data for into its folder ``figures``.

    Args:
        run_folder: the run's folder.

    Returns:
        The files drawn: of a layer ``history.png``, ``profiles.png``, ``layer.png``, of a plane body ``history.png``,
        ``state_01.png`` and so on, and ``shear_strain.gif`` unless its scene rules it out; fewer where the run ended
        early.

    Raises:
        OutputError: the folder is not a run, or a figure cannot be written.
    """
    run = read_run(run_folder)
    folder = RunFolder(run_folder).figures
    drawn = []
    try:
        folder.mkdir(exist_ok=True)
        if run.kind != "layer":
            asked = run.summary["scene"].get("output", {})
            return draw_plane(run, folder, animation=asked.get("animation", True))
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
    with figure(file, 11.0) as sheet:
        above, below = sheet.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        curves = above.plot(travel, shear, "k-", label=r"shear stress $\sigma_{12}$")
        above.set_ylabel(r"shear stress $\sigma_{12}$ (kPa)")
        above.set_ylim(*axis_range(shear))
        above.tick_params(right=False)
        below.plot(travel, rise, "k-")
        below.set_ylabel(r"height change $\Delta h$ (mm)")
        below.set_ylim(*axis_range(rise, least=layer_height(run)))
        below.set_xlabel("travel of the top wall relative to the bottom wall (mm)")
        friction = r"mobilised friction $\sigma_{12}\,/\,|\sigma_{22}|$"
        if np.ptp(normal) <= 1e-6 * normal.max():
            mean = float(normal.mean())
            above.secondary_yaxis("right", functions=(lambda s: s / mean, lambda f: f * mean)).set_ylabel(friction)
        else:
            right = above.twinx()
            curves += right.plot(travel, shear / normal, color="0.45", linestyle=_DASHES[1], label=friction)
            right.set_ylabel(friction)
            right.set_ylim(*axis_range(shear / normal))
            above.legend(handles=curves)
        marked = np.isin(history["step"], run.profiles["step"])
        for axes, values in ((above, shear), (below, rise)):
            axes.axhline(0.0, **GUIDE)
            axes.plot(travel[marked], values[marked], "ko", markerfacecolor="white", markersize=4.0)


def draw_profiles(run: Run, file: Path) -> None:
    """Draw what the paper's figures 3 and 4 show: nine quantities over the height, one line per displacement.

    The critical void ratio in the middle of the band is drawn where the summary tells it.

    Args:
        run: a run with at least one block of profiles.
        file: the PNG to write.
    """
    blocks, names = run.profile_blocks(), labels(run)
    height = 1e3 * layer_height(run)
    critical = (run.summary.get("band") or {}).get("critical_void_ratio")
    with figure(file, 19.0) as sheet:
        grid = sheet.subplots(3, 3, sharey=True)
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
                axes.axvline(critical, **GUIDE)
                axes.annotate("$e_c$", (critical, height), (-2, -3), textcoords="offset points", ha="right", va="top")
            axes.set_xlim(*axis_range(np.concatenate(shared)))
            axes.axvline(0.0, **GUIDE)
            axes.set_xlabel(panel.label)
        for axes in grid[:, 0]:
            axes.set_ylabel("height $y$ (mm)")
            axes.set_ylim(0.0, height)
        sheet.legend(
            grid[0, 0].lines[: len(blocks)],
            names,
            title="travel of the top wall relative to the bottom wall",
            loc="outside upper center",
            ncols=4,
            fontsize=9.0,
            handlelength=3.2,
            columnspacing=1.2,
        )
