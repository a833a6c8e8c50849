"""Scenes as nested tables: changed key by key, written as TOML, filled with junk."""

import copy
import json
import pathlib
from collections.abc import Mapping
from typing import Any

from hypothesis import strategies as st

from cosserat_fx.scene import PlaneScene, SceneError, parse_scene

ABSENT = object()
RECTANGLE: dict[str, Any] = {
    "geometry": {"kind": "rectangle", "width": 0.04, "height": 0.14, "cells": [4, 14]},
    "initial": {"stress": -100e3, "void_ratio": 0.6},
    "boundaries": {
        "bottom": {"u2": 0.0},
        "top": {"u2": -0.01},
        "left": {"pressure": 100e3},
        "right": {"pressure": 100e3},
    },
    "points": {"pin": {"at": [0.0, 0.0], "u1": 0.0}},
}
"""Biaxial compression, with next to nothing but what has to be given."""
LAYER: dict[str, Any] = {
    "geometry": {"height": 0.04, "cells": 80},
    "initial": {"stress": -100e3, "void_ratio": 0.6},
    "walls": {"top": {"normal_stress": -100e3, "shear_displacement": 0.03}},
}
"""A layer, with next to nothing but what has to be given."""
FRACTIONS = {"f_u": 0.8, "f_r": 0.15, "f_s": 0.05}

type Path = tuple[str | int, ...]


def change(base: dict[str, Any], changes: Mapping[str, object]) -> dict[str, Any]:
    """A copy with keys, given in dotted form, set or (ABSENT) taken away."""
    tables = copy.deepcopy(base)
    for path, value in changes.items():
        *parents, last = path.split(".")
        table = tables
        for parent in parents:
            table = table.setdefault(parent, {})
        if value is ABSENT:
            table.pop(last, None)
        else:
            table[last] = copy.deepcopy(value)
    return tables


def changed_layer(changes: Mapping[str, object]) -> dict[str, Any]:
    """The least scene of a layer with some keys changed."""
    return change(LAYER, changes)


def to_toml(table: dict[str, Any], prefix: str = "") -> str:
    """Nested tables of numbers, truth values, strings and lists of them and of tables as TOML."""
    plain = {key: value for key, value in table.items() if not isinstance(value, dict)}
    text = "".join(f"{json.dumps(key)} = {_inline(value)}\n" for key, value in plain.items())
    for key in [key for key in table if key not in plain]:
        text += f"[{prefix}{json.dumps(key)}]\n" + to_toml(table[key], f"{prefix}{json.dumps(key)}.")
    return text


def _inline(value: object) -> str:
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(key)} = {_inline(inner)}' for key, inner in value.items())}}}"
    return f"[{', '.join(_inline(item) for item in value)}]" if isinstance(value, list) else json.dumps(value)


def all_paths(inside: dict[str, Any] | list[Any], above: Path = ()) -> list[Path]:
    """The path of every table, key and entry."""
    paths: list[Path] = []
    for key, value in inside.items() if isinstance(inside, dict) else enumerate(inside):
        paths.append((*above, key))
        if isinstance(value, dict | list):
            paths += all_paths(value, (*above, key))
    return paths


Mutation = tuple[Path, str, object]


def mutations(complete: dict[str, Any]) -> st.SearchStrategy[list[Mutation]]:
    """Up to three paths of a complete scene, each with junk for it, or for another key beside it."""
    paths = all_paths(complete)
    keys = st.sampled_from([str(path[-1]) for path in paths]) | st.text()
    numbers = st.integers() | st.floats() | st.sampled_from([0, 1, -1, 10**400, 1e308, -1e308, 5e-324])
    words = st.sampled_from(["macro", "none", "paper-sand", "layer", "rectangle", "mesh", "top"])
    scalars = st.none() | st.booleans() | numbers | st.text() | st.dates() | words
    junk = st.recursive(scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(keys, inner, max_size=4))
    return st.lists(st.tuples(st.sampled_from(paths), keys | st.just(""), junk), min_size=1, max_size=3)


def assert_scene_or_clear_refusal(complete: dict[str, Any], chosen: list[Mutation]) -> None:
    """What is left of a scene with junk in it is one that survives a round trip, or is refused in the usual form."""
    tables = copy.deepcopy(complete)
    for path, extra, junk in chosen:
        inside: Any = tables
        for part in path[:-1]:
            inner = dict(inside.items() if isinstance(inside, dict) else enumerate(inside)).get(part)
            inside = inner if isinstance(inner, dict | list) else inside
        if isinstance(inside, dict):
            inside[extra or str(path[-1])] = junk
        else:
            inside.append(junk)
    refusal = "none: the scene is valid"
    try:
        scene = parse_scene(tables)
    except SceneError as error:
        refusal = str(error)
    else:
        assert parse_scene(json.loads(json.dumps(scene.as_dict()))) == scene
    assert "pydantic" not in refusal
    assert all(": " in line for line in refusal.splitlines() if not line.startswith("... and "))


def changed(changes: Mapping[str, object]) -> dict[str, Any]:
    """The least scene of a rectangle with some keys changed."""
    return change(RECTANGLE, changes)


def parse_plane(tables: Mapping[str, object], folder: pathlib.Path = pathlib.Path()) -> PlaneScene:
    scene = parse_scene(tables, folder)
    assert isinstance(scene, PlaneScene)
    return scene
