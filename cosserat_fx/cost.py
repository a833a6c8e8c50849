"""What a run is going to cost, before it runs: a look at the path and a short calibration of the kernel."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from cosserat_fx.layer import Layer

ITERATIONS_PER_STEP = 5.0
STEPS_TO_PEAK = 20
BAND_IN_GRAINS = 10.0
"""Typical figures of the default step control on the paper's layers (see the accuracy page)."""
_CALIBRATION_STRAIN = 0.02
_CALIBRATION_POINTS = 64


@dataclass(frozen=True)
class Cost:
    """Expected cost of a run.

    Attributes:
        steps: accepted steps.
        update_seconds: in the constitutive update, on one rank of this machine.
        state_bytes: of the state at all quadrature points.
    """

    steps: int
    update_seconds: float
    state_bytes: int

    def __str__(self) -> str:
        """One line for the user."""
        return (
            f"expected cost: about {self.steps} steps, {self.update_seconds:.2g} s of constitutive update on one rank, "
            f"{self.state_bytes / 1e6:.3g} MB of state"
        )


def expected_cost(layer: Layer) -> Cost:
    """Estimate steps, kernel time and memory.

    Shear localises in a band of some ten grains, whose strain per step is bounded; the steps up to the peak come on
    top, once a leg.
    """
    problem, control = layer.problem, layer.stepper.control
    band = min(BAND_IN_GRAINS * problem.material.d50, layer.scene.geometry.height)
    by_strain = layer.path.length / min(control.strain * band, control.largest)
    steps = int(STEPS_TO_PEAK * len(layer.scene.legs) + by_strain)
    points = problem.sizes["quadrature_points"]
    seconds = steps * ITERATIONS_PER_STEP * points * _seconds_per_point(layer)
    return Cost(steps, seconds, points * problem.state.bytes_per_point)


def _seconds_per_point(layer: Layer) -> float:
    """Time of one update with tangent of one point sheared from the initial state."""
    state, layout = layer.problem.state, layer.problem.layout
    shear = np.zeros((min(_CALIBRATION_POINTS, len(state.points)), layout.n_inputs))
    shear[:, layout.strain.index((0, 1))] = _CALIBRATION_STRAIN
    start = perf_counter()
    state.update(shear, adapt=True)
    seconds = perf_counter() - start
    state.substeps[:] = 1
    state.roll_back()
    return seconds / len(shear)
