"""A plane-strain body made from a scene: its mesh, its path, its conditions, its solver."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cosserat_fx import geometry
from cosserat_fx._compat import MPI
from cosserat_fx.boundaries import BoundaryMaker, needs_loading
from cosserat_fx.geometry import Geometry, Grading
from cosserat_fx.initial.state import void_ratio_of
from cosserat_fx.linear_solver import PetscOption
from cosserat_fx.material import AdmissibilityError
from cosserat_fx.memory import refuse_too_large
from cosserat_fx.meshes import file as meshfile
from cosserat_fx.meshes.file import MeshError
from cosserat_fx.meshes.sizes import SizeReport, size_report
from cosserat_fx.numerics import numerics
from cosserat_fx.plane_path import PlanePath
from cosserat_fx.problem import Problem
from cosserat_fx.rigidity import rigid_motions
from cosserat_fx.scene import PlaneScene
from cosserat_fx.scenes.plane import RectangleGeometry
from cosserat_fx.scenes.refusals import SceneError, line, scene_error
from cosserat_fx.stepping import Stepper
from cosserat_fx.walk import Branch, step_control, stepper_of

BRANCH: Branch = "stable"
"""Where a plane body may branch it may form a shear band, or not."""


@dataclass(frozen=True)
class Plane:
    """A plane body ready to be deformed.

    Attributes:
        scene: what it was made from.
        problem: its forms, state and conditions.
        stepper: walks it along the path.
        path: histories over the travel.
        stations: travel along the path at which fields are asked for (m).
        element_sizes: against the grain diameter.
        warnings: what the user should know before it starts.
    """

    scene: PlaneScene
    problem: Problem
    stepper: Stepper
    path: PlanePath
    stations: tuple[float, ...]
    element_sizes: SizeReport
    warnings: tuple[str, ...]


def build(scene: PlaneScene, comm: MPI.Intracomm, options: dict[str, PetscOption] | None = None) -> Plane:
    """Set up the body of a scene. Collective.

    Args:
        scene: the validated scene.
        comm: the ranks that share the mesh.
        options: PETSc options (without prefix) that go before the scene's own.

    Raises:
        SceneError: the mesh cannot be used, does not have what the scene names, or is not held by its conditions; or
            the run would take more memory than there is.
    """
    try:
        refuse_too_large(scene, comm, options)
        body = body_of(scene, comm)
        linear = refuse_too_large(scene, comm, options, body)
        check_names(scene, body)
        chosen = numerics(scene, body.smallest_extent, body.mesh.topology.cell_name())
    except AdmissibilityError as error:
        raise scene_error(error) from error
    void_ratio = void_ratio_of(scene, body, chosen.degree)
    sizes = size_report(body, scene.material.d50)
    if sizes.error:
        key = "cells" if isinstance(scene.geometry, RectangleGeometry) else "file"
        raise SceneError(line(f"geometry.{key}", getattr(scene.geometry, key), sizes.error))
    loading = scene.material.d50 if needs_loading(scene, body) else 0.0
    path = PlanePath(scene.leg_lengths, loading=loading)
    conditions = BoundaryMaker(scene, body, path, chosen.finite, chosen.order).conditions()
    problem = Problem(
        body,
        scene.material,
        conditions,
        stress=scene.initial.stress,
        void_ratio=void_ratio.values,
        numerics=chosen,
    )
    if motions := rigid_motions(problem, conditions):
        raise SceneError(
            f"boundaries: the body can move rigidly, nothing holds its {' and '.join(motions)}: "
            "must have displacements prescribed, if only at a point"
        )
    stations = tuple(path.start + travel for travel in scene.output.fields_at or ())
    control = step_control(scene, body.smallest_extent, BRANCH)
    stepper = stepper_of(scene, problem, path.corners, stations, control, options, linear)
    warnings = [*void_ratio.warnings, *([sizes.warning] if sizes.warning else [])]
    if control.branch == "stable" and not stepper.solver.sees_branches:
        warnings.append(f"branches of equilibrium are not watched: {stepper.solver.linear.choice.blindness}")
    return Plane(scene, problem, stepper, path, stations, sizes, tuple(warnings))


def body_of(scene: PlaneScene, comm: MPI.Intracomm) -> Geometry:
    """The mesh that a scene describes.

    Raises:
        SceneError: the mesh file cannot be used.
    """
    described = scene.geometry
    if not isinstance(described, RectangleGeometry):
        try:
            return meshfile.read(Path(described.file), comm, scale=described.scale)
        except MeshError as error:
            raise SceneError(f"geometry.file: {error}") from error
    gradings = [Grading(g.fine, g.ratio) if g else None for g in (described.grading.x, described.grading.y)]
    return geometry.rectangle(
        described.width, described.height, described.cells, comm, grading_x=gradings[0], grading_y=gradings[1]
    )


def check_names(scene: PlaneScene, body: Geometry) -> None:
    """Refuse boundaries that the mesh does not have.

    Raises:
        AdmissibilityError: a table or a column names such a boundary.
    """
    allowed = f"must be a boundary of the mesh, {', '.join(body.boundaries)}"
    for name in scene.boundaries:
        if name not in body.boundaries:
            raise AdmissibilityError(f"boundaries.{name}", name, allowed)
    for name, column in scene.output.columns.items():
        if column.boundary not in body.boundaries:
            raise AdmissibilityError(f"output.columns.{name}.boundary", column.boundary, allowed)
