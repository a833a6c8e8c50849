"""Which effects a scene calls for, why, and what each costs; what is off leaves no field, state or term behind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosserat_fx.bodies import Body
from cosserat_fx.elements import choose
from cosserat_fx.layout import Layout, layout
from cosserat_fx.scene import LayerScene, PlaneScene, Scene
from cosserat_fx.state import point_record
from cosserat_fx.weakform import Numerics

_FIELDS = {"layer": "everything depends on x2 alone", "plane": "plane strain", "solid": "three dimensions"}


@dataclass(frozen=True)
class Effect:
    """One effect of a run.

    Attributes:
        name: the effect.
        choice: what was chosen, such as "on", "off" or the kind.
        reason: why.
        unknowns: how many unknowns of the whole body it adds.
        bytes_per_point: memory it adds at every quadrature point (bytes).
        kernel_time: its share of the constitutive update's time, 0 to 1, where it was measured.
    """

    name: str
    choice: str
    reason: str
    unknowns: int = 0
    bytes_per_point: int = 0
    kernel_time: float | None = None

    @property
    def is_on(self) -> bool:
        """Whether the run has it."""
        return self.choice not in ("off", "none")


def effects(body: Body) -> list[Effect]:
    """The list that ``check`` and ``run`` print, with the reason of every choice. Collective.

    Numbers of unknowns add up to all unknowns. Bytes add up to those of the state, and those of the stabilisation come
    on top: its stiffness, of which there is one at every point.
    """
    scene, problem = body.scene, body.problem
    chosen, dimension = problem.numerics, problem.geometry.dimension
    unknowns = problem.sizes["unknowns"]
    rotations = problem.comm.allreduce(problem.fields["w"].owned) if chosen.polar else 0
    memory = _memory(problem.layout, void_ratio=chosen.void_ratio)
    kind = scene.as_dict()["geometry"]["kind"]
    words = f'geometry.kind = "{kind}": {_FIELDS[dimension]}'
    return [
        Effect("dimension", dimension, words, unknowns - rotations, memory["dimension"]),
        Effect("polar", _on(chosen.polar), _polar(chosen), rotations, memory["polar"]),
        Effect("finite strain", _on(chosen.finite), _finite(scene, problem.geometry.smallest_extent)),
        Effect("spin", chosen.spin, _spin(chosen), 0, memory["spin"]),
        Effect("evolving void ratio", _on(chosen.void_ratio), _asked(chosen.void_ratio), 0, memory["void ratio"]),
        Effect("weight", _on(scene.weight is not None), _weight(scene)),
        Effect("interface sliding", "off", "no wall has a finite friction"),
        _stabilisation(scene, chosen, problem.geometry.mesh.topology.cell_name()),
    ]


def _memory(full: Layout, *, void_ratio: bool) -> dict[str, int]:
    """Bytes that each effect adds at a point, the effects being left out one after the other."""
    spin = bool(full.spin)
    stages = {
        "polar": (full, void_ratio),
        "spin": (layout(full.dimension, polar=False, spin=spin), void_ratio),
        "void ratio": (layout(full.dimension, polar=False, spin=False), void_ratio),
        "dimension": (layout(full.dimension, polar=False, spin=False), False),
    }
    left = [point_record(components, void_ratio=evolving).itemsize for components, evolving in stages.values()]
    return {name: here - below for name, here, below in zip(stages, left, [*left[1:], 0], strict=True)}


def _on(flag: bool) -> str:
    return "on" if flag else "off"


def _asked(flag: bool) -> str:
    return "default" if flag else "the scene says so"


def _polar(chosen: Numerics) -> str:
    return _asked(chosen.polar) if chosen.polar else f"{_asked(chosen.polar)}: classical hypoplasticity"


def _finite(scene: Scene, size: float) -> str:
    if scene.effects.finite_strain != "auto":
        return "the scene says so"
    percent = f"{100 * scene.largest_displacement / size:.3g} %"
    if isinstance(scene, LayerScene):
        return f"the walls move {percent} of the height"
    return f"prescribed displacements differ by {percent} of the smallest extent"


def _spin(chosen: Numerics) -> str:
    if not chosen.finite:
        return "small strain needs no objective rate"
    return "the scene says so" if chosen.spin == "none" else "objective rates go with finite strain"


def _weight(scene: Scene) -> str:
    weight = scene.weight
    return f"{weight.density:g} kg/m3 at {weight.gravity:g} m/s2" if weight else "no density is given"


def _stabilisation(scene: Scene, chosen: Numerics, cell: str) -> Effect:
    name = "hourglass stabilisation"
    if isinstance(scene, LayerScene):
        points = scene.solver.integration_points
        return Effect(name, "off", f"{points} point(s) per cell leave no zero-energy mode in a layer")
    assert isinstance(scene, PlaneScene)
    element = choose(scene.solver.element, cell)
    if not element.stabilised:
        return Effect(name, "off", f"{element.name} has no zero-energy mode: {element.words}")
    if not chosen.hourglass:
        return Effect(name, "off", f"solver.hourglass = 0, although {element.name} has a zero-energy mode")
    reason = f"{element.name} has a zero-energy mode; {chosen.hourglass:g} of the initial elastic stiffness resists it"
    return Effect(name, "on", reason, bytes_per_point=np.dtype(np.float64).itemsize)
