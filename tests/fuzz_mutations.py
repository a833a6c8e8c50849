"""Strategies that break valid input: scenes as tables, as text and by overrides; and the files that scenes name."""

from __future__ import annotations

import copy
import datetime
import math
import os
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fuzz_bases import FIELD, LAYER, PLANE, Case, document, toml
from hypothesis import strategies as st
from scenes import Mutation, all_paths

DEMOS = Path(__file__).parents[1] / "demos"
PAYLOADS = (
    "__import__('os').system('touch executed')",
    "$(touch executed)",
    "`touch executed`",
    "; touch executed #",
    "!!python/object/apply:os.system ['touch executed']",
    "{{7*7}}",
    "{0.__class__.__init__.__globals__}",
    "%s%n%(executed)s",
    "../../../../etc/passwd",
    "/dev/zero",
    "\x1b[2J\x07",
    "\u202etxet\u0000",
    "a\nb",
)
NUMBERS = (
    *("0", "-0", "-1", "1e400", "-1e308", "5e-324", "1e-200", "nan", "inf", "-inf", "0.5", "3", "1e", "1979-05-27"),
    *("4294967296", "2147483647", "-2147483648", "9223372036854775807", "9223372036854775808", "18446744073709551615"),
    *("1e12", "1000000000000", "0x7fffffff", "1_000_000_000"),
)
TOKENS = (
    *PAYLOADS,
    *NUMBERS,
    *(
        "[",
        "]]",
        "{",
        "}",
        "=",
        ".",
        '"',
        "'''",
        "\n[geometry]\n",
        "\n[[initial.zones]]\n",
        "#",
        "[" * 3000,
        "a." * 3000,
    ),
    *("<!DOCTYPE a [<!ENTITY b 'c'>]>", "&b;", "</Piece>", "<![CDATA[", "$Nodes\n", "$EndNodes\n", "$NodeData\n"),
    *("\u00e9", "\ufeff", "9" * 5000, "x" * 70_000),
)
TEXT = st.text(st.characters(codec="utf-8"), max_size=12)
type Edit = tuple[str, int, bytes]


def edits(most: int = 4) -> st.SearchStrategy[list[Edit]]:
    """Some edits of bytes: what to do, where (a large number, taken modulo the length), and new bytes."""
    packed = [struct.pack(code, number) for code in ("<i", "<q") for number in (0, -1, 2**31 - 1, 7)]
    packed += [struct.pack("<d", number) for number in (math.nan, math.inf, 1e308, -1.0)]
    new = st.sampled_from([token.encode() for token in TOKENS] + packed) | st.binary(max_size=8)
    kinds = st.sampled_from(["flip", "cut", "drop", "insert", "overwrite", "repeat", "number"])
    return st.lists(st.tuples(kinds, st.integers(0, 2**32), new), min_size=1, max_size=most)


def edited(content: bytes, chosen: Sequence[Edit]) -> bytes:
    """Contents after some edits."""
    for kind, place, new in chosen:
        at = place % (len(content) + 1)
        size = 1 + place // 7 % 40
        match kind:
            case "flip" if at < len(content):
                content = content[:at] + bytes([content[at] ^ (1 << place % 8)]) + content[at + 1 :]
            case "cut":
                content = content[:at]
            case "drop":
                content = content[:at] + content[at + size :]
            case "insert":
                content = content[:at] + new + content[at:]
            case "overwrite":
                content = content[:at] + new + content[at + len(new) :]
            case "repeat":
                content = content[:at] + content[at : at + size] * 3 + content[at + size :]
            case "number" if found := list(re.finditer(rb"-?\d+(\.\d+)?(e[-+]?\d+)?", content)):
                start, end = found[place % len(found)].span()
                others = [*NUMBERS, *(found[place // 13 % len(found)][0].decode() for _ in NUMBERS)]
                content = content[:start] + others[place // 11 % len(others)].encode() + content[end:]
    return content


def junk() -> st.SearchStrategy[object]:
    """Values that belong nowhere."""
    numbers = st.integers() | st.floats() | st.sampled_from([0, 1, -1, 10**30, 2**63, 10**400, 1e308, -1e308, 5e-324])
    text = TEXT | st.sampled_from([*PAYLOADS, "auto", "mesh", "layer", "x" * 5000])
    days = st.sampled_from([datetime.date(1979, 5, 27), datetime.time(7, 32), datetime.datetime(1979, 5, 27, 7, 32)])
    scalars = st.booleans() | numbers | text | days
    keys = TEXT | st.sampled_from(PAYLOADS)
    nested = st.recursive(scalars, lambda it: st.lists(it, max_size=4) | st.dictionaries(keys, it, max_size=3))
    return nested | st.lists(numbers, max_size=300) | st.builds(_buried, scalars, st.integers(1, 400))


def alike(value: object) -> st.SearchStrategy[object]:
    """Values of the same type as another one, of any size, and lists of it; what only a look at the meaning refuses."""
    match value:
        case bool():
            return st.booleans()
        case int():
            sizes = st.sampled_from([0, 1, 2, 3, 7, 100, 10**4, 10**6, 10**9, 2**31 - 1, 2**31, 2**63 - 1, -1, 10**30])
            return sizes | st.integers(0, 60)
        case float():
            factors = st.sampled_from([0.0, -1.0, 0.5, 0.999, 1.001, 2.0, 10.0, 1e-3, 1e3, 1e-12, 1e12, 1e-200, 1e200])
            sizes = st.sampled_from([0.0, -0.0, 5e-324, -1e308, 1e308, 1e-300, math.inf, math.nan])
            return factors.map(lambda factor: value * factor) | sizes | st.floats()
        case list() if value and not isinstance(value[0], dict):
            return st.lists(alike(value[0]), max_size=5)
        case str():
            choices = ["auto", "stable", "primary", "none", "cosserat", "Q1R", "Q2Q1", "P1", "force1", "u2", "w"]
            places = ["left", "right", "bottom", "top", "centre", "ends", "field.csv", "scene.toml", ".", "/dev/zero"]
            return st.sampled_from(choices + places)
        case _:
            return junk()


def slightly_changed(base: Mapping[str, Any]) -> st.SearchStrategy[dict[str, Any]]:
    """A scene's tables with one to four values replaced by some of the same type."""
    places = [path for path in all_paths(dict(base)) if not isinstance(_at(base, path), dict)]
    change_one = st.sampled_from(places).flatmap(
        lambda path: st.tuples(st.just(path), st.just(""), alike(_at(base, path)))
    )
    several = st.lists(change_one, min_size=1, max_size=4)
    return several.map(lambda chosen: changed_tables(base, chosen, drop=False))


def _at(tables: Any, path: Sequence[str | int]) -> Any:
    for part in path:
        tables = tables[part]
    return tables


def _buried(value: object, depth: int) -> object:
    for level in range(depth):
        value = [value] if level % 2 else {"a": value}
    return value


def changes(base: Mapping[str, Any]) -> st.SearchStrategy[list[Mutation]]:
    """Up to three places in a scene's tables, each with another key beside it (or none) and a value."""
    paths = all_paths(dict(base))
    keys = st.sampled_from([str(path[-1]) for path in paths]) | TEXT | st.sampled_from(PAYLOADS)
    return st.lists(st.tuples(st.sampled_from(paths), st.just("") | keys, junk()), min_size=1, max_size=3)


def changed_tables(base: Mapping[str, Any], chosen: Sequence[Mutation], *, drop: bool) -> dict[str, Any]:
    """A scene's tables with values put at some places, or the places taken away."""
    tables = copy.deepcopy(dict(base))
    for path, extra, value in chosen:
        inside: Any = tables
        for part in path[:-1]:
            inner = dict(inside.items() if isinstance(inside, dict) else enumerate(inside)).get(part)
            inside = inner if isinstance(inner, dict | list) else inside
        if isinstance(inside, list) and isinstance(path[-1], int) and path[-1] < len(inside) and not drop:
            inside[path[-1]] = value
        elif isinstance(inside, list):
            inside.append(value)
        elif drop:
            inside.pop(str(path[-1]), None)
        else:
            inside[extra or str(path[-1])] = value
    return tables


def scene_cases() -> st.SearchStrategy[Case]:
    """Scenes without a mesh file: mutated as tables, as text or by overrides, and raw bytes."""
    bases = st.sampled_from([LAYER, PLANE])
    broken = bases.flatmap(lambda base: st.builds(changed_tables, st.just(base), changes(base), drop=st.booleans()))
    tables = broken | bases.flatmap(slightly_changed)
    files = [document(LAYER), document(PLANE), *(file.read_bytes() for file in sorted(DEMOS.glob("*.toml")))]
    texts = st.builds(edited, st.sampled_from(files), edits())
    raw = st.binary(max_size=200) | st.text(st.characters(codec="utf-8"), max_size=200).map(str.encode)
    contents = st.integers(0, 9).flatmap(lambda tenth: tables.map(document) if tenth > 3 else texts if tenth else raw)
    return st.one_of(
        contents.map(lambda content: Case({"scene.toml": content, "field.csv": FIELD})),
        st.builds(
            lambda base, given: Case({"scene.toml": document(base), "field.csv": FIELD}, given),
            bases,
            st.lists(overrides(), min_size=1, max_size=3),
        ),
    )


def overrides() -> st.SearchStrategy[str]:
    """What may stand after --set: a key and a value, one of them or both wrong, or neither."""
    paths = [".".join(map(str, path)) for base in (LAYER, PLANE) for path in all_paths(base)]
    keys = st.sampled_from(paths) | st.text(max_size=12) | st.sampled_from(PAYLOADS)
    words = st.sampled_from([*TOKENS, *NUMBERS]) | junk().map(toml) | st.text(max_size=12)
    whole = st.builds(lambda key, value: f"{key}={value}", keys, words)
    # An argument is a C string of bytes that Python decodes, with surrogates for what is no UTF-8.
    return (whole | st.text(max_size=20)).map(
        lambda text: os.fsdecode(text.replace("\0", "").encode("utf-8", "surrogatepass"))
    )


def file_cases(bases: Mapping[str, Case]) -> st.SearchStrategy[Case]:
    """Scenes with a file beside them: that file edited or replaced by raw bytes."""
    raw = st.binary(max_size=200).map(_raw)
    replacements = st.integers(0, 9).flatmap(lambda tenth: edits(3).map(_editor) if tenth else raw)
    return st.sampled_from(sorted(bases)).flatmap(
        lambda kind: st.builds(_with_file, st.just(bases[kind]), replacements)
    )


def _editor(chosen: Sequence[Edit]) -> Callable[[bytes], bytes]:
    return lambda content: edited(content, chosen)


def _raw(new: bytes) -> Callable[[bytes], bytes]:
    return lambda content: new


def _with_file(base: Case, replace: Callable[[bytes], bytes]) -> Case:
    return Case({name: content if name == "scene.toml" else replace(content) for name, content in base.files.items()})
