"""Plane bodies between four sides: common conditions, and what happens at a side."""

from typing import Any

import numpy as np
from planes import D50, PRESSURE, run

from cosserat_fx.conditions import Field
from cosserat_fx.problem import Problem
from cosserat_fx.typing import Array

WIDTH = 0.02
RADIUS = D50 / 2
SIDES = ("bottom", "top", "left", "right")
FIELDS: tuple[Field, ...] = ("u1", "u2", "w")
UNDER_PRESSURE = {"pressure": PRESSURE}
HELD = {"u1": 0.0, "u2": 0.0}
LOCALLY_EXACT = {"solver.local_tolerance": 1e-7}
STEPS = {"first_step": 5e-5, "max_step": 5e-5}


def on_boundary(problem: Problem, name: str) -> tuple[Array, Array]:
    """Reference coordinates (n, 2) of a boundary's nodes of linear elements, ordered along it, and their fields (n, 3).

    The mesh is the unit square's, mapped: nodes are found by the facets.
    """
    ends = np.unique(np.round(problem.geometry.facets(name)[0].reshape(-1, 2), 9), axis=0)
    values = [np.array([at(problem, field, place) for place in ends]) for field in FIELDS]
    return ends, np.stack(values, axis=1)


def at(problem: Problem, field: Field, place: Array | tuple[float, float]) -> float:
    """A field at the node of a place (m)."""
    nodes, values = problem.nodal_values(field)
    away = np.linalg.norm(nodes - place, axis=1)
    assert away.min() < 1e-8
    return float(values[away.argmin()])


def forces(problem: Problem) -> dict[str, Array]:
    """Both components of the force at each boundary (N/m)."""
    return {name: np.array([it["force1"], it["force2"]]) for name, it in problem.boundary_forces().items()}


def compressed(right: dict[str, Any], travel: float = 0.2 * WIDTH) -> Problem:
    """Shortened by a fifth between smooth plates; the right side moves under a load."""
    sides = {"bottom": {"u2": 0.0}, "top": {"u2": -travel}, "left": {"u1": 0.0}, "right": right}
    return run({"boundaries": sides})
