"""The error of a run, estimated from its trial runs and from what it tells of itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosserat_fx.accuracy.choice import ORDER, Choice, orders_and_errors
from cosserat_fx.accuracy.trace import Trace, apart
from cosserat_fx.typing import Array

_FINER = 1.25
"""Ratio of cells from which on a difference between two meshes says something."""


@dataclass(frozen=True)
class Estimate:
    """Relative errors of peak and residual shear stress, the largest of any leg, by source.

    Attributes:
        mesh, steps, local_tolerance: each (2,), peak and residual. That of the steps has in it by how much they miss
            the peak.
        total: (2,) of all sources in the worst leg, as if they added up.
    """

    mesh: Array
    steps: Array
    local_tolerance: Array
    total: Array


def estimate(choice: Choice, run: Trace) -> Estimate:
    """Estimate the error of a run.

    Args:
        choice: what it was made with, and the trial runs.
        run: what it came to.
    """
    sources = {
        "mesh": mesh_errors(choice, run),
        "steps": choice.step_factor * run.rate_error + run.sampling,
        "local_tolerance": choice.local_error,
    }
    total = np.sum(list(sources.values()), axis=0)
    return Estimate(**{name: errors.max(axis=1) for name, errors in sources.items()}, total=total.max(axis=1))


def mesh_errors(choice: Choice, run: Trace) -> Array:
    """(2, legs) relative errors due to the mesh.

    Where a trial run was finer than the run, its distance from there to go and the rest from there on; otherwise what
    the step from the finest trial run to the run promises, at second order.
    """
    finest, cells = choice.levels[-1], choice.settings.cells
    change = apart(run.values, finest.values)
    ratio = cells / finest.cells
    _, rest = orders_and_errors(choice.levels)
    errors: Array = change / (ratio**ORDER - 1) if ratio > _FINER else change + rest
    return errors
