"""The scene: read from a file, checked as a whole, or refused with one message that says what is wrong with it."""

import json
import tomllib
import types
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic import BeforeValidator, InstanceOf, ValidationError, model_validator
from pydantic_core import ErrorDetails

from cosserat_fx.material import AdmissibilityError, Material
from cosserat_fx.schema import (
    Effects,
    Initial,
    LayerGeometry,
    Leg,
    Output,
    Solver,
    Station,
    Stepping,
    Table,
    Unit,
    Walls,
    default_profiles,
    find_stations,
    spell_key,
    unknown_key,
)

DEFAULT_SET: Final = "paper-sand"
"""The material of a scene that names none."""

MAX_FILE_SIZE: Final = 10_000_000
"""Size above which a file is not taken for a scene, bytes."""
_MAX_LINES: Final = 20
"""Number of faults told at once."""
_MAX_SHOWN: Final = 60
"""Number of characters of a value repeated in a message."""

_WORDS: Final = {float: "a finite number", int: "a whole number", str: "a string", bool: "true or false"}
_BOUNDS: Final = ((Gt, "gt", "greater than"), (Ge, "ge", "of at least"), (Lt, "lt", "less than"), (Le, "le", "at most"))


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
    """A whole scene, checked, with its defaults filled in."""

    title: str = ""
    geometry: LayerGeometry
    material: Annotated[InstanceOf[Material], BeforeValidator(_resolve_material)] = Material.named(DEFAULT_SET)
    initial: Initial
    walls: Walls
    effects: Effects = Effects()
    stepping: Stepping = Stepping()
    solver: Solver = Solver()
    output: Output = Output()

    @model_validator(mode="after")
    def _check_initial_density(self) -> Self:
        pressure = -self.initial.stress
        e_i, _, e_d = self.material.characteristic_void_ratios(pressure)
        if not e_d < self.initial.void_ratio < e_i:
            allowed = (
                f"must be greater than e_d = {e_d:.6g} and less than e_i = {e_i:.6g}, "
                f"the densest and the loosest state at the initial pressure of {pressure:g} Pa"
            )
            raise AdmissibilityError("initial.void_ratio", self.initial.void_ratio, allowed)
        return self

    @model_validator(mode="after")
    def _check_rotation_exists(self) -> Self:
        for side, wall in (("bottom", self.walls.bottom), ("top", self.walls.top)):
            for key, value in (("rolling", wall.rolling), ("f_r", wall.f_r)):
                if value and not self.effects.polar:
                    allowed = "must be 0 where effects.polar = false, as there is no rotation to prescribe"
                    raise AdmissibilityError(f"walls.{side}.{key}", value, allowed)
        return self

    @model_validator(mode="after")
    def _fill_and_check_profiles(self) -> Self:
        if self.output.profiles_at is None:
            filled = self.output.model_copy(update={"profiles_at": default_profiles(self.legs)})
            object.__setattr__(self, "output", filled)
        find_stations(self.output.profiles_at or (), self.legs)
        return self

    @property
    def legs(self) -> tuple[Leg, ...]:
        """Wall targets in turn; the path starts at (0, 0), which is not among them."""
        return self.walls.legs

    @property
    def profile_stations(self) -> tuple[Station, ...]:
        """Where on the path profiles are to be written, in the order of the path."""
        return find_stations(self.output.profiles_at or (), self.legs)

    def as_dict(self) -> dict[str, Any]:
        """Returns the scene with its defaults filled in, of types that JSON and TOML know; it parses to the same scene.

        Material constants are spelled out, and what is left to the program (None) is left out.
        """
        return self.model_dump(mode="json", exclude_none=True)


class SceneError(ValueError):
    """A scene that cannot be used. Each line of the message names a key, its value and what is allowed."""

    def __init__(self, message: str) -> None:
        """Keeps the message, with what cannot be written as UTF-8 spelled out."""
        super().__init__(message.encode("utf-8", "backslashreplace").decode())


def load_scene(path: Path, overrides: Sequence[str] = ()) -> Scene:
    """Reads and validates a scene file.

    Args:
        path: a TOML file.
        overrides: "key.path=value" each, replacing or adding a key. The value is read as a TOML value and, where it is
            none, as a bare string; nothing is evaluated.

    Raises:
        SceneError: the file cannot be read, is no TOML, or does not describe an admissible scene.
    """
    tables = _read(path)
    for override in overrides:
        _apply(override, tables)
    return parse_scene(tables)


def parse_scene(tables: Mapping[str, object]) -> Scene:
    """Validates the tables of a scene, as a TOML parser (or `Scene.as_dict`) gives them.

    Raises:
        SceneError: they do not describe an admissible scene.
    """
    try:
        return Scene.model_validate(dict(tables))
    except ValidationError as error:
        raise SceneError(_message(error)) from None


def _read(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            content = file.read(MAX_FILE_SIZE + 1)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read as a scene file: {error.strerror}") from None
    if len(content) > MAX_FILE_SIZE:
        raise SceneError(f"{path}: must not be larger than {MAX_FILE_SIZE} bytes to be a scene file")
    try:
        return tomllib.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise SceneError(f"{path}: must be UTF-8 text, but line {line} is not") from None
    except (ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else error
        raise SceneError(f"{path}: not valid TOML: {reason}") from None


def _apply(override: str, tables: dict[str, Any]) -> None:
    """Sets one key of nested tables, in place, from "key.path=value"."""
    path, equals, text = override.partition("=")
    *parents, last = (part.strip() for part in path.split("."))
    if not equals or not all((*parents, last)):
        raise SceneError(f"{_shown(override)}: an override must read key.path=value")
    if any("\ud800" <= character <= "\udfff" for character in override):  # how Python passes on undecodable bytes
        raise SceneError(f"{path.strip()} = {_shown(text)}: must be UTF-8 text")
    table = tables
    for depth, parent in enumerate(parents, start=1):
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            above = ".".join(parents[:depth])
            raise SceneError(f"{path.strip()} = {_shown(text)}: cannot be set, as {above} is not a table")
    table[last] = _toml_value(text)


def _toml_value(text: str) -> object:
    """Returns what a text means as a TOML value, or the text itself where it means nothing."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return parsed["value"] if parsed.keys() == {"value"} else text


def _message(error: ValidationError) -> str:
    """Returns one line for each key that is wrong, up to a limit."""
    # Of a list with no good entry, pydantic also says that it is too short.
    found = error.errors(include_url=False)
    blamed_inside = {fault["loc"][:-1] for fault in found if fault["loc"]}
    faults = [fault for fault in found if fault["loc"] not in blamed_inside]
    lines = dict.fromkeys(_line(details) for details in faults[:_MAX_LINES])
    rest = [f"... and {len(faults) - _MAX_LINES} more"] if len(faults) > _MAX_LINES else []
    return "\n".join([*lines, *rest])


def _line(details: ErrorDetails) -> str:
    """Returns "key = value: what is allowed" for one fault that pydantic found or passed on."""
    key, known_here, allowed = _locate(details["loc"])
    value = details["input"]
    fault = details.get("ctx", {}).get("error")
    if isinstance(fault, AdmissibilityError):
        key, value, allowed = ".".join(filter(None, (key, fault.key))), fault.value, fault.allowed
    elif details["type"] == "extra_forbidden":
        allowed = unknown_key(str(details["loc"][-1]), known_here)
    elif details["type"] == "missing":
        value = None
    return f"{key} is missing: {allowed}" if value is None else f"{key} = {_shown(value)}: {allowed}"


def _locate(location: Sequence[int | str]) -> tuple[str, list[str], str]:
    """Follows a location through the schema.

    Returns:
        The dotted key, the keys known in the last table on the way, and what is allowed as its value. Parts that name a
        branch of a union and no key are left out.
    """
    key, known, allowed = "", list(Scene.model_fields), "must be a scene"
    annotation: Any = Scene
    for part in location:
        if isinstance(part, int):
            key += f"[{part}]"
        elif isinstance(annotation, type) and issubclass(annotation, Table):
            key += f".{spell_key(part)}"
            known = list(annotation.model_fields)
            field = annotation.model_fields.get(part)
            annotation = field.annotation if field else None
            allowed = f"must be {_describe(annotation, field.metadata)}" if field else ""
            allowed += f" ({field.description})" if field and field.description else ""
        elif get_origin(annotation) is dict:
            key += f".{spell_key(part)}"
            annotation = None
    return key.lstrip("."), known, allowed


def _describe(annotation: Any, metadata: Sequence[object]) -> str:
    """Returns in words which values the annotation and the constraints of a field allow."""
    kind, arguments = get_origin(annotation), get_args(annotation)
    if kind is Annotated:
        return _describe(arguments[0], [*arguments[1:], *metadata])
    if kind in (Union, types.UnionType):
        return _either([_describe(branch, metadata) for branch in arguments if branch is not types.NoneType])
    if kind is Literal:
        return _either([_shown(choice) for choice in arguments])
    words = [_WORDS.get(annotation, "a table")]
    if kind is tuple:
        shortest = next((it.min_length for it in metadata if isinstance(it, MinLen)), 0)
        longest = next(it.max_length for it in metadata if isinstance(it, MaxLen))
        words = [f"{_WORDS[arguments[0]]} or a list of {shortest} to {longest} of them"]
    elif isinstance(annotation, type) and issubclass(annotation, Table):
        words += [f"with the keys {', '.join(annotation.model_fields)}"]
    bounds = [
        f"{text} {getattr(it, name)}" for it in metadata for bound, name, text in _BOUNDS if isinstance(it, bound)
    ]
    units = [f"({it.symbol})" for it in metadata if isinstance(it, Unit)]
    return " ".join(filter(None, [*words, " and ".join(bounds), *units]))


def _either(choices: Sequence[str]) -> str:
    """Returns choices joined to "a, b or c"."""
    return " or ".join(filter(None, (", ".join(choices[:-1]), choices[-1])))


def _shown(value: object, *, nested: bool = False) -> str:
    """Returns a value much as TOML would spell it, cut to a readable length."""
    match value:
        case bool():
            text = str(value).lower()
        case str():
            text = json.dumps(value[:_MAX_SHOWN], ensure_ascii=not value.isprintable())
        case int() if value.bit_length() > _MAX_SHOWN * 4:
            text = hex(value)
        case list() | tuple() if not nested:
            text = f"[{', '.join(_shown(item, nested=True) for item in value[:_MAX_SHOWN])}]"
        case dict() if not nested:
            text = f"{{{', '.join(f'{spell_key(key)} = {_shown(item, nested=True)}' for key, item in value.items())}}}"
        case list() | tuple():
            text = "[...]"
        case dict():
            text = "{...}"
        case _:
            text = str(value)
    return text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "..."
