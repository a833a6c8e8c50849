"""The scene: read from a file, checked as a whole, or refused with one message that says what is wrong with it.

`geometry.kind` decides which kind of scene it is: a layer or a plane body.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import accumulate
from pathlib import Path
from typing import Annotated, Any, Final, Self

from pydantic import BeforeValidator, Discriminator, Field, InstanceOf, Tag, ValidationError, model_validator

from cosserat_fx.elements import choose
from cosserat_fx.material import AdmissibilityError, Material
from cosserat_fx.scenes.checks import (
    check_boundaries,
    check_columns,
    check_number,
    check_path_is_finite,
    check_points,
    check_rotations_exist,
    check_something_happens,
    displacement_groups,
    reached,
)
from cosserat_fx.scenes.file import apply_override, check_depth, read_tables
from cosserat_fx.scenes.histories import (
    Given,
    check_motions_start_at_rest,
    count_legs,
    histories,
    largest_range,
    leg_lengths,
)
from cosserat_fx.scenes.initial import Initial
from cosserat_fx.scenes.layer import (
    LayerGeometry,
    LayerOutput,
    LayerSolver,
    Leg,
    Station,
    Walls,
    default_profiles,
    find_stations,
)
from cosserat_fx.scenes.plane import (
    Boundary,
    MeshGeometry,
    PlaneOutput,
    PlaneSolver,
    Point,
    RectangleGeometry,
)
from cosserat_fx.scenes.refusals import SceneError, either, line, refusal, shown
from cosserat_fx.scenes.schema import Effects, Output, Solver, Stepping, Table, Weight, spell_key, unknown_key

__all__ = [
    "DEFAULT_SET",
    "LayerScene",
    "PlaneScene",
    "Scene",
    "SceneError",
    "load_scene",
    "parse_scene",
]

DEFAULT_SET: Final = "paper-sand"
"""The material of a scene that names none."""

CHOSEN: Final[Mapping[str, tuple[str, ...]]] = {
    "geometry": ("cells",),
    "stepping": ("first_step", "tolerance", "strain"),
    "solver": ("local_tolerance",),
}
"""Tables and keys of a layer that are chosen where it asks for an accuracy and does not give them."""

DEFAULT_KIND: Final = "layer"
"""The geometry of a scene that names none."""


def _resolve_material(table: object) -> object:
    """Returns the material that a table describes, and anything else as it came."""
    if not isinstance(table, dict):
        return table
    keys = ["constants", *(field.name for field in fields(Material))]
    for key, value in table.items():
        if key not in keys:
            raise AdmissibilityError(spell_key(key), value, unknown_key(key, keys))
    overrides = {key: value for key, value in table.items() if key != "constants"}
    return Material.named(table.get("constants", DEFAULT_SET), **overrides)


class Scene(Table):
    """What every scene has, checked, with its defaults filled in."""

    title: str = ""
    geometry: Table
    material: Annotated[InstanceOf[Material], BeforeValidator(_resolve_material)] = Material.named(DEFAULT_SET)
    initial: Initial
    weight: Weight | None = None
    effects: Effects = Effects()
    stepping: Stepping = Stepping()
    solver: Solver = Solver()
    output: Output = Output()

    @model_validator(mode="after")
    def _check_initial_density(self) -> Self:
        self.initial.check_density(self.material)
        return self

    @property
    @abstractmethod
    def largest_displacement(self) -> float:
        """Largest difference over the path of displacements prescribed in the same direction, m."""

    def as_dict(self) -> dict[str, Any]:
        """Returns the scene with its defaults filled in, of types that JSON and TOML know; it parses to the same scene.

        Material constants are spelled out, and what is left to the program (None) is left out.
        """
        return self.model_dump(mode="json", exclude_none=True)


class LayerScene(Scene):
    """The scene of an infinite layer between two walls."""

    accuracy: float | None = Field(default=None, gt=0, le=0.1)
    """Relative error allowed in the peak and the residual shear stress; what the scene does not give of mesh, steps and
    local tolerance is chosen to meet it."""
    geometry: LayerGeometry
    walls: Walls
    solver: LayerSolver = LayerSolver()
    output: LayerOutput = LayerOutput()

    @model_validator(mode="after")
    def _check_zones(self) -> Self:
        self.initial.check_zones_of_layer(self.geometry.height)
        return self

    @model_validator(mode="after")
    def _check_rotation_exists(self) -> Self:
        for side, wall in (("bottom", self.walls.bottom), ("top", self.walls.top)):
            wall.check_rotation_exists(f"walls.{side}", polar=self.effects.polar)
        return self

    @model_validator(mode="after")
    def _check_accuracy(self) -> Self:
        if self.accuracy is None:
            if self.geometry.cells is None:
                allowed = "must be given unless accuracy is, by which they are chosen"
                raise AdmissibilityError("geometry.cells", None, allowed)
        elif not self.effects.polar:
            allowed = "must be left out where effects.polar = false: without a length, the answer is that of the mesh"
            raise AdmissibilityError("accuracy", self.accuracy, allowed)
        return self

    @model_validator(mode="after")
    def _fill_and_check_profiles(self) -> Self:
        if self.output.profiles_at is None:
            filled = self.output.model_copy(update={"profiles_at": default_profiles(self.legs)})
            object.__setattr__(self, "output", filled)
        find_stations(self.output.profiles_at or (), self.legs)
        return self

    @property
    def given(self) -> tuple[str, ...]:
        """Which keys the scene gives of those that an accuracy chooses."""
        return tuple(
            f"{name}.{key}"
            for name, keys in CHOSEN.items()
            for key in keys
            if key in getattr(self, name).model_fields_set
        )

    @property
    def cells(self) -> int:
        """Number of cells, of a scene that gives them."""
        assert self.geometry.cells is not None
        return self.geometry.cells

    def as_dict(self) -> dict[str, Any]:
        """Returns the scene as that of any kind; what an accuracy is to choose is left out."""
        tables = super().as_dict()
        for name, keys in CHOSEN.items() if self.accuracy is not None else ():
            for key in keys:
                if f"{name}.{key}" not in self.given:
                    tables[name].pop(key, None)
        return tables

    @property
    def legs(self) -> tuple[Leg, ...]:
        """Wall targets in turn; the path starts at (0, 0), which is not among them."""
        return self.walls.legs

    @property
    def largest_displacement(self) -> float:
        """Largest relative displacement of the walls along x1, m."""
        return max(abs(leg.travel) for leg in self.legs)

    @property
    def profile_stations(self) -> tuple[Station, ...]:
        """Where on the path profiles are to be written, in the order of the path."""
        return find_stations(self.output.profiles_at or (), self.legs)


def _kind(geometry: object) -> object:
    """Returns the kind that a geometry says it is."""
    if isinstance(geometry, Mapping):
        return geometry.get("kind", DEFAULT_KIND)
    return getattr(geometry, "kind", DEFAULT_KIND)


class PlaneScene(Scene):
    """The scene of a plane-strain body with conditions on its boundaries and points.

    Travel is the clock of its path (m). It is counted from the start of the first leg, after loads and weight have been
    brought up.
    """

    geometry: Annotated[
        Annotated[RectangleGeometry, Tag("rectangle")] | Annotated[MeshGeometry, Tag("mesh")], Discriminator(_kind)
    ]
    boundaries: dict[str, Boundary] = Field(default_factory=dict)
    points: dict[str, Point] = Field(default_factory=dict)
    solver: PlaneSolver = PlaneSolver()
    output: PlaneOutput = PlaneOutput()

    @model_validator(mode="after")
    def _check_number(self) -> Self:
        check_number(boundaries=self.boundaries, points=self.points)
        return self

    @model_validator(mode="after")
    def _check_rectangle(self) -> Self:
        if isinstance(self.geometry, RectangleGeometry):
            self.initial.check_zones_of_rectangle(self.geometry.width, self.geometry.height)
            check_points(self.points, self.geometry)
            choose(self.solver.element, "quadrilateral")
        return self

    @model_validator(mode="after")
    def _check_conditions(self) -> Self:
        rectangle, polar = isinstance(self.geometry, RectangleGeometry), self.effects.polar
        check_boundaries(self.boundaries, rectangle=rectangle)
        check_columns(self.output.columns, self.boundaries, polar=polar, rectangle=rectangle)
        check_rotations_exist(self.boundaries, self.points, polar=polar)
        return self

    @model_validator(mode="after")
    def _check_path(self) -> Self:
        check_motions_start_at_rest(self._histories)
        count_legs(self._histories)
        check_path_is_finite(self._histories, self.travel)
        check_something_happens(
            self._histories, self.boundaries, weight=self.weight is not None, stress=self.initial.stress
        )
        return self

    @model_validator(mode="after")
    def _fill_and_check_fields_at(self) -> Self:
        ends = tuple(accumulate(self.leg_lengths))
        asked = self.output.fields_at
        travels = ends if asked is None else reached(asked, ends)
        object.__setattr__(self, "output", self.output.model_copy(update={"fields_at": travels}))
        return self

    @property
    def _histories(self) -> tuple[Given, ...]:
        """All histories of the scene, with their keys."""
        tables = {f"boundaries.{spell_key(name)}": table for name, table in self.boundaries.items()} | {
            f"points.{spell_key(name)}": table for name, table in self.points.items()
        }
        return tuple(given for key, table in tables.items() for given in histories(table, key))

    @property
    def legs(self) -> int:
        """Number of legs, without the one in which loads and weight are brought up."""
        return count_legs(self._histories)

    @property
    def leg_lengths(self) -> tuple[float, ...]:
        """Travel of each leg, m."""
        return leg_lengths(self._histories, self.material.d50)

    @property
    def travel(self) -> float:
        """Travel of the whole path, m."""
        return sum(self.leg_lengths)

    @property
    def largest_displacement(self) -> float:
        """Largest difference over the path of displacements prescribed in the same direction, m."""
        return largest_range(displacement_groups(self._histories, self.boundaries), self.leg_lengths)


_KINDS: Final[Mapping[str, type[Scene]]] = {"layer": LayerScene, "rectangle": PlaneScene, "mesh": PlaneScene}


def load_scene(path: Path, overrides: Sequence[str] = ()) -> Scene:
    """Reads and validates a scene file. Files it names are looked for from its folder.

    Args:
        path: a TOML file.
        overrides: "key.path=value" each, replacing or adding a key. The value is read as a TOML value and, where it is
            none, as a bare string; nothing is evaluated.

    Raises:
        SceneError: the file cannot be read, is no TOML, or does not describe an admissible scene.
    """
    tables = read_tables(path)
    for override in overrides:
        apply_override(override, tables)
    return parse_scene(tables, path.parent)


def parse_scene(tables: Mapping[str, object], folder: Path = Path()) -> Scene:
    """Validates the tables of a scene, as a TOML parser (or `Scene.as_dict`) gives them.

    Args:
        tables: the scene.
        folder: where files are looked for that the scene names by a relative path.

    Raises:
        SceneError: they do not describe an admissible scene.
    """
    check_depth(tables)
    kind = _kind(tables.get("geometry"))
    if not isinstance(kind, str) or kind not in _KINDS:
        raise SceneError(line("geometry.kind", kind, f"must be {either([shown(it) for it in _KINDS])}"))
    try:
        return _KINDS[kind].model_validate(dict(tables), context={"folder": folder})
    except ValidationError as error:
        raise refusal(error, kind, _KINDS) from None
