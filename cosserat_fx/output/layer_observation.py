"""What a body shows after a step; a layer: the row of its history, its profiles, its nodes. Every rank takes part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from cosserat_fx._compat import MPI, dolfinx, evaluate
from cosserat_fx.conditions import Field
from cosserat_fx.hypoplasticity import Status
from cosserat_fx.layer import Layer
from cosserat_fx.problem import Problem
from cosserat_fx.stepping import Step
from cosserat_fx.typing import Array
from cosserat_fx.weakform import split

type Row = dict[str, float | int]
type Columns = dict[str, Array]

STRESSES = {"s11_Pa": (0, 0), "s22_Pa": (1, 1), "s33_Pa": (2, 2), "s12_Pa": (0, 1), "s21_Pa": (1, 0)}
COUPLES = {"m31_N_per_m": (2, 0), "m32_N_per_m": (2, 1)}


@dataclass(frozen=True)
class Looseness:
    """Points whose void ratio exceeds e_i.

    Attributes:
        count: how many.
        first: reference coordinates of the first of them (m): the lowest one of a layer.
    """

    count: int
    first: tuple[float, ...]

    @property
    def place(self) -> str:
        """Its coordinates in words."""
        names = ("y",) if len(self.first) == 1 else ("x", "y", "z")
        return ", ".join(f"{name} = {x:.6g} m" for name, x in zip(names, self.first, strict=False))


def looseness(problem: Problem) -> Looseness | None:
    """Where the void ratio exceeds e_i, the law's physical range, if it does; the same on every rank."""
    state = problem.state
    loose = state.coordinates[state.status[state.points] == Status.LOOSER_THAN_E_I]
    places = [tuple(place) for part in problem.comm.allgather(loose.tolist()) for place in part]
    return Looseness(len(places), min(places)) if places else None


def largest(problem: Problem, values: npt.NDArray[Any]) -> float:
    """Largest value over all ranks; a rank may have none."""
    own = float(values.max()) if values.size else -np.inf
    return float(problem.comm.allreduce(own, op=MPI.MAX))


class LayerObserver:
    """Reads the committed state of a layer."""

    def __init__(self, layer: Layer) -> None:
        """Compile what is evaluated at the quadrature points."""
        self._layer = layer
        problem = self._problem = layer.problem
        u, w = split(problem.committed, polar=problem.layout.polar)
        parts = [u[0], u[1], u[0].dx(0), *([] if w is None else [w])]
        self._expression = dolfinx.fem.Expression(ufl.as_vector(parts), problem.state.rule_points)
        self._values = np.zeros((len(problem.state.points), len(parts)))

    def row(self, step: Step) -> Row:
        """The history's row of a step just committed."""
        problem, path = self._problem, self._layer.path
        reactions = problem.reactions()
        shear, normal = reactions["top", "u1"], -reactions["bottom", "u2"]
        e = problem.state.e_n[problem.state.points]
        strain = self._at_points()[:, 2]
        return {
            "step": step.number,
            "top_displacement_m": path.top(step.travel),
            "shear_stress_Pa": shear,
            "normal_stress_Pa": normal,
            "height_change_m": problem.boundary_mean("top", "u2"),
            "newton_iterations": step.iterations,
            "void_ratio_max": largest(problem, e),
            "void_ratio_min": -largest(problem, -e),
            "bottom_displacement_m": path.bottom(step.travel),
            "step_size_m": step.size,
            "cutbacks": step.cutbacks,
            "substeps_max": int(largest(problem, problem.state.substeps[problem.state.points])),
            "mobilised_friction": abs(shear / normal),
            "max_shear_strain": largest(problem, np.abs(strain)),
            "jumps": step.jumps,
        }

    def profile(self, step: int, travel: float) -> Columns | None:
        """State and fields at every quadrature point in ascending height, on rank 0; None on the others.

        Args:
            step: number of the step.
            travel: along the path (m).
        """
        state, layout = self._problem.state, self._problem.layout
        values = self._at_points()
        forces = state.forces_n[state.points]
        own = {
            "y_m": state.coordinates[:, 0],
            "u1_m": values[:, 0],
            "u2_m": values[:, 1],
            "omega_rad": values[:, 3] if layout.polar else np.zeros(len(values)),
            "void_ratio": state.e_n[state.points],
            "shear_strain": values[:, 2],
        }
        own |= {name: forces[:, layout.stress_index(*c)] for name, c in STRESSES.items()}
        for name, component in COUPLES.items():
            slot = len(layout.stress) + layout.couple.index(component) if layout.polar else None
            own[name] = np.zeros(len(values)) if slot is None else forces[:, slot]
        gathered = self._problem.comm.gather(own)
        if gathered is None:
            return None
        columns = {name: np.concatenate([part[name] for part in gathered]) for name in own}
        upwards = np.argsort(columns["y_m"], kind="stable")
        columns = {name: column[upwards] for name, column in columns.items()}
        top = np.full(len(upwards), self._layer.path.top(travel))
        return columns | {"top_displacement_m": top, "step": np.full(len(upwards), step)}

    def nodes(self) -> Columns | None:
        """Height and fields at every node in ascending height, on rank 0; None on the others."""
        fields: dict[str, Field] = {"u1_m": "u1", "u2_m": "u2"}
        if self._problem.layout.polar:
            fields["omega_rad"] = "w"
        own: Columns = {}
        for name, field in fields.items():
            coordinates, own[name] = self._problem.nodal_values(field)
            own["y_m"] = coordinates[:, 0]
        gathered = self._problem.comm.gather(own)
        if gathered is None:
            return None
        columns = {name: np.concatenate([part[name] for part in gathered]) for name in own}
        upwards = np.argsort(columns["y_m"], kind="stable")
        return {name: column[upwards] for name, column in columns.items()}

    def _at_points(self) -> Array:
        """u1, u2, du1/dx2 (and w) at this rank's quadrature points."""
        evaluate(self._expression, self._problem.geometry.mesh, self._problem.state.cells, self._values)
        return self._values
