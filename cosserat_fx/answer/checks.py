"""Checks of a committed state: equilibrium, forces and moments on the whole body, mass, admissible range."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cosserat_fx._compat import MPI
from cosserat_fx.answer.accounts import EPSILON
from cosserat_fx.problem import Problem
from cosserat_fx.typing import Array

GRAVER = ("points_in_tension", "points_denser_than_e_d")
"""Points that the law says nothing about, among those outside its range; beyond e_i it goes on."""


@dataclass(frozen=True)
class Check:
    """What was found, and up to which value it is as it should be.

    Attributes:
        value: found, dimensionless.
        limit: that it may reach.
        where: the worst place, in words; empty where there is none.
        further: other numbers that belong to it, by name with unit.
    """

    value: float
    limit: float
    where: str = ""
    further: Mapping[str, float | int] = field(default_factory=dict)

    @property
    def holds(self) -> bool:
        """Whether the value is within its limit; one that is no number is not."""
        return bool(self.value <= self.limit)


class Balance(NamedTuple):
    """Nodal forces of a state: at this rank's own unknowns, couples over d50 (Pa in a layer, N/m in a plane).

    Attributes:
        internal: with which stresses and stabilisation resist.
        acting: loads, and reactions where values are given.
        scale: norm of the internal forces over all ranks, which the solver measures by.
        tolerance: norm of the out-of-balance forces that the solver accepted, over the scale.
    """

    internal: Array
    acting: Array
    scale: float
    tolerance: float


def balance(problem: Problem, accepted: float) -> Balance:
    """The nodal forces of the committed state. Collective.

    Args:
        problem: with the loads applied that belong to its committed state.
        accepted: norm of the out-of-balance forces up to which the solver took the last step for done.
    """
    problem.roll_back()
    internal = problem.internal_forces()
    scale = float(np.sqrt(problem.comm.allreduce(internal @ internal)))
    return Balance(internal, problem.acting(internal), scale, accepted / scale)


def nodal_equilibrium(problem: Problem, forces: Balance) -> Check:
    """Norm of the out-of-balance nodal forces over that of the internal ones.

    The limit is the solver's own: it stopped when the norm was as small. Place: the node with the largest force.
    """
    residue = np.abs(forces.internal - forces.acting)
    norm = float(np.sqrt(problem.comm.allreduce(residue @ residue)))
    largest, where = -1.0, (0.0,)
    for part in problem.fields.values():
        own = residue[part.dofs[: part.owned]]
        if len(own) and own.max() > largest:
            largest, where = float(own.max()), tuple(part.coordinates[own.argmax()].tolist())
    _, where = max(problem.comm.allgather((largest, where)))
    return Check(norm / forces.scale, forces.tolerance + _rounding(problem), _place(where))


def constancy(problem: Problem, forces: Balance) -> Check:
    r"""Equilibrium of a layer: across every cell the traction is minus the sum of what acts on the nodes below it.

    A plane x2 = const of the undeformed layer stays one and does not stretch, so that its nominal traction is the
    current one, J sigma F^-T e2 = (s12, s22). In equilibrium s12 is constant and s22 grows with height by the weight
    per initial volume. Weakly that holds for the mean of each cell, and the sum of the forces at the nodes below says
    the same with all loads in it, whatever they are.

    Value: the largest difference of either component, over the norm of the internal nodal forces. It is the sum of the
    out-of-balance forces at up to n nodes, and so at most sqrt(n) times their norm (Cauchy-Schwarz).
    """
    state, layout = problem.state, problem.layout
    shape = len(state.cells), len(state.rule_points)
    stresses = state.forces_n[state.points].reshape(*shape, len(layout.forces)).mean(axis=1)
    heights = state.coordinates.reshape(shape).mean(axis=1)
    differences, places, nodes = [], [], 1
    for name, component in (("u1", (0, 1)), ("u2", (1, 1))):
        part = problem.fields[name]  # type: ignore[index]
        own = (part.coordinates[: part.owned, 0], forces.acting[part.dofs[: part.owned]])
        below, acting = (np.concatenate(it) for it in zip(*problem.comm.allgather(own), strict=True))
        order = np.argsort(below)
        sums = np.concatenate([[0.0], np.cumsum(acting[order])])
        traction = -sums[np.searchsorted(below[order], heights)]
        difference = np.abs(stresses[:, layout.stress_index(*component)] - traction)
        differences.append(difference)
        places += [f"s{component[0] + 1}2 at {_place((y,))}" for y in heights.tolist()]
        nodes = len(below)
    own_differences = np.concatenate(differences)
    worst = int(own_differences.argmax()) if len(own_differences) else -1
    candidate = (float(own_differences[worst]), places[worst]) if worst >= 0 else (-1.0, "")
    value, where = max(problem.comm.allgather(candidate))
    return Check(value / forces.scale, np.sqrt(nodes) * forces.tolerance + _rounding(problem), where)


def reactions(problem: Problem, forces: Balance) -> Check:
    """All loads and reactions together: forces along both axes and, in a plane, moments about the middle of the body.

    Couples, walls, springs, pressures, weight and points that are held are all among them. Moments are those of the
    deformed body where strains are finite. Rigid motions strain nothing, so the sums are those of the out-of-balance
    forces at n nodes, and at most sqrt(n) times their norm; a moment is divided by the root mean square of its levers.
    """
    fields, comm = problem.fields, problem.comm
    own = {name: forces.acting[part.dofs[: part.owned]] for name, part in fields.items()}
    nodes = comm.allreduce(len(own["u1"]))
    sums = comm.allreduce(np.array([own["u1"].sum(), own["u2"].sum()]))
    found = {"force along x1": float(sums[0]), "force along x2": float(sums[1])}
    if problem.geometry.dimension == "plane":
        part = fields["u1"]
        places = part.coordinates[: part.owned] - problem.geometry.extent().mean(axis=0)
        if problem.numerics.finite:
            moved = [problem.owned_values()[fields[name].dofs[: part.owned]] for name in ("u1", "u2")]
            places = places + np.stack(moved, axis=1)
        moment = places[:, 0] @ own["u2"] - places[:, 1] @ own["u1"]
        lever = float((places**2).sum())
        if "w" in own:
            d50 = problem.material.d50
            moment += d50 * own["w"].sum()
            lever += d50**2 * len(own["w"])
        moment, lever = comm.allreduce(np.array([moment, lever])).tolist()
        found["moment"] = moment / np.sqrt(lever / nodes)
    worst = max(found, key=lambda name: abs(found[name]))
    limit = np.sqrt(nodes) * forces.tolerance + _rounding(problem)
    return Check(abs(found[worst]) / forces.scale, limit, f"the {worst}")


def mass(problem: Problem, initial: Array, gradients: Array, rule: float, steps: int) -> Check:
    """Volume as the void ratio has it against volume as the displacements have it.

    Grains do not change their volume, so (1 + e)/(1 + e0) is det F, or exp(tr grad u) of small strains. Value: the
    largest difference of their logarithms at a point. The law integrates the trace of the increments, (J - J_n)/J_m, in
    place of log(J/J_n), which differs from it by tr^3/12 and less in a layer; the limit is what that came to, summed
    over the steps, with the rounding of displacement differences over the size of a cell in each.

    Args:
        problem: with an evolving void ratio.
        initial: (m,) void ratio at the start at this rank's own points.
        gradients: (m, 4) displacement gradients 11, 12, 21, 22 there.
        rule: bound of the error of the rule, see :class:`~cosserat_fx.answer.accounts.Sums`.
        steps: made so far.
    """
    state = problem.state
    h11, h12, h21, h22 = gradients.T
    with np.errstate(invalid="ignore", divide="ignore"):  # of a point turned inside out, which _worst finds
        volume = np.log((1 + h11) * (1 + h22) - h12 * h21) if problem.numerics.finite else h11 + h22
    difference = np.abs(np.log1p(state.e_n[state.points]) - np.log1p(initial) - volume)
    value, where = _worst(problem, difference)
    smallest = problem.comm.allreduce(problem.geometry.cell_sizes().min(initial=np.inf), op=MPI.MIN)
    moved = problem.comm.allreduce(float(np.abs(problem.owned_values()).max(initial=0.0)), op=MPI.MAX)
    size = 1.0 + problem.comm.allreduce(float(np.abs(gradients).max(initial=0.0)), op=MPI.MAX)
    return Check(value, rule + 8 * EPSILON * (steps + 1) * (size + moved / smallest), where)


def admissible(problem: Problem) -> Check:
    """Points outside the law's range: void ratio between e_d and e_i, principal stresses compressive.

    Principal stresses are those of the symmetric part. Value: the share of such points, of which none is allowed.
    Place: of the first of them.
    """
    state, layout = problem.state, problem.layout
    forces, e = state.forces_n[state.points], state.e_n[state.points]
    s11, s22, s33 = (forces[:, layout.stress_index(i, i)] for i in range(3))
    shear = (forces[:, layout.stress_index(0, 1)] + forces[:, layout.stress_index(1, 0)]) / 2
    largest = np.maximum((s11 + s22) / 2 + np.hypot((s11 - s22) / 2, shear), s33)
    trace = s11 + s22 + s33
    pressure = np.where(trace < 0, -trace / 3, 0.0)
    e_i, _, e_d = problem.material.characteristic_void_ratios(pressure)
    kinds = [~(largest < 0), ~(e > e_d), ~(e <= e_i)]
    outside = np.logical_or.reduce(kinds)
    counts = problem.comm.allreduce(np.array([*(kind.sum() for kind in kinds), outside.sum(), len(e)])).tolist()
    first = [tuple(place) for place in state.coordinates[outside].tolist()]
    lowest = [place for place in problem.comm.allgather(min(first, default=None)) if place is not None]
    further = dict(zip((*GRAVER, "points_looser_than_e_i"), counts, strict=False))
    return Check(counts[-2] / counts[-1], 0.0, _place(min(lowest)) if lowest else "", further)


def _rounding(problem: Problem) -> float:
    """Bound of the rounding of a sum over all unknowns, relative to their norm."""
    return EPSILON * problem.sizes["unknowns"]


def _worst(problem: Problem, values: npt.NDArray[np.floating]) -> tuple[float, str]:
    """The largest value at a quadrature point of any rank, and where; what is no number is taken for the largest."""
    values = np.where(np.isnan(values), np.inf, values)
    own = (-1.0, (0.0,))
    if len(values):
        worst = int(values.argmax())
        own = (float(values[worst]), tuple(problem.state.coordinates[worst].tolist()))
    value, where = max(problem.comm.allgather(own))
    return value, _place(where)


def _place(where: tuple[float, ...]) -> str:
    """Reference coordinates in words; a layer's only one is y."""
    names = ("y",) if len(where) == 1 else ("x", "y", "z")
    return ", ".join(f"{name} = {value:.6g} m" for name, value in zip(names, where, strict=False))
