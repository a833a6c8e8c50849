"""What every accepted step adds to the accounts of a run: work, dissipation, and the errors that go with the steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import basix
import numpy as np

from cosserat_fx._compat import MPI, dolfinx, evaluate
from cosserat_fx.answer.power import build_power, compile_power
from cosserat_fx.forms import kinematics
from cosserat_fx.parallel import in_turn
from cosserat_fx.problem import Problem
from cosserat_fx.typing import Array
from cosserat_fx.weakform import split

EPSILON = float(np.finfo(float).eps)
"""Rounding of one number."""


@dataclass
class Sums:
    """Sums over the accepted steps, the same on every rank; energies in J/m2 in a layer, J/m in a plane.

    Attributes:
        external: work of loads and reactions, by the trapezoidal rule in the nodal forces.
        stresses: work of the stresses at the quadrature points, see :mod:`cosserat_fx.answer.power`.
        recoverable: part of it that is not dissipated, see there.
        turnover: the work of loads and reactions at every node in each step, added up without sign.
        unbalanced: bound of the work of the out-of-balance forces that the solver tolerates.
        rounding: bound of what rounding does to the sums.
        rule: bound of what the rule for the increments does to log(1 + e): of each step the largest error of a point.
    """

    external: float = 0.0
    stresses: float = 0.0
    recoverable: float = 0.0
    turnover: float = 0.0
    unbalanced: float = 0.0
    rounding: float = 0.0
    rule: float = 0.0


class Accounts:
    """Keeps the accounts of a problem, which calls :meth:`add` before each step is committed.

    Attributes:
        sums: so far.
        displacement: norm of the last step's change of the unknown, rotations times d50 (m); over all ranks.
    """

    def __init__(self, problem: Problem) -> None:
        """Compile what is evaluated at the points, and begin with the committed state. Collective.

        Args:
            problem: in equilibrium, as the initial state is.
        """
        self.sums = Sums()
        self.displacement = 0.0
        geometry, state, layout = problem.geometry, problem.state, problem.layout
        self._constants = problem.material.kernel_parameters()
        self._power = power = build_power(layout, finite=problem.numerics.finite)
        in_turn(problem.comm, lambda: compile_power(power, layout, self._constants))
        u, _ = split(problem.unknown, polar=layout.polar)
        gradient = kinematics.displacement_gradient(u, geometry.dimension)
        components = kinematics.pack((gradient, ((0, 0), (0, 1), (1, 0), (1, 1))))
        self._gradient = dolfinx.fem.Expression(components, state.rule_points)
        self._before, self._after = (np.zeros((len(state.points), 4)) for _ in range(2))
        self._weights = _weights(problem)
        self._lengths = np.ones(len(problem.owned_values()))
        if "w" in problem.fields:
            rotation = problem.fields["w"]
            self._lengths[rotation.dofs[: rotation.owned]] = problem.material.d50
        self._unknowns = problem.sizes["unknowns"]
        self._evaluate(problem, self._before)
        self._acting = problem.internal_forces()

    def add(self, problem: Problem, internal: Array) -> None:
        """Take a step into account that is about to be committed. Collective.

        Args:
            problem: with its trial fields and state.
            internal: this rank's own nodal forces of the trial stresses, couples over d50.
        """
        state, own = problem.state, len(internal)
        end = problem.unknown.x.array[:own] * self._lengths
        change = end - problem.committed.x.array[:own] * self._lengths
        acting = problem.acting(internal)
        mean = (acting + self._acting) / 2
        self._evaluate(problem, self._after)
        work, recoverable, rule = self._power(
            problem.increments,
            state.points,
            state.forces_n,
            state.e_n,
            state.forces.x.array.reshape(state.forces_n.shape),
            state.e,
            self._before,
            self._after,
            self._weights,
            self._constants,
        )
        turnover, sizes = np.abs(mean) @ np.abs(change), np.abs(mean) @ np.abs(end)
        added = np.array([mean @ change, work, recoverable, turnover, sizes, change @ change])
        worst = np.array([rule])
        problem.comm.Allreduce(MPI.IN_PLACE, added)
        problem.comm.Allreduce(MPI.IN_PLACE, worst, op=MPI.MAX)
        external, work, recoverable, turnover, sizes, moved = added.tolist()
        sums = self.sums
        sums.external += external
        sums.stresses += work
        sums.recoverable += recoverable
        sums.turnover += turnover
        sums.rounding += self._unknowns * EPSILON * (turnover + sizes)
        sums.rule += float(worst[0])
        self.displacement = float(np.sqrt(moved))
        self._acting = acting
        self._before, self._after = self._after, self._before

    @property
    def gradients(self) -> Array:
        """(m, 4) displacement gradients 11, 12, 21, 22 of the committed state at this rank's own points."""
        return self._before

    def memento(self) -> dict[str, float]:
        """What a checkpoint has to hold."""
        return asdict(self.sums)

    def restore(self, problem: Problem, memento: Mapping[str, float]) -> None:
        """Go on from a state that was put back. Collective.

        Args:
            problem: with committed fields and state, and the loads that belong to them applied.
            memento: what :meth:`memento` gave.
        """
        self.sums = Sums(**memento)
        self._evaluate(problem, self._before)
        self._acting = problem.acting(problem.internal_forces())

    def _evaluate(self, problem: Problem, values: Array) -> None:
        """Displacement gradients of the unknown at this rank's own points."""
        evaluate(self._gradient, problem.geometry.mesh, problem.state.cells, values)


def _weights(problem: Problem) -> Array:
    """(m,) initial volume that each of this rank's own quadrature points stands for (m in a layer, m2 in a plane)."""
    corners, cell = problem.geometry.cell_corners(), problem.geometry.mesh.basix_cell()
    points, weights = basix.make_quadrature(cell, problem.numerics.degree)
    slopes = basix.create_element(basix.ElementFamily.P, cell, 1).tabulate(1, points)[1:, :, :, 0]
    volumes = np.abs(np.linalg.det(np.einsum("cki,jqk->cqij", corners, slopes)))
    return np.asarray((volumes * weights).reshape(-1))
