"""The one place that knows which kinds of bodies there are."""

from __future__ import annotations

from cosserat_fx import layer, plane
from cosserat_fx._compat import MPI
from cosserat_fx.newton import PetscOption
from cosserat_fx.output.layer_recording import LayerRecording
from cosserat_fx.output.plane_recording import PlaneRecording
from cosserat_fx.output.recording import Recording
from cosserat_fx.scene import LayerScene, PlaneScene, Scene

type Body = layer.Layer | plane.Plane


def build(scene: Scene, comm: MPI.Intracomm, options: dict[str, PetscOption] | None = None) -> Body:
    """Set up the body of a scene. Collective.

    Args:
        scene: the validated scene.
        comm: the ranks that share the mesh.
        options: PETSc options (without prefix) that go before the scene's own.

    Raises:
        SceneError: the scene does not fit its mesh, or a file that it names cannot be used.
    """
    if isinstance(scene, LayerScene):
        return layer.build(scene, comm, options)
    assert isinstance(scene, PlaneScene)
    return plane.build(scene, comm, options)


def recording_of(body: Body) -> Recording:
    """What records a body. Collective.

    Args:
        body: as :func:`build` makes it.
    """
    return LayerRecording(body) if isinstance(body, layer.Layer) else PlaneRecording(body)
