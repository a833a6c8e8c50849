"""How long the constitutive update takes, and which part of that each effect is to blame for: a short calibration."""

from __future__ import annotations

import timeit
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cosserat_fx.effects import Effect
from cosserat_fx.layout import Layout, layout
from cosserat_fx.state import MAX_SUBSTEPS, point_record
from cosserat_fx.typing import Array
from cosserat_fx.update import build_update, compile_update

if TYPE_CHECKING:
    from cosserat_fx.bodies import Body

IN_KERNEL = ("polar", "spin", "evolving void ratio")
"""The effects with a part in the kernel."""
_SHEAR_STRAIN = 1e-3
_POINTS = 256
_REPEATS = 15
_SAMPLE = 2048
_OUTSIDE = 1e-2
"""Shear strain outside of a band over that within."""
_STATE = ("forces_n", "e_n", "forces", "e", "tangent", "substeps", "status", "error")


def kernel_shares(listed: list[Effect], body: Body) -> list[Effect]:
    """The effects with their shares of the update's time, by how much it is shorter without each of them. Collective.

    Only the first rank measures; the others get to know.

    Args:
        listed: the effects of the body.
        body: what is run.
    """
    problem = body.problem
    shares = _shares(body) if problem.comm.rank == 0 else {}
    shares = problem.comm.bcast(shares)
    return [replace(effect, kernel_time=shares.get(effect.name)) for effect in listed]


def seconds_per_substep(body: Body) -> float:
    """Time of one local substep of one point with tangent, by the kernel of this run (s)."""
    return _measure(body, body.problem.layout, void_ratio=body.problem.numerics.void_ratio)


def _shares(body: Body) -> dict[str, float]:
    full, evolving = body.problem.layout, body.problem.numerics.void_ratio
    spin = bool(full.spin)
    without: dict[str, tuple[Layout, bool]] = {}
    if full.polar:
        without["polar"] = layout(full.dimension, polar=False, spin=spin), evolving
    if spin:
        without["spin"] = layout(full.dimension, polar=full.polar, spin=False), evolving
    if evolving:
        without["evolving void ratio"] = full, False
    seconds = seconds_per_substep(body)
    return {
        name: max(0.0, 1 - _measure(body, components, void_ratio=void_ratio) / seconds)
        for name, (components, void_ratio) in without.items()
    }


def seconds_per_update(body: Body, band: float) -> float:
    """Time in which a typical update, substeps and tangent included, gets done with one point (s).

    The batch is as large as this rank's own or a sample of it. Its points have been sheared once from the initial
    state and are sheared on: those in a band by as much as the step control lets them, the others by much less.

    Args:
        body: what is run.
        band: part of the points that lie in a shear band.
    """
    problem = body.problem
    number = min(max(len(problem.state.points), 1), _SAMPLE)
    place = (np.arange(number) + 0.5) / number
    shear = body.stepper.control.strain * (np.exp(-(((place - 0.5) / (0.5 * band)) ** 2)) + _OUTSIDE)
    batch = _Batch(body, problem.layout, number, shear, void_ratio=problem.numerics.void_ratio)
    batch.update(tolerance=problem.state.tolerance, adapt=True)
    batch.commit()
    return batch.seconds(lambda: batch.update(tolerance=problem.state.tolerance, adapt=True))


def _measure(body: Body, components: Layout, *, void_ratio: bool) -> float:
    """Time of one substep of one point with the kernel of some components, sheared from the initial state (s)."""
    batch = _Batch(body, components, _POINTS, np.full(_POINTS, _SHEAR_STRAIN), void_ratio=void_ratio)
    return batch.seconds(lambda: batch.update(tolerance=1.0, adapt=False))


class _Batch:
    """Points in simple shear, to be timed."""

    def __init__(self, body: Body, components: Layout, number: int, shear: Array, *, void_ratio: bool) -> None:
        """From a scene's initial state.

        Args:
            body: what is run.
            components: of the kernel.
            number: of points.
            shear: (number,) shear strain increment.
            void_ratio: whether it evolves.
        """
        scene = body.scene
        self._update = build_update(components, spin=bool(components.spin), void_ratio=void_ratio)
        self._constants = scene.material.kernel_parameters()
        compile_update(self._update, components, self._constants)
        record = point_record(components, void_ratio=True)
        self._arrays = {name: np.zeros(number, record[name]) for name in record.names or ()}
        for k, (i, j) in enumerate(components.stress):
            self._arrays["forces_n"][:, k] = scene.initial.stress if i == j else 0.0
        self._arrays["e_n"][:] = scene.initial.void_ratio
        self._increments = np.zeros((number, components.n_inputs))
        for k, (i, j) in enumerate(components.strain):
            self._increments[:, k] = shear / 2 if i != j else 0.0
        self._points = np.arange(number, dtype=np.int32)

    def update(self, *, tolerance: float, adapt: bool) -> None:
        """Update all points from the committed state."""
        self._arrays["substeps"][:] = 1
        state = [self._arrays[name] for name in _STATE]
        self._update(self._increments, self._points, *state, self._constants, tolerance, MAX_SUBSTEPS, adapt, True)

    def commit(self) -> None:
        """Go on from the stresses found; the void ratio stays, as if the shear dilated nothing."""
        self._arrays["forces_n"][:] = self._arrays["forces"]

    def seconds(self, call: Callable[[], None]) -> float:
        """Shortest time of a call, over the number of points (s)."""
        return min(timeit.repeat(call, number=1, repeat=_REPEATS)) / len(self._points)
