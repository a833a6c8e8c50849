"""What a run is going to cost, before it runs: a look at the path and a short calibration of kernel and solver."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

from cosserat_fx._compat import PETSc
from cosserat_fx.bodies import Body, refused_by_petsc
from cosserat_fx.kernel_time import seconds_per_update
from cosserat_fx.memory import Footprint, available_memory, footprint, in_words, sizes_of
from cosserat_fx.timing import duration

UPDATES_PER_STEP = 8
ITERATIONS_PER_STEP = 6
STEPS_TO_PEAK = 18
BAND_IN_GRAINS = 10.0
"""Typical figures of the default step control, from the entries of run.json of the demos."""
_PHASES = ("strains", "Jacobian assembly", "linear solve")


@dataclass(frozen=True)
class Cost:
    """Expected cost of a run.

    Attributes:
        steps: accepted steps.
        ranks: MPI processes that share the work.
        update_seconds: in the constitutive update.
        solver_seconds: in assembly and linear solution.
        state_bytes: of the state at all quadrature points.
        nonzeros: of the Jacobian.
        factor_bytes: that the linear solver has taken for its factors; None where it does not tell.
        expected: memory of the whole run.
        available: memory that all ranks together may take (bytes).
    """

    steps: int
    ranks: int
    update_seconds: float
    solver_seconds: float
    state_bytes: int
    nonzeros: int
    factor_bytes: int | None
    expected: Footprint
    available: float

    @property
    def seconds(self) -> float:
        """Time of all steps, without the start and what is written (s)."""
        return self.update_seconds + self.solver_seconds

    def __str__(self) -> str:
        """A few lines for the user."""
        factors = "" if self.factor_bytes is None else f", {self.factor_bytes / 1e6:.3g} MB of factors"
        return (
            f"expected cost on {self.ranks} rank(s): about {self.steps} steps in {duration(self.seconds)}, "
            f"{duration(self.update_seconds)} of it constitutive update, {duration(self.solver_seconds)} assembly and "
            "solution\n"
            f"memory: {self.state_bytes / 1e6:.3g} MB of state, {self.nonzeros} non-zeros{factors}; "
            f"about {in_words(self.expected.total)} in all, of {in_words(self.available)}"
        )


def expected_cost(body: Body) -> Cost:
    """Estimate steps, time and memory. Collective; leaves the body as it was.

    Shear localises in a band of some ten grains, whose strain per step is bounded; the steps up to the peak come on
    top, once a leg. Assembly and solution are those of one step from the initial state.

    Raises:
        SceneError: PETSc cannot solve as the scene asks it to.
    """
    problem, control, path = body.problem, body.stepper.control, body.path
    band = min(BAND_IN_GRAINS * problem.material.d50, problem.geometry.smallest_extent)
    by_strain = path.length / min(control.strain * band, control.largest)
    steps = int(min(STEPS_TO_PEAK * (len(path.corners) - 1) + by_strain, control.max_steps))
    points, ranks = problem.sizes["quadrature_points"], problem.comm.size
    try:
        iteration = _seconds_per_iteration(body)
    except PETSc.Error as error:
        raise refused_by_petsc(error) from error
    return Cost(
        steps=steps,
        ranks=ranks,
        update_seconds=steps
        * UPDATES_PER_STEP
        * points
        / ranks
        * seconds_per_update(body, band / problem.geometry.smallest_extent),
        solver_seconds=steps * ITERATIONS_PER_STEP * iteration,
        state_bytes=points * problem.state.bytes_per_point,
        nonzeros=int(problem.matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]),
        factor_bytes=_factor_bytes(body),
        expected=footprint(
            body.scene,
            problem.numerics,
            sizes_of(problem.geometry),
            ranks=ranks,
            linear=body.stepper.solver.linear.choice,
        ),
        available=available_memory(problem.comm),
    )


def _seconds_per_iteration(body: Body) -> float:
    """Time of strains, assembly and linear solution of one iteration from the initial state (s)."""
    problem = body.problem
    for _ in range(2):  # the first time, memory is taken and the matrix analysed
        before = {phase: problem.stopwatch.seconds.get(phase, 0.0) for phase in _PHASES}
        problem.apply(body.path.corners[0])
        body.stepper.solver.predict()
        problem.roll_back()
    start = perf_counter()
    problem.assemble_residual(problem.vector)
    seconds = perf_counter() - start
    return seconds + sum(problem.stopwatch.seconds.get(phase, 0.0) - before[phase] for phase in _PHASES)


def _factor_bytes(body: Body) -> int | None:
    """Memory that MUMPS has allocated on all ranks for the factorisation just made (bytes)."""
    solver = body.stepper.solver
    if not solver.linear.is_factorised:
        return None
    factors = solver.snes.getKSP().getPC().getFactorMatrix()
    return int(1e6 * factors.getMumpsInfog(19))
