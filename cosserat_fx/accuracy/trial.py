"""Trial runs of a layer: walks along its path of which nothing is kept but the shear stress."""

from __future__ import annotations

import gc
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cosserat_fx import layer
from cosserat_fx._compat import MPI
from cosserat_fx.accuracy.choice import Settings
from cosserat_fx.accuracy.trace import Trace
from cosserat_fx.linear_solver import PetscOption
from cosserat_fx.scene import LayerScene
from cosserat_fx.stepping import StepControl, Stepper

_COLLECTED = 8
"""Walks after which Python collects what is cyclic, as bodies are; with them go MPI communicators, which are few."""


@dataclass
class Trials:
    """Makes trial runs on this rank alone, none of them twice.

    Attributes:
        scene: the layer.
        options: PETSc options.
    """

    scene: LayerScene
    options: Mapping[str, PetscOption]

    def __post_init__(self) -> None:
        """Begin with none."""
        self._made: dict[Settings, Trace] = {}

    @property
    def count(self) -> int:
        """Number of those made."""
        return len(self._made)

    def __call__(self, settings: Settings) -> Trace:
        """Walk to the end of the path.

        Raises:
            SteppingError: the walk does not get there.
            SceneError: as :func:`cosserat_fx.layer.build` says.
        """
        if settings not in self._made:
            self._made[settings] = self._walk(settings)
            if len(self._made) % _COLLECTED == 0:
                gc.collect()
        return self._made[settings]

    def _walk(self, settings: Settings) -> Trace:
        body = layer.build(with_settings(self.scene, settings), MPI.COMM_SELF, dict(self.options))
        control, solver, path = _to_the_end(body.stepper.control), body.stepper.solver, body.path
        rows = []
        try:
            for step in Stepper(body.problem, solver, path.corners, body.stations, control):
                rows.append((step.travel, body.problem.reactions()["top", "u1"], step.size, step.rate_error))
        finally:
            solver.snes.destroy()  # or its callbacks keep the problem
        travel, shear, size, rate_error = np.array(rows).T
        mean = float(np.dot(size, rate_error) / size.sum())
        return Trace.of(travel, shear, path.corners, self.scene.legs, rate_error=mean)


def with_settings(scene: LayerScene, settings: Settings) -> LayerScene:
    """A scene with what was chosen for it in place of what it leaves out."""
    control = layer.control_of(scene)
    return scene.model_copy(
        update={
            "geometry": scene.geometry.model_copy(update={"cells": settings.cells}),
            "stepping": scene.stepping.model_copy(
                update={
                    "first_step": max(min(settings.factor * control.first, control.largest), control.smallest),
                    "tolerance": settings.factor * scene.stepping.tolerance,
                    "strain": settings.factor * scene.stepping.strain,
                }
            ),
            "solver": scene.solver.model_copy(update={"local_tolerance": settings.local_tolerance}),
        }
    )


def _to_the_end(control: StepControl) -> StepControl:
    """The same control without a limit to the number of steps."""
    return replace(control, max_steps=StepControl.max_steps)
