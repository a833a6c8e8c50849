"""Which tensor components a problem carries, in which order, and how they contract.

One table per dimension and continuum serves the weak forms, the quadrature fields and the
constitutive kernel alike, so that a component is ordered in one place only.

Indices count from zero: ``(0, 1)`` is the component 12. The second index is the derivative or
the surface normal. A classical (non-polar) layout stores one component for each symmetric pair and
gives it the weight two in every contraction.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

Component = tuple[int, int]
Dimension = Literal["layer", "plane", "solid"]

_ALL: tuple[Component, ...] = tuple((i, j) for i in range(3) for j in range(3))
_SYMMETRIC: tuple[Component, ...] = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_COMPONENTS: dict[Dimension, dict[str, tuple[Component, ...]]] = {
    "layer": {
        "strain": ((1, 1), (0, 1), (1, 0)),
        "curvature": ((2, 1),),
        "stress": ((0, 0), (1, 1), (2, 2), (0, 1), (1, 0)),
        "couple": ((2, 0), (2, 1)),
        "spin": ((0, 1),),
    },
    "plane": {
        "strain": ((0, 0), (1, 1), (0, 1), (1, 0)),
        "curvature": ((2, 0), (2, 1)),
        "stress": ((0, 0), (1, 1), (2, 2), (0, 1), (1, 0)),
        "couple": ((2, 0), (2, 1)),
        "spin": ((0, 1),),
    },
    "solid": {
        "strain": _ALL,
        "curvature": _ALL,
        "stress": _ALL,
        "couple": _ALL,
        "spin": ((0, 1), (0, 2), (1, 2)),
    },
}


@dataclass(frozen=True)
class Layout:
    """Ordered tensor components of one kind of problem.

    Attributes:
        dimension: "layer" (fields of x2 alone), "plane" (plane strain) or "solid".
        polar: whether rotations, curvatures and couple stresses exist.
        strain: components of the strain increment that the kinematics can make non-zero.
        curvature: components of the curvature increment, likewise.
        stress: components of the stress that evolve, a superset of ``strain``.
        couple: components of the couple stress that evolve, a superset of ``curvature``.
        spin: components (i < j) of the skew spin increment.
    """

    dimension: Dimension
    polar: bool
    strain: tuple[Component, ...]
    curvature: tuple[Component, ...]
    stress: tuple[Component, ...]
    couple: tuple[Component, ...]
    spin: tuple[Component, ...]

    @cached_property
    def forces(self) -> tuple[Component, ...]:
        """Stress components followed by couple-stress components: the constitutive state."""
        return self.stress + self.couple

    @cached_property
    def weights(self) -> tuple[float, ...]:
        """Multiplicity of each force component in a contraction (2 for a stored symmetric pair)."""
        stress = tuple(2.0 if not self.polar and i != j else 1.0 for i, j in self.stress)
        return stress + (1.0,) * len(self.couple)

    @cached_property
    def strain_slots(self) -> tuple[int, ...]:
        """Position in ``forces`` of the force that is conjugate to each strain and curvature."""
        offset = len(self.stress)
        return tuple(self.stress.index(c) for c in self.strain) + tuple(
            offset + self.couple.index(c) for c in self.curvature
        )

    @property
    def n_inputs(self) -> int:
        """Number of strain, curvature and spin increments that drive the constitutive update."""
        return len(self.strain) + len(self.curvature) + len(self.spin)

    def stress_index(self, i: int, j: int) -> int:
        """Position of the stress component ij (either order when the stress is symmetric).

        Raises:
            KeyError: this layout has no such component.
        """
        for candidate in ((i, j),) if self.polar else ((i, j), (j, i)):
            if candidate in self.stress:
                return self.stress.index(candidate)
        raise KeyError((i, j))


def layout(dimension: Dimension, *, polar: bool = True, spin: bool = True) -> Layout:
    """The components of a layer, plane or solid problem, polar (Cosserat) or classical, with spin increments or not."""
    components = dict(_COMPONENTS[dimension])
    if not spin:
        components["spin"] = ()
    if polar:
        return Layout(dimension, True, **components)
    upper = {kind: tuple(c for c in _SYMMETRIC if c in components[kind]) for kind in ("strain", "stress")}
    return Layout(dimension, False, **upper, curvature=(), couple=(), spin=components["spin"])
