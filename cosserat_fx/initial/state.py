"""The initial void ratio that a scene describes, at the quadrature points of its body."""

from __future__ import annotations

import basix

from cosserat_fx.geometry import Geometry
from cosserat_fx.initial.measured_field import FieldFileError
from cosserat_fx.initial.void_ratio import VoidRatio, initial_void_ratio
from cosserat_fx.material import AdmissibilityError
from cosserat_fx.meshes.file import MeshError
from cosserat_fx.scene import Scene
from cosserat_fx.scenes.refusals import SceneError, scene_error


def void_ratio_of(scene: Scene, body: Geometry, degree: int) -> VoidRatio:
    """Evaluate the scene's void ratio between the law's bounds at the initial pressure. Collective.

    Args:
        scene: of a layer or a plane body.
        body: its mesh.
        degree: of the quadrature rule.

    Raises:
        SceneError: a zone names a region that the mesh does not have, or the file of a measured void ratio cannot be
            used.
    """
    points, weights = basix.make_quadrature(body.mesh.basix_cell(), degree)
    e_i, _, e_d = scene.material.characteristic_void_ratios(-scene.initial.stress)
    d50 = scene.material.d50
    try:
        return initial_void_ratio(scene.initial, body, points, weights, d50=d50, bounds=(e_d, e_i))
    except AdmissibilityError as error:
        raise scene_error(error) from error
    except (FieldFileError, MeshError) as error:
        raise SceneError(f"initial.field.file: {error}") from error
