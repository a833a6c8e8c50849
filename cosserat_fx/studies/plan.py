"""Which settings of a scene's knobs a study tries."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

from cosserat_fx.elements import ELEMENTS, choose
from cosserat_fx.scene import LayerScene, PlaneScene, Scene, SceneError
from cosserat_fx.scenes.plane import MeshGeometry
from cosserat_fx.studies.choice import POINTS, WITHOUT, Choice, Effect, cells_of

Knob = Literal["cells", "element", "steps", "local tolerance", "effects"]
KNOBS: tuple[Knob, ...] = ("cells", "element", "steps", "local tolerance", "effects")


@dataclass(frozen=True)
class Sizes:
    """How much a study tries. All numbers are factors on what the scene has.

    Attributes:
        cells, steps, local: settings of the knobs when turned alone; those of the local tolerance are left out where it
            would not be less than 1.
        together_cells, together_steps, together_local: of the grid in which they are turned together.
        diagonal: of cells and steps that are turned together beyond the grid.
        fine_cells, fine_steps: the two refinements of the reference, doubling from one to the next.
        corner: the cells and the steps that both refinements share.
        tight: local tolerance of the reference.
    """

    cells: tuple[float, ...]
    steps: tuple[float, ...]
    local: tuple[float, ...]
    together_cells: tuple[float, ...]
    together_steps: tuple[float, ...]
    together_local: tuple[float, ...]
    diagonal: tuple[tuple[float, float], ...]
    fine_cells: tuple[float, ...]
    fine_steps: tuple[float, ...]
    corner: tuple[float, float]
    tight: float


LAYER = Sizes(
    cells=(1 / 4, 1 / 2, 2.0, 4.0, 8.0),
    steps=(4.0, 2.0, 1 / 2, 1 / 4, 1 / 8),
    local=(100.0, 10.0, 0.1, 0.01, 0.001),
    together_cells=(1 / 2, 1.0, 2.0),
    together_steps=(2.0, 1.0, 1 / 2),
    together_local=(10.0, 1.0),
    diagonal=((1 / 4, 4.0), (4.0, 1 / 4), (4.0, 1 / 2)),
    fine_cells=(1.0, 2.0, 4.0, 8.0, 16.0),
    fine_steps=(1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16),
    corner=(4.0, 1 / 4),
    tight=1e-3,
)
PLANE = Sizes(
    cells=(1 / 2, 2.0),
    steps=(4.0, 2.0, 1 / 2, 1 / 4),
    local=(100.0, 10.0, 0.1, 0.01),
    together_cells=(1 / 2, 1.0, 2.0),
    together_steps=(2.0, 1.0, 1 / 2),
    together_local=(10.0, 1.0),
    diagonal=((1 / 2, 4.0), (2.0, 1 / 4)),
    fine_cells=(1 / 2, 1.0, 2.0, 4.0),
    fine_steps=(1.0, 1 / 2, 1 / 4, 1 / 8),
    corner=(1.0, 1 / 2),
    tight=1e-2,
)
QUICK = Sizes(
    cells=(1 / 2, 2.0),
    steps=(2.0, 1 / 2),
    local=(10.0, 0.1),
    together_cells=(1 / 2, 1.0),
    together_steps=(2.0, 1.0),
    together_local=(1.0,),
    diagonal=((2.0, 1 / 2),),
    fine_cells=(1.0, 2.0, 4.0),
    fine_steps=(1.0, 1 / 2, 1 / 4),
    corner=(1.0, 1 / 2),
    tight=0.1,
)


@dataclass(frozen=True)
class Refinement:
    """The runs of the reference.

    Attributes:
        cells, steps: ever finer ones, all else being that of the corner.
        corner: what both have in common.
        looser: the one with the scene's own cells at ten times the reference's local tolerance.
        tighter: the same at the reference's local tolerance.
        diagonal: both finer than the corner by one level; None where cells cannot be varied.
    """

    cells: tuple[Choice, ...]
    steps: tuple[Choice, ...]
    corner: Choice
    looser: Choice
    tighter: Choice
    diagonal: Choice | None

    @property
    def choices(self) -> list[Choice]:
        """All of them, the cheap ones first, each once."""
        last = [self.diagonal] if self.diagonal else []
        return list(dict.fromkeys([self.looser, self.tighter, *self.cells, *self.steps, *last]))


@dataclass(frozen=True)
class Plan:
    """What a study runs.

    Attributes:
        start: the scene as it is.
        alone: by knob, without the scene as it is.
        together: settings of several knobs at once.
        refinement: for the reference.
        skipped: knobs that cannot be turned, with the reason.
    """

    start: Choice
    alone: dict[Knob, tuple[Choice, ...]]
    together: tuple[Choice, ...]
    refinement: Refinement
    skipped: dict[Knob, str]

    @property
    def timed(self) -> list[Choice]:
        """What is timed, each once, the scene as it is first."""
        alone = [choice for choices in self.alone.values() for choice in choices]
        return list(dict.fromkeys([self.start, *alone, *self.together]))

    @property
    def untimed(self) -> list[Choice]:
        """What only the reference needs."""
        timed = set(self.timed)
        return [choice for choice in self.refinement.choices if choice not in timed]


def sizes_for(scene: Scene, *, quick: bool) -> Sizes:
    """How much to try of a scene."""
    if quick:
        return QUICK
    return LAYER if isinstance(scene, LayerScene) else PLANE


def plan(scene: Scene, start: Choice, effects: Sequence[Effect], sizes: Sizes) -> Plan:
    """What a study of a scene runs.

    Args:
        scene: as it is.
        start: the choice that it is.
        effects: that its run had.
        sizes: how much to try.
    """
    skipped: dict[Knob, str] = {}
    meshed = cells_of(scene) is None
    if meshed:
        skipped["cells"] = "the mesh is from a file, which a study does not refine"
        sizes = replace(
            sizes,
            cells=(),
            together_cells=(1.0,),
            diagonal=(),
            fine_cells=(1.0,),
            corner=(1.0, sizes.corner[1]),
        )
    if not effects:
        skipped["effects"] = "the scene has none that can be left out"
    elements = [name for name in elements_for(scene, start.element) if name != start.element]
    local = [factor for factor in sizes.local if factor * scene.solver.local_tolerance < 1.0]
    alone: dict[Knob, tuple[Choice, ...]] = {
        "cells": _each(start, "cells", sizes.cells),
        "element": _each(start, "element", elements),
        "steps": _each(start, "steps", sizes.steps),
        "local tolerance": _each(start, "local", local),
        "effects": _each(start, "without", effects),
    }
    return Plan(start, alone, _together(start, sizes), _refinement(start, sizes), skipped)


def elements_for(scene: Scene, element: str) -> list[str]:
    """The elements that a scene can have, given one that it has."""
    if isinstance(scene, LayerScene):
        return list(POINTS)
    return [it.name for it in ELEMENTS.values() if it.cell == ELEMENTS[element].cell]


def element_of(scene: Scene) -> str:
    """The element that a scene has. Reads its mesh where there is one.

    Raises:
        SceneError: the mesh cannot be read, or the element has other cells.
    """
    if isinstance(scene, LayerScene):
        return next(name for name, points in POINTS.items() if points == scene.solver.integration_points)
    assert isinstance(scene, PlaneScene)
    cell = "quadrilateral"
    if isinstance(scene.geometry, MeshGeometry):
        from cosserat_fx.meshes.file import MeshError, load

        try:
            cell = load(Path(scene.geometry.file), scene.geometry.scale).cell
        except MeshError as error:
            raise SceneError(str(error)) from None
    return choose(scene.solver.element, cell).name


def effects_of(summary: dict[str, Any]) -> list[Effect]:
    """The effects that a run had and that can be left out.

    Args:
        summary: its ``run.json``.
    """
    had = {effect["name"] for effect in summary["effects"] if effect["choice"] not in ("off", "none")}
    return [name for name in WITHOUT if name in had]


def weight(choice: Choice, start: Choice, dimension: int) -> float:
    """What the solver is expected to take over the scene as it is, roughly; what has been measured corrects it.

    Args:
        choice: what is to be run.
        start: the scene as it is.
        dimension: in how many directions the cells are refined.
    """
    refined = choice.cells ** (dimension if choice.cells > 1 else dimension / 2)
    steps = choice.steps**-0.8 if choice.steps < 1 else 1.0
    local = choice.local**-0.2 if choice.local < 1 else 1.0
    return refined * steps * local * _points(choice.element) / _points(start.element)


def _points(element: str) -> float:
    """Quadrature points of a cell, about."""
    return POINTS[element] if element in POINTS else ((ELEMENTS[element].degree + 1) / 2) ** 2


def _each(start: Choice, knob: str, settings: Iterable[object]) -> tuple[Choice, ...]:
    """One knob turned alone."""
    changes: list[dict[str, Any]] = [{knob: setting} for setting in settings]
    return tuple(replace(start, **change) for change in changes)


def _together(start: Choice, sizes: Sizes) -> tuple[Choice, ...]:
    """The grid and what is tried beyond it, without what is turned alone."""
    grid = [
        replace(start, cells=cells, steps=steps, local=local)
        for cells, steps, local in product(sizes.together_cells, sizes.together_steps, sizes.together_local)
    ]
    beyond = [replace(start, cells=cells, steps=steps) for cells, steps in sizes.diagonal]
    return tuple(choice for choice in [*grid, *beyond] if _turned(start, choice) > 1)


def _turned(start: Choice, choice: Choice) -> int:
    return sum(getattr(choice, knob) != getattr(start, knob) for knob in ("cells", "element", "steps", "local"))


def _refinement(start: Choice, sizes: Sizes) -> Refinement:
    cells, steps = sizes.corner
    corner = replace(start, cells=cells, steps=steps, local=sizes.tight)
    tighter = replace(corner, cells=1.0)
    return Refinement(
        cells=_each(corner, "cells", sizes.fine_cells),
        steps=_each(corner, "steps", sizes.fine_steps),
        corner=corner,
        looser=replace(tighter, local=10 * sizes.tight),
        tighter=tighter,
        diagonal=replace(corner, cells=2 * cells, steps=steps / 2) if len(sizes.fine_cells) > 1 else None,
    )
