"""Whether the conditions of a plane body keep it from moving as a rigid body, and how it could move if not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cosserat_fx.conditions import Condition, Load, Work
from cosserat_fx.problem import Problem

_MOTIONS = ("displacement along x1", "displacement along x2", "rotation")
_HELD = 1e-10


def rigid_motions(problem: Problem, conditions: Sequence[Condition]) -> list[str]:
    """Name the rigid motions that nothing resists.

    Prescribed values resist a motion of their nodes. So may springs: where a load or a resistance depends on the
    fields, its stiffness is asked.

    Args:
        problem: of a plane body.
        conditions: of the problem.

    Returns:
        Of "displacement along x1", "displacement along x2" and "rotation" those that take part in a free motion.
    """
    extent = problem.geometry.extent()
    size, middle = float(np.max(extent[1] - extent[0])), extent.mean(axis=0)
    motions = np.zeros((len(problem.unknown.x.array), len(_MOTIONS)))
    for name, field in problem.fields.items():
        x, y = ((field.coordinates - middle) / size).T
        at = {"u1": (1.0, 0.0, -y), "u2": (0.0, 1.0, x), "w": (0.0, 0.0, 1.0)}[name]
        for motion, values in enumerate(at):
            motions[field.dofs, motion] = values
    owned = problem.prescribed.dofs[problem.prescribed.owned]
    held = problem.comm.allreduce(motions[owned].T @ motions[owned])
    if any(isinstance(condition, Work | Load) for condition in conditions):
        springs = problem.resistance(1e-6 * motions)
        held = held + springs / max(np.abs(springs).max(), np.finfo(float).tiny)
    sizes, directions = np.linalg.eigh(held)
    free = np.abs(directions[:, sizes <= _HELD * max(1.0, sizes[-1])])
    return [name for name, part in zip(_MOTIONS, free.max(axis=1, initial=0.0), strict=True) if part > 1e-6]
