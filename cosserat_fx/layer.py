"""The infinite layer between two rough walls, made from a scene: its path, its conditions, its solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cosserat_fx import geometry
from cosserat_fx._compat import MPI
from cosserat_fx.conditions import Condition, Load, Prescribed, traction
from cosserat_fx.forms.walls import rolling_rotation
from cosserat_fx.forms.weight import weight_work
from cosserat_fx.initial.state import void_ratio_of
from cosserat_fx.linear_solver import PetscOption
from cosserat_fx.memory import refuse_too_large
from cosserat_fx.meshes.sizes import SizeReport, size_report
from cosserat_fx.numerics import numerics
from cosserat_fx.path import Path, Waypoint
from cosserat_fx.problem import Problem
from cosserat_fx.scene import LayerScene
from cosserat_fx.scenes.layer import Wall
from cosserat_fx.stepping import StepControl, Stepper
from cosserat_fx.walk import Branch, step_control, stepper_of

if TYPE_CHECKING:
    from cosserat_fx.accuracy.plan import Plan

BRANCH: Branch = "primary"
"""What a layer may branch into differs little from one solution to the next, and its mean response less."""


@dataclass(frozen=True)
class Layer:
    """A layer ready to be sheared.

    Attributes:
        scene: what it was made from.
        problem: its forms, state and conditions.
        stepper: walks it along the path.
        path: wall displacements and normal stress over the travel.
        stations: travel along the path at which profiles are asked for (m).
        element_sizes: against the grain diameter.
        warnings: what the user should know before it starts.
        plan: how an accuracy is to be kept, where one was asked for.
    """

    scene: LayerScene
    problem: Problem
    stepper: Stepper
    path: Path
    stations: tuple[float, ...]
    element_sizes: SizeReport
    warnings: tuple[str, ...]
    plan: Plan | None = None


def build(scene: LayerScene, comm: MPI.Intracomm, options: dict[str, PetscOption] | None = None) -> Layer:
    """Set up the layer of a scene. Collective.

    Args:
        scene: the validated scene.
        comm: the ranks that share the mesh.
        options: PETSc options (without prefix) that go before the scene's own.

    Raises:
        SceneError: the file of a measured void ratio cannot be used, or the run would take more memory than there is.
    """
    linear = refuse_too_large(scene, comm, options)
    path = layer_path(scene)
    body = geometry.layer(scene.geometry.height, scene.cells, comm)
    chosen = numerics(scene, scene.geometry.height, "interval")
    void_ratio = void_ratio_of(scene, body, chosen.degree)
    problem = Problem(
        body,
        scene.material,
        conditions(scene, path),
        stress=scene.initial.stress,
        void_ratio=void_ratio.values,
        numerics=chosen,
    )
    legs_before = len(path.corners) - 1 - len(scene.legs)
    stations = tuple(path.at(legs_before + station.leg, station.fraction) for station in scene.profile_stations)
    stepper = stepper_of(scene, problem, path.corners, stations, control_of(scene), options, linear)
    return Layer(scene, problem, stepper, path, stations, size_report(body, scene.material.d50), void_ratio.warnings)


def control_of(scene: LayerScene) -> StepControl:
    """Sizes of a layer's steps."""
    return step_control(scene, _stiff_size(scene), BRANCH)


def _stiff_size(scene: LayerScene) -> float:
    """The height, or what takes its place where the rotation at the walls goes before the shear of the layer (m).

    Grains that roll by a rotation w strain the layer at the wall by as much; a layer of this height is sheared by w/20.
    """
    rolling = max(wall.rolling_rotation_factor(scene.material.d50) for wall in (scene.walls.bottom, scene.walls.top))
    return min(scene.geometry.height, 20.0 / rolling) if rolling else scene.geometry.height


def layer_path(scene: LayerScene) -> Path:
    """The path of the walls; before it, weight and a normal stress other than the initial one are brought up."""
    waypoints = []
    normal = scene.walls.top.normal_stress
    loading = scene.weight is not None or (normal is not None and normal != scene.initial.stress)
    if loading:
        # The walls rest meanwhile; the mean grain diameter stands in for their travel.
        waypoints.append(Waypoint(0.0, 0.0, scene.material.d50))
    top = bottom = 0.0
    for leg in scene.legs:
        moves = leg.top - top, leg.bottom - bottom
        waypoints.append(Waypoint(leg.top, leg.bottom, max(abs(moves[0]), abs(moves[1]), abs(moves[0] - moves[1]))))
        top, bottom = leg
    return Path(waypoints, initial_load=0.0 if loading else 1.0)


def conditions(scene: LayerScene, path: Path) -> list[Condition]:
    """Boundary conditions of both walls, and weight."""
    walls, d50, polar = scene.walls, scene.material.d50, scene.effects.polar
    top, initial = walls.top, scene.initial.stress
    listed: list[Condition] = [
        *_wall_conditions("bottom", walls.bottom, path.bottom, -1, d50, polar),
        *_wall_conditions("top", top, path.top, +1, d50, polar),
        Prescribed("bottom", "u2", lambda travel: 0.0),
        *_weight(scene, path),
    ]
    if top.normal_stress is None:
        return [*listed, Prescribed("top", "u2", lambda travel: 0.0)]
    change = top.normal_stress - initial
    return [*listed, traction("top", lambda travel: (0.0, initial + path.load(travel) * change))]


def _weight(scene: LayerScene, path: Path) -> list[Load]:
    if scene.weight is None:
        return []
    full = scene.weight.density * scene.weight.gravity
    return [Load(lambda g, u, w, v, q, dx: weight_work(g[0], v, dx), lambda travel: (full * path.load(travel),))]


def _wall_conditions(
    side: str, wall: Wall, displacement: Callable[[float], float], outward: int, d50: float, polar: bool
) -> list[Prescribed]:
    """Displacement along the wall and rotation of the grains that touch it."""
    transmitted, turn = wall.displacement_factor, wall.rolling_rotation_factor(d50)
    given = [Prescribed(side, "u1", lambda travel: transmitted * displacement(travel))]
    if polar:
        given.append(Prescribed(side, "w", lambda travel: rolling_rotation(displacement(travel), turn, outward)))
    return given
