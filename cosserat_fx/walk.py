"""How a scene's body is walked along its path: the solver of its steps, and their sizes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from cosserat_fx.linear_solver import LinearSolver, PetscOption
from cosserat_fx.newton import NewtonSolver
from cosserat_fx.problem import Problem
from cosserat_fx.scene import Scene
from cosserat_fx.stepping import StepControl, Stepper

FIRST_STEP = 0.0025
"""Largest default first step over the body's smallest extent."""
STIFF_STRAINS = 4.0
"""Strain in which the law's stiff response shows, over the pressure divided by the stiffness f_s at e_c."""

Branch = Literal["stable", "primary"]


def stepper_of(
    scene: Scene,
    problem: Problem,
    corners: Sequence[float],
    stations: Sequence[float],
    control: StepControl,
    options: dict[str, PetscOption] | None = None,
    linear: LinearSolver | None = None,
) -> Stepper:
    """What walks a problem as its scene asks for.

    Args:
        scene: tolerances and PETSc options.
        problem: what is walked.
        corners: travel at the start and wherever the direction of loading changes, ascending (m).
        stations: further travels to be hit exactly (m).
        control: sizes of the steps.
        options: PETSc options (without prefix) that go before the scene's own.
        linear: the linear solver.
    """
    solver = NewtonSolver(
        problem,
        tolerance=scene.solver.newton_tolerance,
        max_iterations=scene.solver.max_iterations,
        options={**scene.solver.petsc, **(options or {})},
        linear=linear,
    )
    return Stepper(problem, solver, corners, stations, control)


def step_control(scene: Scene, size: float, branch: Branch) -> StepControl:
    """Step sizes as the scene asks for them, or from the body's smallest extent.

    Args:
        scene: the scene.
        size: the extent (m).
        branch: what to do where equilibrium branches, unless the scene says so.
    """
    asked, pressure = scene.stepping, -scene.initial.stress
    critical = scene.material.characteristic_void_ratios(pressure).e_c
    strain = STIFF_STRAINS * pressure / scene.material.stiffness_factor(pressure, critical)
    stiff = max(min(FIRST_STEP, strain) * size, asked.min_step or 0.0)
    return StepControl(
        first=asked.first_step or min(stiff, asked.max_step or float("inf")),
        stiff=stiff,
        largest=asked.max_step or float("inf"),
        smallest=asked.min_step or 0.0,
        branch=asked.branch or branch,
        tolerance=asked.tolerance,
        strain=asked.strain,
        max_steps=asked.max_steps,
        max_jumps=asked.max_jumps,
    )
