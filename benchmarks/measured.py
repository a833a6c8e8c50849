"""What one run of a layer comes to, and what a converged value is made of."""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import process_time
from typing import Any, Literal

import numpy as np

from cosserat_fx.layer import Layer
from cosserat_fx.output.layer_bands import band_metrics, friction_metrics
from cosserat_fx.output.layer_observation import LayerObserver
from cosserat_fx.scene import Scene
from cosserat_fx.stepping import Stepper, SteppingError

type Quantity = Literal["peak", "residual", "thickness"]

QUANTITIES: dict[Quantity, str] = {"peak": "Pa", "residual": "Pa", "thickness": "m"}
"""What is looked at, with its unit."""


@dataclass(frozen=True)
class Measured:
    """What one run came to.

    Attributes:
        study: which measurement it belongs to.
        wall: of the top.
        case: what sets it apart within the study.
        points: integration points per cell.
        cells: over the height.
        peak: largest shear stress of any step (Pa).
        refined_peak: vertex of the parabola through the three largest (Pa).
        residual: shear stress at the end of the path, nan where the run failed (Pa).
        thickness: of the band at the end, by half maximum of the cells' du1/dx2 (m).
        unevenness: largest difference between s12 of a point and the wall's shear stress, over the pressure (%).
        jump: largest difference of s21 between the points of one cell, over the pressure (%).
        steps, iterations, cutbacks: totals.
        substeps: largest number of local substeps of any point.
        seconds: processor time of the loop over the steps.
        end: travel reached (m).
        failure: why it stopped there, empty where it was the end of the path.
        travels: of every step (m).
    """

    study: str
    wall: str
    case: str
    points: int
    cells: int
    peak: float
    refined_peak: float
    residual: float
    thickness: float
    unevenness: float
    jump: float
    steps: int
    iterations: int
    cutbacks: int
    substeps: int
    seconds: float
    end: float
    failure: str
    travels: tuple[float, ...]

    def value(self, quantity: Quantity) -> float:
        """One of the quantities that converge."""
        return {"peak": self.refined_peak, "residual": self.residual, "thickness": self.thickness}[quantity]

    def __str__(self) -> str:
        """One line for the log."""
        run = f"{self.study:16s} {self.wall:12s} {self.case:15s} {self.points} x {self.cells:4d}"
        stresses = f"peak {self.peak:9.2f} Pa, residual {self.residual:9.2f} Pa, band {1e3 * self.thickness:.4f} mm"
        effort = f"{self.steps} steps, {self.iterations} iterations, {self.cutbacks} cutbacks, {self.seconds:.1f} s"
        return f"{run}: {stresses}, {effort} {self.failure}"


@dataclass(frozen=True)
class Converged:
    """A converged value and its error, which is the sum of three parts.

    Attributes:
        wall: of the top.
        quantity: what.
        value: extrapolated (Pa or m).
        step_error, mesh_error, local_error: parts of the error bound (same unit).
        step_rate, mesh_rate: observed orders of convergence, nan where there is no clean one.
    """

    wall: str
    quantity: Quantity
    value: float
    step_error: float
    mesh_error: float
    local_error: float
    step_rate: float
    mesh_rate: float

    @property
    def error(self) -> float:
        """Bound of the whole error."""
        return self.step_error + self.mesh_error + self.local_error


def walk(layer: Layer, stepper: Stepper) -> dict[str, Any]:
    """Go along the path and measure.

    Returns:
        Values of the attributes of :class:`Measured` that follow from the walk.
    """
    observer, failure = LayerObserver(layer), ""
    rows: list[dict[str, float]] = []
    start = process_time()
    try:
        for step in stepper:
            rows.append(observer.row(step))
    except SteppingError as stopped:
        failure = str(stopped)
    seconds = process_time() - start
    history = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    friction = friction_metrics(history)
    return {
        **_band(layer.scene, observer, friction.residual_shear_stress_Pa),
        "peak": friction.peak_shear_stress_Pa,
        "refined_peak": friction.refined_peak_shear_stress_Pa,
        "residual": math.nan if failure else friction.residual_shear_stress_Pa,
        "steps": len(rows),
        "iterations": int(history["newton_iterations"].sum()),
        "cutbacks": int(history["cutbacks"].sum()),
        "substeps": int(history["substeps_max"].max()),
        "seconds": seconds,
        "end": friction.residual_travel_m,
        "failure": failure,
        "travels": tuple(history["top_displacement_m"].tolist()),
    }


def _band(scene: Scene, observer: LayerObserver, shear: float) -> dict[str, float]:
    """Thickness of the band and how even the stresses are, in the last accepted state.

    Args:
        scene: what was run.
        observer: of its layer.
        shear: the wall's shear stress (Pa).
    """
    profile = observer.profile(0, 0.0)  # step and travel would only label it
    assert profile is not None
    cells = {name: column.reshape(scene.geometry.cells, -1) for name, column in profile.items()}
    means = {name: column.mean(axis=1) for name, column in cells.items()}
    # The critical void ratio enters only what is not asked for here.
    band = band_metrics(means, math.nan, d50=scene.material.d50, height=scene.geometry.height)
    pressure = abs(scene.initial.stress)
    return {
        "thickness": band.thickness_m,
        "unevenness": 100 * float(np.abs(profile["s12_Pa"] - shear).max()) / pressure,
        "jump": 100 * float(np.ptp(cells["s21_Pa"], axis=1).max()) / pressure,
    }
