"""A scene's file and the keys that are set on the command line, as nested tables; nothing in them is evaluated."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from cosserat_fx.guard import bounded
from cosserat_fx.scenes.refusals import SceneError, line, shown
from cosserat_fx.scenes.schema import spell_key

_LONGEST_REASON: Final = 200
"""Characters of what the parser says that are passed on."""
MAX_DEPTH: Final = 20
"""Tables and lists that may be nested in each other."""
MAX_FILE_SIZE: Final = 10_000_000
"""Size above which a file is not taken for a scene, bytes."""


def read_tables(path: Path) -> dict[str, Any]:
    """Reads a TOML file.

    Raises:
        SceneError: it cannot be read, or is no TOML.
    """
    try:
        with path.open("rb") as file:
            content = file.read(MAX_FILE_SIZE + 1)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read as a scene file: {error.strerror}") from None
    if len(content) > MAX_FILE_SIZE:
        raise SceneError(f"{path}: must not be larger than {MAX_FILE_SIZE} bytes to be a scene file")
    try:
        with bounded(len(content)):
            return tomllib.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        number = content[: error.start].count(b"\n") + 1
        raise SceneError(f"{path}: must be UTF-8 text, but line {number} is not") from None
    except (MemoryError, TimeoutError, RecursionError):
        raise SceneError(f"{path}: not valid TOML: nested too deeply") from None
    except ValueError as error:
        reason = str(error)[:_LONGEST_REASON]
        raise SceneError(f"{path}: not valid TOML: {reason}") from None


def check_depth(tables: Mapping[str, object]) -> None:
    """Refuses tables and lists that are nested so deeply that nobody could have meant it.

    Raises:
        SceneError: they are.
    """
    for key, value in tables.items():
        layer = [value]
        for _ in range(MAX_DEPTH):
            inner = [it.values() if isinstance(it, dict) else it for it in layer if isinstance(it, dict | list | tuple)]
            layer = [it for items in inner for it in items]
        if layer:
            raise SceneError(
                line(spell_key(key), value, f"must not be nested more than {MAX_DEPTH} tables and lists deep")
            )


def apply_override(override: str, tables: dict[str, Any]) -> None:
    """Sets one key of nested tables, in place, from "key.path=value".

    Args:
        override: its value is read as a TOML value and, where it is none, as a bare string.
        tables: the scene so far.

    Raises:
        SceneError: it is written otherwise, or its path leads through something that is no table.
    """
    path, equals, text = override.partition("=")
    *parents, last = (part.strip() for part in path.split("."))
    if not equals or not all((*parents, last)):
        raise SceneError(f"{shown(override)}: an override must read key.path=value")
    if any("\ud800" <= character <= "\udfff" for character in override):  # how Python passes on undecodable bytes
        raise SceneError(line(path.strip(), text, "must be UTF-8 text"))
    table = tables
    for depth, parent in enumerate(parents, start=1):
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            above = ".".join(parents[:depth])
            raise SceneError(line(path.strip(), text, f"cannot be set, as {above[:_LONGEST_REASON]} is not a table"))
    table[last] = _toml_value(text)


def _toml_value(text: str) -> object:
    """Returns what a text means as a TOML value, or the text itself where it means nothing."""
    try:
        with bounded(len(text)):
            parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError, MemoryError, TimeoutError):
        return text
    return parsed["value"] if parsed.keys() == {"value"} else text
