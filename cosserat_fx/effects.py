"""Which effects a scene calls for, and why; what is off leaves no field, no state and no term behind.

A small-strain run is audited afterwards: where strains left the range in which the omission is fair, it says so.
"""

from __future__ import annotations

from dataclasses import dataclass

from cosserat_fx.scene import Scene
from cosserat_fx.weakform import Numerics

LARGE_DISPLACEMENT = 0.03
"""Prescribed displacement over the layer's height above which strains are taken as finite."""
FAIR_SMALL_STRAIN = 0.3
"""Largest shear strain up to which a small-strain run is fair."""


@dataclass(frozen=True)
class Effect:
    """One effect of a run.

    Attributes:
        name: the effect.
        choice: what was chosen, such as "on", "off" or the kind.
        reason: why.
    """

    name: str
    choice: str
    reason: str


def numerics(scene: Scene) -> Numerics:
    """The problem's effects and integration as the scene asks for them."""
    finite = _finite(scene)
    return Numerics(
        polar=scene.effects.polar,
        finite=finite,
        spin=scene.effects.spin if finite else "none",
        void_ratio=scene.effects.void_ratio,
        degree=2 * scene.solver.integration_points - 1,
        local_tolerance=scene.solver.local_tolerance,
    )


def effects(scene: Scene) -> list[Effect]:
    """The list that ``check`` and ``run`` print, with the reason of every choice."""
    chosen = numerics(scene)
    ratio = _largest_displacement(scene) / scene.geometry.height
    asked = "the scene says so"
    size = f"the walls move {100 * ratio:.3g} % of the height"
    points = scene.solver.integration_points
    return [
        Effect("dimension", "layer", f'geometry.kind = "{scene.geometry.kind}": everything depends on x2 alone'),
        Effect("polar", _on(chosen.polar), "default" if chosen.polar else f"{asked}: classical hypoplasticity"),
        Effect("finite strain", _on(chosen.finite), size if scene.effects.finite_strain == "auto" else asked),
        Effect(
            "spin",
            chosen.spin,
            "objective rates go with finite strain" if chosen.finite else "small strain needs no objective rate",
        ),
        Effect("evolving void ratio", _on(chosen.void_ratio), "default" if chosen.void_ratio else asked),
        Effect("weight", "off", "no density is given"),
        Effect("interface sliding", "off", "no wall has a finite friction"),
        Effect("hourglass stabilisation", "off", f"{points} point(s) per cell leave no zero-energy mode in a layer"),
    ]


def audit(scene: Scene, max_shear_strain: float) -> list[str]:
    """Warnings about omitted effects that the solution turned out to need.

    Args:
        scene: what was run.
        max_shear_strain: largest |du1/dx2| that occurred.
    """
    if numerics(scene).finite or max_shear_strain <= FAIR_SMALL_STRAIN:
        return []
    return [
        f"finite strain was off, but the shear strain reached {max_shear_strain:.3g}; small strain is fair up to "
        f"{FAIR_SMALL_STRAIN:g}: set effects.finite_strain = true"
    ]


def _finite(scene: Scene) -> bool:
    asked = scene.effects.finite_strain
    return (
        asked if isinstance(asked, bool) else _largest_displacement(scene) > LARGE_DISPLACEMENT * scene.geometry.height
    )


def _largest_displacement(scene: Scene) -> float:
    """Largest relative displacement of the walls (m)."""
    return max(abs(leg.travel) for leg in scene.legs)


def _on(flag: bool) -> str:
    return "on" if flag else "off"
