"""What a run to a requested accuracy is made with: a layer's scene with all that it leaves out filled in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from typing import Any

from cosserat_fx.accuracy.choice import Choice, Settings, choose, coarsest_cells
from cosserat_fx.accuracy.trial import Trials, with_settings
from cosserat_fx.linear_solver import PetscOption
from cosserat_fx.scene import LayerScene
from cosserat_fx.stepping import SteppingError

_ATTEMPTS = 3
"""How often trial runs begin with a mesh twice as fine, where one on a coarse mesh does not reach the end."""


@dataclass(frozen=True)
class Plan:
    """How a layer is run.

    Attributes:
        asked: the accuracy.
        scene: with mesh, steps and local tolerance filled in.
        given: keys of these that the scene had given, which stay as they were.
        choice: what was chosen and found in trial runs; None where these failed.
        trials: number of trial runs that reached the end.
        failure: why trial runs failed; empty where they did not.
    """

    asked: float
    scene: LayerScene
    given: tuple[str, ...]
    choice: Choice | None
    trials: int
    failure: str = ""

    def chosen(self) -> dict[str, Any]:
        """Mesh, element, steps and tolerance, of types that JSON knows."""
        scene = self.scene
        return {
            "cells": scene.cells,
            "cell_d50": scene.geometry.height / scene.cells / scene.material.d50,
            "integration_points": scene.solver.integration_points,
            "first_step_m": scene.stepping.first_step,
            "tolerance": scene.stepping.tolerance,
            "strain": scene.stepping.strain,
            "local_tolerance": scene.solver.local_tolerance,
        }

    def __str__(self) -> str:
        """Two lines for the user."""
        it = self.chosen()
        kept = f"; given and kept: {', '.join(self.given)}" if self.given else ""
        return (
            f"accuracy {percent(self.asked)}, by {self.trials} trial runs: {it['cells']} cells of {it['cell_d50']:.3g} "
            f"d50,\naims of steps {it['tolerance']:.3g} and {it['strain']:.3g} from {it['first_step_m']:.3g} m on, "
            f"local tolerance {it['local_tolerance']:.2g}{kept}"
        )


def percent(part: float) -> str:
    """A part in per cent, to two digits."""
    return f"{100 * part:.2g} %"


def plan(scene: LayerScene, options: Mapping[str, PetscOption] | None) -> Plan:
    """Choose how to run a layer with an accuracy, by trial runs on this rank alone.

    Where trial runs fail, nothing can be said of errors, and the run is made with cells of one grain and default steps.

    Args:
        scene: the layer.
        options: PETSc options (without prefix).

    Raises:
        SceneError: as :func:`cosserat_fx.layer.build` says.
    """
    assert scene.accuracy is not None
    walk, coarsest, failure = Trials(scene, options or {}), coarsest_cells(scene), ""
    for attempt in range(_ATTEMPTS):
        try:
            choice = choose(scene, scene.accuracy, walk, coarsest * 2**attempt)
            return Plan(scene.accuracy, with_settings(scene, choice.settings), scene.given, choice, walk.count)
        except SteppingError as error:
            failure = str(error)
    cells = scene.geometry.cells or ceil(scene.geometry.height / scene.material.d50)
    default = with_settings(scene, Settings(cells, 1.0, scene.solver.local_tolerance))
    return Plan(scene.accuracy, default, scene.given, None, walk.count, failure)
