"""Messages about a scene that is refused: a line for each fault, with its key, its value and what is allowed."""

import json
import types
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic import BeforeValidator, Tag, ValidationError
from pydantic_core import ErrorDetails

from cosserat_fx.material import AdmissibilityError
from cosserat_fx.scenes.schema import Table, Unit, list_as_tuple, spell_key, unknown_key
from cosserat_fx.text import printable

_MAX_LINES: Final = 20
"""Number of faults told at once."""
_MAX_KEY: Final = 200
"""Number of characters of a key that are told."""
_MAX_SHOWN: Final = 60
"""Number of characters of a value repeated in a message."""

_WORDS: Final = {float: "a finite number", int: "a whole number", str: "a string", bool: "true or false"}
_PLURALS: Final = {float: "finite numbers", int: "whole numbers"}
_BOUNDS: Final = ((Gt, "gt", "greater than"), (Ge, "ge", "of at least"), (Lt, "lt", "less than"), (Le, "le", "at most"))
_INSTEAD: Final = {"walls": "; plane bodies have boundaries", "boundaries": "; a layer has walls"}


class SceneError(ValueError):
    """A scene that cannot be used. Each line of the message names a key, its value and what is allowed."""

    def __init__(self, message: str) -> None:
        """Keeps the message, with what cannot be printed spelled out."""
        super().__init__(printable(message, keep="\n"))


def refusal(error: ValidationError, kind: str, kinds: Mapping[str, type[Table]]) -> SceneError:
    """Returns one line for each key that is wrong, up to a limit.

    Args:
        error: what pydantic found.
        kind: the scene's `geometry.kind`.
        kinds: all kinds of scenes by `geometry.kind`.
    """
    # Of a list with no good entry, pydantic also says that it is too short.
    found = error.errors(include_url=False)
    blamed_inside = {fault["loc"][:-1] for fault in found if fault["loc"]}
    faults = [fault for fault in found if fault["loc"] not in blamed_inside]
    lines = dict.fromkeys(_line(details, kinds[kind], kinds) for details in faults[:_MAX_LINES])
    rest = [f"... and {len(faults) - _MAX_LINES} more"] if len(faults) > _MAX_LINES else []
    return SceneError("\n".join([*lines, *rest]))


def scene_error(error: AdmissibilityError) -> SceneError:
    """Returns what stands behind a scene that turned out to be inadmissible later on, in the form of a refusal."""
    return SceneError(line(error.key, error.value, error.allowed))


def line(key: str, value: object, allowed: str) -> str:
    """Returns "key = value: what is allowed"; a value of None is one that is missing."""
    name = key if len(key) <= _MAX_KEY else key[:_MAX_KEY] + "..."
    return printable(f"{name} is missing: {allowed}" if value is None else f"{name} = {shown(value)}: {allowed}")


def _line(details: ErrorDetails, scene: type[Table], kinds: Mapping[str, type[Table]]) -> str:
    """Returns the line of one fault that pydantic found or passed on."""
    path, known_here, allowed = _locate(details["loc"], scene)
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{spell_key(part)}" for part in path).lstrip(".")
    value = details["input"]
    fault = details.get("ctx", {}).get("error")
    if isinstance(fault, AdmissibilityError):
        key, value, allowed = ".".join(filter(None, (key, fault.key))), fault.value, fault.allowed
    elif details["type"] == "extra_forbidden":
        name = str(path[-1])
        elsewhere = [kind for kind, other in kinds.items() if _knows(other, kind, path)]
        allowed = unknown_key(name, known_here)
        if elsewhere:
            allowed = (
                f"must be left out, as only geometry.kind = {either([shown(it) for it in elsewhere])} has this key"
            )
            allowed += f"{_INSTEAD.get(name, '')}. The keys here are {', '.join(known_here)}"
    elif details["type"] == "missing":
        value = None
    return line(key, value, allowed)


def _locate(location: Sequence[int | str], scene: type[Table]) -> tuple[list[int | str], list[str], str]:
    """Follows a location through the schema of a scene.

    Returns:
        The keys on the way, without parts that only name a branch of a union, the keys known in the last table on the
        way, and what is allowed as the value.
    """
    path: list[int | str] = []
    known: list[str] = list(scene.known_keys())
    annotation: Any = scene
    allowed = "must be a scene"
    for part in location:
        branches = _branches(annotation)
        tagged = [branch for branch in branches if Tag(part) in _metadata(branch)] if isinstance(part, str) else []
        if tagged:
            annotation = tagged[0]
            continue
        tables = [_bare(branch) for branch in branches if _is_table(branch)]
        inner = _inside(branches, part)
        if inner is None and not tables:
            continue  # a branch of a union of scalars
        path.append(part)
        if tables:
            known = [key for table in tables for key in table.known_keys()]
            allowed = "" if inner is None else f"must be {_describe(inner)}"
        elif isinstance(part, str) or _is_table(inner):
            allowed = f"must be {_describe(inner)}"
        annotation = inner
    return path, known, allowed


def _knows(scene: type[Table], kind: str, path: Sequence[int | str]) -> bool:
    """Returns whether a scene with a kind of geometry has a key."""
    annotation: Any = scene
    for part in path:
        branches = _branches(annotation)
        annotation = _inside([it for it in branches if Tag(kind) in _metadata(it)] or branches, part)
    return annotation is not None


def _inside(branches: Sequence[Any], part: int | str) -> Any:
    """Returns the annotation of what a table, dictionary or list holds there, or None where it holds no such thing."""
    for branch in branches:
        bare = _bare(branch)
        arguments = get_args(bare)
        if _is_table(branch) and part in bare.known_keys():
            return bare.known_keys()[part]
        if get_origin(bare) is dict and isinstance(part, str):
            return arguments[1]
        if get_origin(bare) is tuple and isinstance(part, int):
            return arguments[0]
    return None


def _bare(annotation: Any) -> Any:
    """Returns an annotation without its metadata."""
    return get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation


def _metadata(annotation: Any) -> tuple[Any, ...]:
    return get_args(annotation)[1:] if get_origin(annotation) is Annotated else ()


def _branches(annotation: Any) -> list[Any]:
    """Returns what a union allows, or the annotation alone."""
    bare = _bare(annotation)
    if get_origin(bare) not in (Union, types.UnionType):
        return [annotation]
    return [it for branch in get_args(bare) if branch is not types.NoneType for it in _branches(branch)]


def _is_table(annotation: Any) -> bool:
    bare = _bare(annotation)
    return isinstance(bare, type) and issubclass(bare, Table)


def _describe(annotation: Any, outer: Sequence[object] = ()) -> str:
    """Returns in words which values an annotation allows, with constraints stated further out."""
    bare, metadata = _bare(annotation), [*_metadata(annotation), *outer]
    kind, arguments = get_origin(bare), get_args(bare)
    units = [f"({it.symbol})" for it in metadata if isinstance(it, Unit)]
    if kind in (Union, types.UnionType):
        branches = [branch for branch in arguments if branch is not types.NoneType]
        inner = [it for it in metadata if not isinstance(it, Unit)]
        return " ".join([either([_describe(branch, inner) for branch in branches]), *units])
    if kind is Literal:
        return either([shown(choice) for choice in arguments])
    words = [_WORDS.get(bare, "a table")]
    if kind is tuple:
        words = [_describe_list(arguments, metadata)]
        metadata = [*_metadata(arguments[0]), *metadata]
    elif _is_table(bare):
        words += [f"with the keys {', '.join(bare.known_keys())}"]
    bounds = [
        f"{text} {getattr(it, name)}" for it in metadata for bound, name, text in _BOUNDS if isinstance(it, bound)
    ]
    return " ".join(filter(None, [*words, " and ".join(bounds), *units]))


def _describe_list(items: Sequence[Any], metadata: Sequence[object]) -> str:
    """Returns in words which lists a tuple stands for."""
    item = _bare(items[0])
    if Ellipsis not in items:
        return f"a list of {len(items)} {_PLURALS[item]}"
    shortest = next((it.min_length for it in metadata if isinstance(it, MinLen)), 0)
    longest = next(it.max_length for it in metadata if isinstance(it, MaxLen))
    if not any(isinstance(it, BeforeValidator) and it.func is list_as_tuple for it in metadata):
        return f"{_WORDS[item]} or a list of {shortest} to {longest} of them"
    if _is_table(item):
        return f"a list of tables with the keys {', '.join(item.known_keys())}"
    return f"a list of {shortest} to {longest} {_PLURALS[item]}"


def either(choices: Sequence[str]) -> str:
    """Returns choices joined to "a, b or c"."""
    return " or ".join(filter(None, (", ".join(choices[:-1]), choices[-1])))


def shown(value: object, *, nested: bool = False) -> str:
    """Returns a value much as TOML would spell it, cut to a readable length."""
    match value:
        case bool():
            text = str(value).lower()
        case str():
            text = json.dumps(value[:_MAX_SHOWN], ensure_ascii=not value.isprintable())
        case int() if value.bit_length() > _MAX_SHOWN * 4:
            text = hex(value)
        case list() | tuple() if not nested:
            text = f"[{', '.join(shown(item, nested=True) for item in value[:_MAX_SHOWN])}]"
        case dict() if not nested:
            text = f"{{{', '.join(f'{spell_key(key)} = {shown(item, nested=True)}' for key, item in value.items())}}}"
        case Table():
            text = shown(value.model_dump(mode="json", exclude_defaults=True), nested=nested)
        case list() | tuple():
            text = "[...]"
        case dict():
            text = "{...}"
        case _:
            text = str(value)
    return text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "..."
