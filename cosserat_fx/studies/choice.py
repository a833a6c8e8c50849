"""One setting of all knobs, and how a scene is written that has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from cosserat_fx.scene import LayerScene, PlaneScene, Scene
from cosserat_fx.scenes.plane import RectangleGeometry

Effect = Literal["polar", "spin", "finite strain", "evolving void ratio"]

WITHOUT: dict[Effect, str] = {
    "polar": "effects.polar=false",
    "spin": "effects.spin=none",
    "finite strain": "effects.finite_strain=false",
    "evolving void ratio": "effects.void_ratio=false",
}
"""The key that leaves out an effect, by its name in ``run.json``."""
POINTS = {"1 point": 1, "2 points": 2}
"""The elements of a layer: its integration points per cell."""


@dataclass(frozen=True)
class Choice:
    """A setting of all knobs.

    Attributes:
        cells: how many times as many cells in each direction as the scene has.
        element: of a plane body its name, of a layer a key of :data:`POINTS`.
        steps: by which the aims of the step control, its first and its largest step are multiplied.
        local: by which the local tolerance is multiplied.
        without: the effect that is left out, if any.
    """

    cells: float
    element: str
    steps: float
    local: float
    without: Effect | None = None

    @property
    def name(self) -> str:
        """Name that a folder can have, one for each choice."""
        words = [f"cells-x{self.cells:g}", self.element, f"steps-x{self.steps:g}", f"local-x{self.local:g}"]
        return "_".join([*words, *([f"no-{self.without}"] if self.without else [])]).replace(" ", "-")


class Spelling:
    """How the keys of a scene spell a choice.

    Attributes:
        start: the choice that is the scene as it is.
    """

    def __init__(self, scene: Scene, element: str, first_step: float) -> None:
        """Keep what choices are relative to.

        Args:
            scene: as it is.
            element: that it has, as :class:`Choice` calls it.
            first_step: that it makes (m).
        """
        self._scene, self._first_step = scene, first_step
        self.start = Choice(1.0, element, 1.0, 1.0)

    def cells(self, choice: Choice) -> tuple[int, ...] | None:
        """Number of cells in each direction; None for a mesh from a file."""
        base = cells_of(self._scene)
        return None if base is None else tuple(max(1, round(choice.cells * number)) for number in base)

    def local_tolerance(self, choice: Choice) -> float:
        """Of the constitutive update."""
        return _rounded(choice.local * self._scene.solver.local_tolerance)

    def settings(self, choice: Choice) -> dict[str, str]:
        """The keys that turn the scene into one with the choice, with their values as TOML spells them."""
        found: dict[str, str] = {}
        if choice.cells != 1.0:
            cells = self.cells(choice)
            assert cells is not None
            found["geometry.cells"] = str(cells[0] if len(cells) == 1 else list(cells))
        if choice.element != self.start.element:
            points = POINTS.get(choice.element)
            found |= {"solver.integration_points": str(points)} if points else {"solver.element": choice.element}
        if choice.steps != 1.0:
            found |= {f"stepping.{key}": _spelled(value) for key, value in self._steps(choice.steps).items()}
        if choice.local != 1.0:
            found["solver.local_tolerance"] = _spelled(self.local_tolerance(choice))
        if choice.without:
            key, _, value = WITHOUT[choice.without].partition("=")
            found[key] = value
        if choice.without == "polar" and self._scene.effects.spin == "cosserat":
            found["effects.spin"] = "macro"
        return found

    def words(self, choice: Choice) -> str:
        """What sets a choice apart from the scene as it is."""
        cells, parts = self.cells(choice), []
        if choice.cells != 1.0 and cells is not None:
            parts.append(f"{' x '.join(map(str, cells))} cells")
        if choice.element != self.start.element:
            parts.append(choice.element)
        if choice.steps != 1.0:
            parts.append(f"steps x {choice.steps:g}")
        if choice.local != 1.0:
            parts.append(f"local tolerance {self.local_tolerance(choice):g}")
        if choice.without:
            parts.append(f"without {choice.without}")
        return ", ".join(parts) or "the scene as it is"

    def fragment(self, choice: Choice) -> str:
        """A piece of a scene file with the keys of a choice."""
        tables: dict[str, list[str]] = {}
        for dotted, value in self.settings(choice).items():
            table, _, key = dotted.partition(".")
            tables.setdefault(table, []).append(f"{key} = {_quoted(value)}")
        return "\n\n".join("\n".join([f"[{table}]", *lines]) for table, lines in tables.items())

    def _steps(self, factor: float) -> Mapping[str, float]:
        """The step control's keys with its aims, first and largest step multiplied."""
        asked, first = self._scene.stepping, factor * self._first_step
        keys = {"tolerance": factor * asked.tolerance, "strain": factor * asked.strain, "first_step": first}
        if asked.max_step is not None:
            keys["max_step"] = factor * asked.max_step
        if asked.min_step is not None:
            keys["min_step"] = min(asked.min_step, first)
        return keys


def cells_of(scene: Scene) -> tuple[int, ...] | None:
    """Number of cells in each direction; None for a mesh from a file."""
    if isinstance(scene, LayerScene):
        return (scene.cells,)
    assert isinstance(scene, PlaneScene)
    return scene.geometry.cells if isinstance(scene.geometry, RectangleGeometry) else None


def _rounded(value: float) -> float:
    return float(f"{value:.10g}")


def _spelled(value: float) -> str:
    return repr(_rounded(value))


def _quoted(value: str) -> str:
    """A value as TOML spells it, where overrides may leave out the quotes of a text."""
    bare = value in ("true", "false") or value[0] in "[0123456789"
    return value if bare else f'"{value}"'
