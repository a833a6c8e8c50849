"""The infinite layer between two rough walls, made from a scene: its path, its conditions, its solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cosserat_fx import geometry
from cosserat_fx._compat import MPI
from cosserat_fx.conditions import Condition, Prescribed, Traction
from cosserat_fx.effects import numerics
from cosserat_fx.forms.walls import rolling_rotation
from cosserat_fx.newton import NewtonSolver, PetscOption
from cosserat_fx.path import Path, Waypoint
from cosserat_fx.problem import Problem
from cosserat_fx.scene import Scene
from cosserat_fx.schema import Wall
from cosserat_fx.stepping import StepControl, Stepper

FIRST_STEP = 0.0025
"""Default first step over the height of the layer: the mean shear strain in which the stiff response shows."""


@dataclass(frozen=True)
class Layer:
    """A layer ready to be sheared.

    Attributes:
        scene: what it was made from.
        problem: its forms, state and conditions.
        stepper: walks it along the path.
        path: wall displacements and normal stress over the travel.
        stations: travel along the path at which profiles are asked for (m).
    """

    scene: Scene
    problem: Problem
    stepper: Stepper
    path: Path
    stations: tuple[float, ...]


def build(scene: Scene, comm: MPI.Intracomm, options: dict[str, PetscOption] | None = None) -> Layer:
    """Set up the layer of a scene.

    Args:
        scene: the validated scene.
        comm: the ranks that share the mesh.
        options: PETSc options (without prefix) that go before the scene's own.
    """
    path = layer_path(scene)
    problem = Problem(
        geometry.layer(scene.geometry.height, scene.geometry.cells, comm),
        scene.material,
        conditions(scene, path),
        stress=scene.initial.stress,
        void_ratio=scene.initial.void_ratio,
        numerics=numerics(scene),
    )
    solver = NewtonSolver(
        problem,
        tolerance=scene.solver.newton_tolerance,
        max_iterations=scene.solver.max_iterations,
        options={**scene.solver.petsc, **(options or {})},
    )
    legs_before = len(path.corners) - 1 - len(scene.legs)
    stations = tuple(path.at(legs_before + station.leg, station.fraction) for station in scene.profile_stations)
    stepper = Stepper(problem, solver, path.corners, stations, step_control(scene))
    return Layer(scene, problem, stepper, path, stations)


def layer_path(scene: Scene) -> Path:
    """The path of the walls; first, where it differs from the initial stress, the normal stress is brought up."""
    waypoints = []
    normal = scene.walls.top.normal_stress
    loading = normal is not None and normal != scene.initial.stress
    if loading:
        # The walls rest meanwhile; the mean grain diameter stands in for their travel.
        waypoints.append(Waypoint(0.0, 0.0, scene.material.d50))
    top = bottom = 0.0
    for leg in scene.legs:
        moves = leg.top - top, leg.bottom - bottom
        waypoints.append(Waypoint(leg.top, leg.bottom, max(abs(moves[0]), abs(moves[1]), abs(moves[0] - moves[1]))))
        top, bottom = leg
    return Path(waypoints, initial_load=0.0 if loading else 1.0)


def conditions(scene: Scene, path: Path) -> list[Condition]:
    """Boundary conditions of both walls."""
    walls, d50, polar = scene.walls, scene.material.d50, scene.effects.polar
    top, initial = walls.top, scene.initial.stress
    listed = [
        *_wall_conditions("bottom", walls.bottom, path.bottom, -1, d50, polar),
        *_wall_conditions("top", top, path.top, +1, d50, polar),
        Prescribed("bottom", "u2", lambda travel: 0.0),
    ]
    if top.normal_stress is None:
        return [*listed, Prescribed("top", "u2", lambda travel: 0.0)]
    change = top.normal_stress - initial
    return [*listed, Traction("top", lambda travel: (0.0, initial + path.load(travel) * change))]


def _wall_conditions(
    side: str, wall: Wall, displacement: Callable[[float], float], outward: int, d50: float, polar: bool
) -> list[Prescribed]:
    """Displacement along the wall and rotation of the grains that touch it."""
    transmitted, turn = wall.displacement_factor, wall.rolling_rotation_factor(d50)
    given = [Prescribed(side, "u1", lambda travel: transmitted * displacement(travel))]
    if polar:
        given.append(Prescribed(side, "w", lambda travel: rolling_rotation(displacement(travel), turn, outward)))
    return given


def step_control(scene: Scene) -> StepControl:
    """Step sizes as the scene asks for them, or from the layer's height."""
    asked = scene.stepping
    first = asked.first_step or min(FIRST_STEP * scene.geometry.height, asked.max_step or float("inf"))
    return StepControl(
        first=first,
        largest=asked.max_step or float("inf"),
        smallest=asked.min_step or 0.0,
        max_steps=asked.max_steps,
    )
