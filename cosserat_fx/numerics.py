"""What a scene asks of the numerics: which effects the forms and the kernel hold, which element and quadrature."""

from __future__ import annotations

from dataclasses import replace

from cosserat_fx.elements import choose
from cosserat_fx.scene import LayerScene, PlaneScene, Scene
from cosserat_fx.weakform import Numerics

LARGE_DISPLACEMENT = 0.03
"""Prescribed displacement over the body's smallest extent above which strains are taken as finite."""


def numerics(scene: Scene, size: float, cell: str) -> Numerics:
    """The problem's effects and integration as the scene asks for them.

    Args:
        scene: of a layer or a plane body.
        size: smallest extent of the body (m).
        cell: name of the mesh's cells.

    Raises:
        AdmissibilityError: the element that the scene asks for has other cells.
    """
    asked = scene.effects
    finite = asked.finite_strain
    if finite == "auto":
        finite = scene.largest_displacement > LARGE_DISPLACEMENT * size
    chosen = Numerics(
        polar=asked.polar,
        finite=finite,
        spin=asked.spin if finite else "none",
        void_ratio=asked.void_ratio,
        local_tolerance=scene.solver.local_tolerance,
    )
    if isinstance(scene, LayerScene):
        return replace(chosen, degree=2 * scene.solver.integration_points - 1)
    assert isinstance(scene, PlaneScene)
    element = choose(scene.solver.element, cell)
    hourglass = scene.solver.hourglass if element.stabilised else 0.0
    return replace(chosen, order=element.order, degree=element.degree, hourglass=hourglass)
