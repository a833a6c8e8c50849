"""Mesh, steps and local tolerance for a requested accuracy, from trial runs of the scene itself.

Three sources of error are measured one by one, each by what a change of its own makes:

- steps: their error is proportional to the mean error of the strain rate that the walk tells of itself, and two walks
  with steps of different size tell the factor;
- mesh: cells are halved until the differences promise an error small enough, which falls with the square of the cell
  size or, where the last two differences show a lower order, with that;
- local tolerance: what a tenth of it makes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil, log2

import numpy as np

from cosserat_fx.accuracy.trace import Trace, apart
from cosserat_fx.scene import LayerScene
from cosserat_fx.typing import Array

MESH_SHARE, STEP_SHARE = 0.35, 0.25
"""Parts of the accuracy that the errors of mesh and steps are to take."""
LOCAL_SHARE = 0.1
"""Part of the accuracy that the local tolerance is, to begin with, and that the error due to it may take."""
TIGHTEST, LOOSEST = 1e-6, 1e-2
"""Local tolerances that are chosen."""
COARSEST, FINEST = 4.0, 1 / 4
"""Cells over d50: the coarsest that show a band, and those from which on trial runs are not refined any more."""
FEWEST_CELLS = 8
LARGEST_FACTOR, SMALLEST_FACTOR = 2.0, 1 / 64
"""Of the step control's aims. With larger ones steps fail, and cost more instead of less."""
CLEAN = 1.5
"""Order of convergence from which on it is trusted to go on."""
SLOWEST, ORDER = 0.5, 2.0
"""Orders of the mesh's error: the lowest that is reckoned with, and that of the elements."""
_SLACK = 1.5
"""How much more than expected the error of a mesh between those of the trial runs may be."""
_SAME = 1.2
"""Walks whose rate errors differ by less have been stepped by something else than the aims."""


@dataclass(frozen=True)
class Settings:
    """What accuracy is bought with.

    Attributes:
        cells: over the height.
        factor: by which the default first step and aims of the step control are multiplied.
        local_tolerance: of the constitutive update.
    """

    cells: int
    factor: float
    local_tolerance: float


type Walk = Callable[[Settings], Trace]


@dataclass(frozen=True)
class Level:
    """A mesh that was tried.

    Attributes:
        cells: over the height.
        values: (2, legs) peaks and residuals (Pa).
    """

    cells: int
    values: Array


@dataclass(frozen=True)
class Choice:
    """What was chosen, and what it takes to tell the error in the end.

    Attributes:
        settings: of the run.
        levels: meshes that were tried, from coarse to fine, with the run's steps and local tolerance.
        step_factor: (2, legs) relative error due to the steps over the mean error of the strain rate.
        local_error: (2, legs) relative error due to the local tolerance.
    """

    settings: Settings
    levels: tuple[Level, ...]
    step_factor: Array
    local_error: Array


def choose(scene: LayerScene, asked: float, walk: Walk, coarsest: int) -> Choice:
    """Choose what the scene does not give.

    Args:
        scene: the layer.
        asked: its accuracy.
        walk: makes a trial run.
        coarsest: fewest cells of a trial run.

    Raises:
        SteppingError: a trial run did not reach the end of the path.
    """
    given = "solver.local_tolerance" in scene.given
    tolerance = scene.solver.local_tolerance if given else float(np.clip(LOCAL_SHARE * asked, TIGHTEST, LOOSEST))
    fixed = any(key.startswith("stepping.") for key in scene.given)
    factor, step_factor = choose_steps(walk, 2 * coarsest, tolerance, STEP_SHARE * asked, fixed=fixed)
    start = Settings(2 * coarsest, factor, tolerance)
    tolerance, local_error = choose_tolerance(walk, start, LOCAL_SHARE * asked, fixed=given)

    def on(cells: int) -> Trace:
        return walk(Settings(cells, factor, tolerance))

    finest = scene.geometry.cells or scene.geometry.height / (FINEST * scene.material.d50)
    levels = refine(on, coarsest, finest, MESH_SHARE * asked)
    cells = scene.geometry.cells or checked_cells(on, levels, MESH_SHARE * asked)
    return Choice(Settings(cells, factor, tolerance), tuple(levels), step_factor, local_error)


def coarsest_cells(scene: LayerScene) -> int:
    """Fewest cells that show a band, and what the initial state has in it."""
    if scene.geometry.cells:
        return max(scene.geometry.cells // 4, 1)
    lengths = [COARSEST * scene.material.d50, scene.geometry.height / FEWEST_CELLS]
    lengths += [zone.y[1] - zone.y[0] for zone in scene.initial.zones if zone.y]
    if scene.initial.random:
        lengths.append(scene.initial.random.correlation_length_d50 * scene.material.d50)
    return ceil(scene.geometry.height / min(lengths))


def choose_steps(walk: Walk, cells: int, tolerance: float, share: float, *, fixed: bool) -> tuple[float, Array]:
    """Choose the step control's aims for an error due to the steps.

    Args:
        walk: makes a trial run.
        cells: of the trial runs.
        tolerance: local.
        share: the relative error allowed.
        fixed: whether the aims are to stay as they are.

    Returns:
        What the default aims are multiplied by, and the errors (2, legs) over the mean error of the strain rate.
    """
    factor = 2.0 if fixed else LARGEST_FACTOR
    long = walk(Settings(cells, factor, tolerance))
    while True:
        short = walk(Settings(cells, factor / 2, tolerance))
        change, differ = apart(long.values, short.values), long.rate_error > _SAME * short.rate_error
        gap = long.rate_error - short.rate_error if differ else short.rate_error
        slope = change / gap
        if fixed:
            return 1.0, slope
        if _error(slope, long) <= share:
            return factor, slope
        factor, error = factor / 2, _error(slope, short)
        if (error <= 2 * share and differ) or factor <= SMALLEST_FACTOR:
            return max(factor * min(share / error, 2.0), SMALLEST_FACTOR), slope
        long = short


def _error(slope: Array, trial: Trace) -> float:
    """Largest relative error due to the steps, by how much they may miss the peaks included."""
    return float((slope * trial.rate_error + trial.chance).max())


def choose_tolerance(walk: Walk, start: Settings, share: float, *, fixed: bool) -> tuple[float, Array]:
    """Choose the local tolerance for an error due to it, which is what a tenth of it makes.

    Args:
        walk: makes a trial run.
        start: with the tolerance to begin with.
        share: the relative error allowed.
        fixed: whether it is to stay as it is.

    Returns:
        The tolerance and the relative errors (2, legs).
    """
    tighter = replace(start, local_tolerance=start.local_tolerance / 10)
    errors = apart(walk(start).values, walk(tighter).values)
    if fixed or errors.max() <= share or tighter.local_tolerance < TIGHTEST:
        return start.local_tolerance, errors
    return choose_tolerance(walk, tighter, share, fixed=False)


def refine(walk: Callable[[int], Trace], coarsest: int, finest: float, share: float) -> list[Level]:
    """Halve the cells until the error due to the mesh is below a share of the accuracy, or will be halved once more.

    Args:
        walk: makes a trial run with a number of cells.
        coarsest: cells to begin with.
        finest: number of cells from which on they are not halved any more.
        share: the relative error allowed.
    """
    levels = [Level(cells, walk(cells).values) for cells in (coarsest, 2 * coarsest)]
    while levels[-1].cells < finest and expected(levels) > share:
        cells = 2 * levels[-1].cells
        levels.append(Level(cells, walk(cells).values))
    return levels


def expected(levels: Sequence[Level]) -> float:
    """Largest relative error with one halving more of the cells, where the order is clean, or without it."""
    orders, errors = orders_and_errors(levels)
    return float(np.where(orders >= CLEAN, errors / 2**ORDER, errors).max())


def orders_and_errors(levels: Sequence[Level]) -> tuple[Array, Array]:
    """Orders of convergence that the last differences show, and the relative errors on the finest mesh, both (2, legs).

    Two meshes alone show no order. Their difference then is the error, which is more than it would be by any order
    above 1.
    """
    differences = [apart(coarse.values, fine.values) for coarse, fine in pairwise(levels)]
    last = differences[-1]
    if len(differences) == 1:
        return np.zeros_like(last), last
    ratios = differences[-2] / np.maximum(last, np.finfo(float).eps)
    orders = np.clip(np.log2(np.maximum(ratios, 1.0)), SLOWEST, ORDER)
    return orders, last / (2**orders - 1)


def checked_cells(walk: Callable[[int], Trace], levels: Sequence[Level], share: float) -> int:
    """Number of cells for an error due to the mesh, tried where it is less than that of the finest mesh.

    A band may find another place on another mesh. The finest is taken where a coarser one is worse than expected.

    Args:
        walk: makes a trial run with a number of cells.
        levels: meshes that were tried, each with half the cells of the next.
        share: the relative error allowed.
    """
    cells = cells_for(levels, share)
    if cells >= levels[-1].cells:
        return cells
    _, rest = orders_and_errors(levels)
    errors = apart(walk(cells).values, levels[-1].values) + rest
    return cells if errors.max() <= _SLACK * share else levels[-1].cells


def cells_for(levels: Sequence[Level], share: float) -> int:
    """Number of cells for an error due to the mesh.

    Between two meshes that were tried the error follows a power of the cell size, beyond the finest the square.

    Args:
        levels: meshes that were tried, each with half the cells of the next.
        share: the relative error allowed.
    """
    _, last = orders_and_errors(levels)
    errors = [float((apart(level.values, levels[-1].values) + last).max()) for level in levels]
    if errors[-1] > share:
        refinement = (errors[-1] / share) ** (1 / ORDER) if expected(levels) <= share else 1.0
        return ceil(float(levels[-1].cells * refinement))
    for fine in range(len(levels) - 1, 0, -1):
        coarse = fine - 1
        if errors[coarse] > share:
            power = log2(errors[coarse] / errors[fine])
            return ceil(float(levels[fine].cells * (errors[fine] / share) ** (1 / power)))
    return levels[0].cells
