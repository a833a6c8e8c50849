"""What a random layer comes to in the limit of fine meshes, short steps and a tight local tolerance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from accuracy_promise_scenes import RandomLayer

from cosserat_fx.accuracy.choice import Settings
from cosserat_fx.accuracy.trace import scale
from cosserat_fx.accuracy.trial import Trials
from cosserat_fx.studies.convergence import limit
from cosserat_fx.typing import Array

TIGHT = 1e-4
"""Local tolerance: at steps as short as these it makes less than 0.01 %."""
MESH_FACTOR = 0.5
"""The aims of the steps, over the default ones, with which the mesh is refined."""
STEP_FACTORS = (0.5, 0.25, 0.125)
FINEST = 1 / 8
"""Cells over d50 beyond which the mesh is not refined."""


@dataclass(frozen=True)
class Reference:
    """Converged values of every leg.

    Attributes:
        values: (2, legs) peaks and residuals (Pa).
        uncertainty: largest relative bound of their error, that of the mesh and that of the steps added up.
        cell: over d50, the smallest.
    """

    values: Array
    uncertainty: float
    cell: float


def reference(layer: RandomLayer, certain: float) -> Reference:
    """Refine until the limits are in sight: first the mesh, then, on a mesh within it, the steps.

    Args:
        layer: what is run.
        certain: the relative uncertainty that is enough.
    """
    walk = Trials(layer.scene(cells=1), {})
    meshes, cell = [], 1.0
    while True:
        cells = max(8, round(layer.height / cell))
        meshes.append(walk(Settings(cells, MESH_FACTOR, TIGHT)).values)
        if len(meshes) > 2:
            fine, mesh_error = _limit(meshes)
            if mesh_error <= certain / 2 or cell <= FINEST:
                break
        cell /= 2
    # Where the mesh converges late, so does what the steps do on it.
    cells = max(8, round(layer.height / min(1.0, 4 * cell)))
    steps = [walk(Settings(cells, factor, TIGHT)).values for factor in STEP_FACTORS]
    short, step_error = _limit(steps)
    return Reference(fine + short - steps[0], mesh_error + step_error, cell)


def _limit(sequence: list[Array]) -> tuple[Array, float]:
    """Limits of every value, and the largest relative bound of their errors."""
    found = [limit([float(values.flat[k]) for values in sequence]) for k in range(sequence[0].size)]
    values = np.array([float(it.value) for it in found]).reshape(sequence[0].shape)
    bounds = np.array([it.error for it in found]).reshape(values.shape)
    return values, float((bounds / scale(values)).max())
