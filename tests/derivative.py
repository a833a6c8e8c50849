"""Whether the Jacobian of a problem is the derivative of its residual."""

import numpy as np

from cosserat_fx.problem import Problem
from cosserat_fx.typing import Array


def order_of_remainder(problem: Problem, length: float, strain: float = 0.002) -> float:
    """The order in which the residual departs from its linearisation: 2 where the Jacobian is its derivative.

    Off equilibrium, along random changes that respect the conditions, the number of local substeps held.

    Args:
        problem: its unknown is a prediction.
        length: of a cell, by which displacements differ (m).
        strain: about that of the changes.
    """
    random = np.random.default_rng(20)
    x, predicted = problem.unknown.x.array, problem.unknown.x.array.copy()
    lengths = np.full(len(x), length)
    if "w" in problem.fields:
        lengths[problem.fields["w"].dofs] = 1.0
    residual, slope, direction = (problem.vector.duplicate() for _ in range(3))

    def nearby() -> Array:
        """Random unknowns that fulfil the conditions."""
        x[:] = predicted + strain * lengths * random.uniform(-1, 1, len(x))
        problem.impose()
        return np.array(x)

    def residual_at(unknowns: Array) -> Array:
        x[:] = unknowns
        assert problem.update(adapt=False) is None
        problem.assemble_residual(residual)
        return np.array(residual.array_r)

    start = nearby()
    failure = problem.update(adapt=True)
    assert failure is None, failure
    assert problem.state.substeps.max() > 1
    at = residual_at(start)
    problem.assemble_jacobian()
    direction.array_w[:] = nearby() - start
    problem.matrix.mult(direction, slope)
    parts = [0.1 / 2**k for k in range(7)]
    ends = [start + part * direction.array_r for part in parts]
    remainders = [
        float(np.linalg.norm(residual_at(end) - at - part * slope.array_r))
        for part, end in zip(parts, ends, strict=True)
    ]
    return float(np.polyfit(np.log(parts), np.log(remainders), 1)[0])
