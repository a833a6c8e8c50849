"""How long the constitutive update takes, and which part of that each effect is to blame for: a short calibration."""

from __future__ import annotations

import timeit
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cosserat_fx.effects import Effect
from cosserat_fx.layout import Layout, layout
from cosserat_fx.state import MAX_SUBSTEPS, point_record
from cosserat_fx.update import build_update, compile_update

if TYPE_CHECKING:
    from cosserat_fx.bodies import Body

IN_KERNEL = ("polar", "spin", "evolving void ratio")
"""The effects with a part in the kernel."""
_SHEAR_STRAIN = 1e-3
_POINTS = 256
_REPEATS = 15


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


def _measure(body: Body, components: Layout, *, void_ratio: bool) -> float:
    """Time of one substep of one point with the kernel of some components, sheared from the initial state (s)."""
    scene = body.scene
    update = build_update(components, spin=bool(components.spin), void_ratio=void_ratio)
    c = scene.material.kernel_parameters()
    compile_update(update, components, c)
    record = point_record(components, void_ratio=True)
    arrays = {name: np.zeros(_POINTS, record[name]) for name in record.names or ()}
    for k, (i, j) in enumerate(components.stress):
        arrays["forces_n"][:, k] = scene.initial.stress if i == j else 0.0
    arrays["e_n"][:] = scene.initial.void_ratio
    arrays["substeps"][:] = 1
    increments = np.zeros((_POINTS, components.n_inputs))
    for k, (i, j) in enumerate(components.strain):
        increments[:, k] = _SHEAR_STRAIN / 2 if i != j else 0.0
    points = np.arange(_POINTS, dtype=np.int32)
    state = [arrays[name] for name in ("forces_n", "e_n", "forces", "e", "tangent", "substeps", "status", "error")]

    def call() -> None:
        update(increments, points, *state, c, 1.0, MAX_SUBSTEPS, False, True)

    return min(timeit.repeat(call, number=1, repeat=_REPEATS)) / _POINTS
