"""What a run is going to cost, before it runs: a look at the path and a short calibration of the kernel."""

from __future__ import annotations

import timeit
from dataclasses import dataclass

import numpy as np

from cosserat_fx.layer import Layer

UPDATES_PER_STEP = 7
SUBSTEPS_PER_UPDATE = 2
STEPS_TO_PEAK = 20
BAND_IN_GRAINS = 10.0
"""Typical figures of the default step control on the paper's layers, from the entries of their run.json."""
_CALIBRATION_STRAIN = 1e-3
_CALIBRATION_POINTS = 1024
_CALIBRATION_REPEATS = 10


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
    seconds = steps * UPDATES_PER_STEP * SUBSTEPS_PER_UPDATE * points * _seconds_per_substep(layer)
    return Cost(steps, seconds, points * problem.state.bytes_per_point)


def _seconds_per_substep(layer: Layer) -> float:
    """Time of one local substep with tangent, sheared from the initial state of a few of this rank's points."""
    state, layout = layer.problem.state, layer.problem.layout
    shear = np.zeros((min(_CALIBRATION_POINTS, len(state.points)), layout.n_inputs))
    shear[:, layout.strain.index((0, 1))] = _CALIBRATION_STRAIN
    seconds = min(timeit.repeat(lambda: state.update(shear, adapt=False), number=1, repeat=_CALIBRATION_REPEATS))
    state.roll_back()
    return seconds / len(shear)
