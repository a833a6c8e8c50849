"""Was it fair to leave an effect out? A run is watched for what it would have needed, and says so with a number.

So is what was put in for the numerics' sake alone, the resistance to hourglass modes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from cosserat_fx._compat import dolfinx, evaluate
from cosserat_fx.forms import kinematics
from cosserat_fx.output.layer_observation import Row, largest
from cosserat_fx.typing import Array
from cosserat_fx.weakform import split

if TYPE_CHECKING:
    from cosserat_fx.bodies import Body

FAIR_SMALL_STRAIN = 0.3
"""Largest shear strain up to which a small-strain run is fair."""
FAIR_ROTATION = FAIR_SMALL_STRAIN / 2
"""Largest rotation of the material (rad) without objective rates: that of simple shear at the strain above."""
FAIR_DENSITY_FACTOR = 0.02
"""Largest relative change of f_d by a void ratio that was frozen: limit states are as strong as f_d says."""
FAIR_HOURGLASS_ENERGY = 0.05
"""Largest energy of the resistance to hourglass modes over the internal work; in the demos it is below 0.1 %."""
BAND_IN_CELLS = 4.0
"""A band of a classical continuum that is not wider than this has its thickness from the mesh."""


class Audit:
    """Watches a run for the effects that it leaves out; the fields of a run with all of them are not looked at."""

    def __init__(self, body: Body) -> None:
        """Prepare to look at the deformation, where there is something to look for. Collective.

        Args:
            body: what is run.
        """
        self._problem = problem = body.problem
        chosen = self._chosen = problem.numerics
        self._shear_strain = self._rotation = self._density = self._hourglass = 0.0
        self._gradient: dolfinx.fem.Expression | None = None
        if chosen.spin == "none" or not (chosen.void_ratio and chosen.polar):
            u, _ = split(problem.committed, polar=chosen.polar)
            gradient = kinematics.displacement_gradient(u, problem.geometry.dimension)
            components = kinematics.pack((gradient, ((0, 0), (0, 1), (1, 0), (1, 1))))
            self._gradient = dolfinx.fem.Expression(components, problem.state.rule_points)
            self._values = np.zeros((len(problem.state.points), 4))

    def observe(self, row: Row) -> None:
        """Look at the state just committed. Collective.

        Args:
            row: of the history.
        """
        self._shear_strain = max(self._shear_strain, row["max_shear_strain"])
        if self._chosen.hourglass and row["internal_work_J_per_m"] > 0:
            self._hourglass = row["hourglass_energy_J_per_m"] / row["internal_work_J_per_m"]
        if self._chosen.spin == "none":
            (h11, h12), (h21, h22) = self._displacement_gradients()
            turned = np.abs(np.arctan2(h12 - h21, 2 + h11 + h22))
            self._rotation = max(self._rotation, largest(self._problem, turned))
        if not self._chosen.void_ratio:
            self._density = max(self._density, largest(self._problem, self._density_changes()))

    def memento(self) -> dict[str, float]:
        """What a checkpoint has to hold."""
        return {
            "shear_strain": self._shear_strain,
            "rotation": self._rotation,
            "density": self._density,
            "hourglass": self._hourglass,
        }

    def restore(self, memento: Mapping[str, float]) -> None:
        """Go on from what :meth:`memento` gave."""
        self._shear_strain, self._rotation = memento["shear_strain"], memento["rotation"]
        self._density, self._hourglass = memento["density"], memento["hourglass"]

    def warnings(self, metrics: Mapping[str, Any]) -> list[str]:
        """What the solution turned out to need, or nothing. Collective.

        Args:
            metrics: what the kind of body adds to ``run.json``, with its ``band`` where there is one.
        """
        found = []
        if not self._chosen.finite and self._shear_strain > FAIR_SMALL_STRAIN:
            found.append(
                f"finite strain was off, but the shear strain reached {self._shear_strain:.3g}; small strain is fair "
                f"up to {FAIR_SMALL_STRAIN:g}: set effects.finite_strain = true"
            )
        elif self._rotation > FAIR_ROTATION:
            omitted, cure = ("spin", 'effects.spin = "macro"')
            if not self._chosen.finite:
                omitted, cure = ("finite strain", "effects.finite_strain = true")
            found.append(
                f"{omitted} was off, but the material turned by up to {self._rotation:.3g} rad; that is fair up to "
                f"{FAIR_ROTATION:g} rad: set {cure}"
            )
        if self._density > FAIR_DENSITY_FACTOR:
            found.append(
                f"the void ratio was frozen, but the volume changed so much that it would have changed the density "
                f"factor f_d, and strength with it, by up to {100 * self._density:.3g} %; freezing it is fair up to "
                f"{100 * FAIR_DENSITY_FACTOR:g} %: set effects.void_ratio = true"
            )
        if self._hourglass > FAIR_HOURGLASS_ENERGY:
            found.append(
                f"the resistance to hourglass modes holds {100 * self._hourglass:.3g} % of the internal work; up to "
                f'{100 * FAIR_HOURGLASS_ENERGY:g} % is fair: refine the mesh, or try solver.element = "Q2Q1"'
            )
        return [*found, *self._mesh_dependence(metrics)]

    def _mesh_dependence(self, metrics: Mapping[str, Any]) -> list[str]:
        """A classical continuum has no length: where its strain localises, the cells make the band's thickness."""
        if self._chosen.polar or "band" not in metrics:
            return []
        thickness, extent = metrics["band"]["thickness_m"], self._problem.geometry.smallest_extent
        cells = thickness / self._size_of_most_sheared_cell()
        if cells > BAND_IN_CELLS or thickness > extent / 2:
            return []
        return [
            f"polar effects were off, but the strain localised in a band of {1e3 * thickness:.3g} mm or {cells:.2g} "
            "cell(s): the thickness and all that follows from it depend on the mesh: set effects.polar = true"
        ]

    def _displacement_gradients(self) -> Array:
        """(2, 2, m) du_i/dx_j at this rank's quadrature points."""
        assert self._gradient is not None
        evaluate(self._gradient, self._problem.geometry.mesh, self._problem.state.cells, self._values)
        return self._values.T.reshape(2, 2, -1)

    def _density_changes(self) -> Array:
        """(m,) relative change of f_d = ((e - e_d)/(e_c - e_d))^alpha if e had followed the volume."""
        problem = self._problem
        (h11, h12), (h21, h22) = self._displacement_gradients()
        volume = (1 + h11) * (1 + h22) - h12 * h21 if self._chosen.finite else np.exp(h11 + h22)
        e = problem.state.e_n[problem.state.points]
        normal = [problem.layout.stress_index(i, i) for i in range(3)]
        pressure = -problem.state.forces_n[problem.state.points][:, normal].mean(axis=1)
        _, _, e_d = problem.material.characteristic_void_ratios(pressure)
        looser = np.maximum((1 + e) * volume - 1 - e_d, 0.0) / (e - e_d)
        changes: Array = np.abs(looser**problem.material.alpha - 1)
        return changes

    def _size_of_most_sheared_cell(self) -> float:
        """Characteristic size of the cell with the largest shear strain (m)."""
        (h11, h12), (h21, h22) = self._displacement_gradients()
        sizes = self._problem.geometry.cell_sizes()
        shear = np.hypot(h11 - h22, h12 + h21).reshape(len(sizes), -1).max(axis=1, initial=0.0)
        own = (shear.max(initial=-1.0), sizes[shear.argmax()] if len(sizes) else 0.0)
        return float(max(self._problem.comm.allgather(own))[1])
