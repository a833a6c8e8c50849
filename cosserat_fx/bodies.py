"""The one place that knows which kinds of bodies there are."""

from __future__ import annotations

from dataclasses import replace

from cosserat_fx import layer, plane
from cosserat_fx._compat import MPI, PETSc
from cosserat_fx.accuracy.plan import Plan, plan
from cosserat_fx.linear_solver import PetscOption
from cosserat_fx.output.layer_recording import LayerRecording
from cosserat_fx.output.plane_recording import PlaneRecording
from cosserat_fx.output.recording import Recording
from cosserat_fx.parallel import on_first_rank
from cosserat_fx.scene import LayerScene, PlaneScene, Scene, SceneError

type Body = layer.Layer | plane.Plane


def build(scene: Scene, comm: MPI.Intracomm, options: dict[str, PetscOption] | None = None) -> Body:
    """Set up the body of a scene. Collective.

    Args:
        scene: the validated scene.
        comm: the ranks that share the mesh.
        options: PETSc options (without prefix) that go before the scene's own.

    Raises:
        SceneError: the scene does not fit its mesh, a file that it names cannot be used, the run would take more memory
            than there is, or PETSc refuses an option.
    """
    try:
        if isinstance(scene, LayerScene):
            return _layer(scene, comm, options)
        assert isinstance(scene, PlaneScene)
        return plane.build(scene, comm, options)
    except PETSc.Error as error:
        raise refused_by_petsc(error) from error


def _layer(scene: LayerScene, comm: MPI.Intracomm, options: dict[str, PetscOption] | None) -> layer.Layer:
    """The layer of a scene, which an accuracy may complete."""
    if scene.accuracy is None:
        return layer.build(scene, comm, options)

    def planned() -> Plan:
        try:
            return plan(scene, options)
        except PETSc.Error as error:  # which other ranks could not be told
            raise refused_by_petsc(error) from error

    found = on_first_rank(comm, planned)
    return replace(layer.build(found.scene, comm, options), plan=found)


def refused_by_petsc(error: PETSc.Error) -> SceneError:
    """The refusal of a scene with whose options PETSc cannot work."""
    PETSc.Options()["options_left"] = "no"  # or it would list, at the end, those that it did not come to
    return SceneError(f"solver.petsc: {told_by(error)}")


def told_by(error: PETSc.Error) -> str:
    """What PETSc says, without the trace of calls that it puts first."""
    return f"PETSc says: {str(error).splitlines()[-1].partition('] ')[2]}"


def recording_of(body: Body) -> Recording:
    """What records a body. Collective.

    Args:
        body: as :func:`build` makes it.
    """
    return LayerRecording(body) if isinstance(body, layer.Layer) else PlaneRecording(body)
