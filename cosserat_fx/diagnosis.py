"""Why there is no equilibrium: where the forces are out of balance, and what the sand has come to there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cosserat_fx.hypoplasticity import Status
from cosserat_fx.layout import Layout
from cosserat_fx.problem import Failure, Problem
from cosserat_fx.typing import Array

_NEAR = 0.02
"""Part of the way from e_d to e_i within which a void ratio is told to be next to one of them."""
_AT_E_D = 1e-6
"""The same for a void ratio that has come to e_d, where f_d has an infinite slope."""
_TELLING = {Status.DENSER_THAN_E_D, Status.TENSION, Status.RADICAND}
"""Failures of the law that need no word on the state."""
_DIRECTIONS = 90


def imbalance(problem: Problem) -> str:
    """Tell where the forces are out of balance most, and the state of the sand next to it.

    Args:
        problem: holds out-of-balance forces in its vector, and the tangent of the state they belong to. Collective.

    Returns:
        A clause such as "the forces are out of balance most at 0.002 m, where the void ratio 1.3 exceeds e_i = 1.2".
        Where the sand has come to e_d anywhere, that is told instead: no step is so small that its answer would be
        smooth there, and the forces may be out of balance elsewhere.
    """
    if densest := _at_e_d(problem):
        return densest
    forces = np.abs(problem.vector.array_r)
    largest, place = -1.0, np.zeros(problem.geometry.mesh.geometry.dim)
    for part in problem.fields.values():
        own = forces[part.dofs[: part.owned]]
        if len(own) and own.max() > largest:
            largest, place = float(own.max()), part.coordinates[int(own.argmax()), : len(place)]
    place = max(problem.comm.allgather((largest, place.tolist())))[1]
    where = ", ".join(f"{x:.6g}" for x in place)
    return f"the forces are out of balance most at {where} m, where {_state_at(problem, place)}"


def failure_with_state(problem: Problem, failure: Failure) -> str:
    """Tell why and where the law failed, and the committed state of the sand there. Collective.

    Args:
        problem: to which it happened.
        failure: what happened.
    """
    if failure.status in _TELLING:
        return str(failure)
    return f"{failure}, where {_state_at(problem, failure.where)}"


def _at_e_d(problem: Problem) -> str:
    """Where the committed void ratio has come to e_d, if it has anywhere; the point that is nearest to it."""
    state = problem.state
    normal = [k for k, (i, j) in enumerate(problem.layout.stress) if i == j]
    pressure = np.maximum(-state.forces_n[state.points][:, normal].sum(axis=1) / 3, 0.0)
    e_i, _, e_d = problem.material.characteristic_void_ratios(pressure)
    parts = (state.e_n[state.points] - e_d) / (e_i - e_d)
    nearest = int(parts.argmin()) if len(parts) else -1
    told = (np.inf, "")
    if nearest >= 0 and parts[nearest] < _AT_E_D:
        where = ", ".join(f"{x:.6g}" for x in state.coordinates[nearest])
        reason = (
            f"the void ratio has come to e_d = {e_d[nearest]:.4g}, the densest state the law describes, at {where} m"
        )
        told = (float(parts[nearest]), reason)
    text: str = min(problem.comm.allgather(told))[1]
    return text


def _state_at(problem: Problem, place: Sequence[float]) -> str:
    """What is special about the committed state next to a place (m)."""
    distances = np.linalg.norm(problem.state.coordinates - np.asarray(place), axis=1)
    nearest = int(distances.argmin()) if len(distances) else -1
    told = (float(distances[nearest]), _state(problem, nearest)) if nearest >= 0 else (np.inf, "")
    text: str = min(problem.comm.allgather(told))[1]
    return text


def _state(problem: Problem, point: int) -> str:
    """What is special about the committed state of one of this rank's own points.

    Args:
        problem: its tangent is that of the trial state.
        point: number among the own points.
    """
    state, layout = problem.state, problem.layout
    row = state.points[point]
    stress = state.forces_n[row][: len(layout.stress)]
    pressure = -sum(stress[k] for k, (i, j) in enumerate(layout.stress) if i == j) / 3
    e_i, _, e_d = problem.material.characteristic_void_ratios(float(pressure))
    void_ratio = float(state.e_n[row])
    if void_ratio > e_i:
        return f"the void ratio {void_ratio:.4g} exceeds e_i = {e_i:.4g}, the loosest state the law describes"
    if e_i - void_ratio < _NEAR * (e_i - e_d):
        return f"the void ratio {void_ratio:.4g} is next to e_i = {e_i:.4g}, the loosest state the law describes"
    if void_ratio - e_d < _NEAR * (e_i - e_d):
        return f"the void ratio {void_ratio:.4g} is next to e_d = {e_d:.4g}, the densest state the law describes"
    tangent = state.tangent.x.array.reshape(-1, len(layout.strain_slots), layout.n_inputs)[row]
    if layout.polar and not is_elliptic(tangent, layout):
        return (
            "the law has lost its ellipticity: the strain may jump across a plane, which no grain diameter widens to "
            "a band"
        )
    return f"the mean pressure is {pressure:.4g} Pa and the void ratio {void_ratio:.4g}"


def is_elliptic(tangent: Array, layout: Layout) -> bool:
    """Whether the law rules out that the displacement gradient jumps across a plane while rotation and forces do not.

    A jump g x n across a plane with the normal n leaves the stress vector there as it is if Q g = 0 with

        Q_ij = n_k C_(ik)(jl) n_l,    C the derivatives of stresses with respect to strains;

    neither curvature nor couple stress has a part in it. The law is taken as elliptic where det Q > 0 for every normal.

    Args:
        tangent: (driven, inputs) derivatives at one point.
        layout: of a Cosserat continuum.
    """
    number = {component: k for k, component in enumerate(layout.strain)}
    size = 1 + max(i for i, _ in layout.strain)
    normals = _normals(layout)
    full = np.zeros((size, size, size, size))
    for (i, k), row in number.items():
        for (j, m), column in number.items():
            full[i, k, j, m] = tangent[row, column]
    acoustic = np.einsum("pk,ikjl,pl->pij", normals, full, normals)
    scale = np.abs(tangent[: len(number), : len(number)]).max()
    return bool(scale > 0 and np.all(np.linalg.det(acoustic / scale) > 0))


def _normals(layout: Layout) -> Array:
    """Normals of the planes across which something may jump: (p, components)."""
    if (0, 0) not in layout.strain:  # a layer has only planes along itself
        return np.array([[0.0, 1.0]])
    angles = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)
