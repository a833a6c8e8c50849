"""The page docs/scene.md tells every key of a scene with its type, unit, range and default."""

import contextlib
import re
import tomllib
from collections.abc import Iterator
from dataclasses import fields
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
import pages
import pytest
from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic.fields import FieldInfo

from cosserat_fx import audit, numerics
from cosserat_fx.elements import DEFAULT
from cosserat_fx.material import NAMED_SETS, Material, MaterialError
from cosserat_fx.scene import DEFAULT_SET, LayerScene, PlaneScene, Scene, parse_scene
from cosserat_fx.scenes.histories import Meaning
from cosserat_fx.scenes.layer import Leg, default_profiles
from cosserat_fx.scenes.plane import RECTANGLE_BOUNDARIES, RectangleGeometry
from cosserat_fx.scenes.schema import Table, Unit

WORDS = {float: "number", int: "integer", str: "text", bool: "true or false", tuple: "number or list", dict: "table"}
KINDS: dict[str, type[Scene]] = {"layer": LayerScene, "rectangle": PlaneScene, "mesh": PlaneScene}
HEADINGS = {"layer": ("layer",), "plane body": ("rectangle", "mesh"), "rectangle": ("rectangle",), "mesh": ("mesh",)}


def flat(annotation: Any, metadata: list[Any]) -> tuple[list[Any], list[Any]]:
    """The types and literals that an annotation allows, and all metadata on the way."""
    kind, arguments = get_origin(annotation), get_args(annotation)
    if kind is Annotated:
        return flat(arguments[0], [*arguments[1:], *metadata])
    if kind in (Union, UnionType):
        branches = [flat(branch, []) for branch in arguments if branch is not NoneType]
        return [it for types, _ in branches for it in types], metadata + [it for _, found in branches for it in found]
    if kind is Literal:
        return list(arguments), metadata
    return [annotation if kind is tuple and Ellipsis not in arguments else kind or annotation], metadata


def bounds_of(key: str, metadata: list[Any]) -> str:
    """The bounds of a number as the page spells them."""
    lower = [
        (it.gt, "<", ">") if isinstance(it, Gt) else (it.ge, "<=", ">=") for it in metadata if isinstance(it, Gt | Ge)
    ]
    upper = [(it.lt, "<") if isinstance(it, Lt) else (it.le, "<=") for it in metadata if isinstance(it, Lt | Le)]
    if lower and upper:
        return f"`{lower[0][0]:_} {lower[0][1]} {key} {upper[0][1]} {upper[0][0]:_}`"
    if lower or upper:
        return f"`{key} {lower[0][2]} {lower[0][0]}`" if lower else f"`{key} {upper[0][1]} {upper[0][0]}`"
    return ""


def described(key: str, field: FieldInfo) -> tuple[str, str, str]:
    """Type, unit and allowed values of a key as the page spells them."""
    allowed, metadata = flat(field.annotation, field.metadata)
    literals = [it for it in allowed if isinstance(it, str)]
    (unit,) = [it.symbol.split(",")[0] for it in metadata if isinstance(it, Unit)][-1:] or [""]
    if literals:
        kind = "text, true or false" if bool in allowed else "text"
        choices = [f'`"{it}"`' for it in literals] + (["`true`", "`false`"] if bool in allowed else [])
        if float in allowed:
            kind, choices = "text or number", [*choices, bounds_of(key, metadata)]
        return kind, unit, ", ".join(choices)
    if any(isinstance(it, Meaning) for it in metadata):
        return "history", unit, ""
    if get_origin(allowed[0]) is tuple:
        items = get_args(allowed[0])
        ((item,), constraints) = flat(items[0], [])
        bounds = bounds_of(key, constraints)
        return "list", unit, f"{len(items)} {WORDS[item]}s{f', each {bounds}' if bounds else ''}"
    if allowed[0] is tuple:
        least = sum(it.min_length for it in metadata if isinstance(it, MinLen))
        bounds = f"{least} to {sum(it.max_length for it in metadata if isinstance(it, MaxLen)):_} numbers"
    elif allowed[0] is dict:
        bounds = "text, true, false and numbers"
    else:
        bounds = bounds_of(key, metadata)
    return WORDS[allowed[0]], unit, bounds


def tables_in(annotation: Any, kind: str) -> list[tuple[type[Table], str]]:
    """The tables that a key holds in a scene of a kind, each with what its heading adds to the key."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:  # a history is no table, though it may be spelled as one
        return [] if any(isinstance(it, Meaning) for it in arguments[1:]) else tables_in(arguments[0], kind)
    if origin is dict:
        return [(table, ".NAME") for table, _ in tables_in(arguments[1], kind)]
    if origin in (Union, UnionType, tuple):
        return [found for branch in arguments if branch is not Ellipsis for found in tables_in(branch, kind)]
    if not isinstance(annotation, type) or not issubclass(annotation, Table):
        return []
    kinds = get_args(annotation.model_fields["kind"].annotation) if "kind" in annotation.model_fields else (kind,)
    return [(annotation, "")] if kind in kinds else []


def schema(table: type[Table], kind: str, path: str = "") -> Iterator[tuple[str, str, FieldInfo]]:
    """All keys of a scene of a kind but the material's, each with the path of its table."""
    for key, field in table.model_fields.items():
        inner = tables_in(table.known_keys()[key], kind)
        for below, suffix in inner:
            yield from schema(below, kind, f"{path}.{key}{suffix}".lstrip("."))
        if not inner and key != "material":
            yield path, key, field


def told_keys(kind: str) -> dict[tuple[str, str], list[str]]:
    """Rows of the page on a kind of scene by table and key, without the key; a heading may name two tables."""
    rows: dict[tuple[str, str], list[str]] = {}
    for heading, row in pages.rows("docs/scene.md"):
        paths = [""] if heading.startswith("Before the first table") else re.findall(r"\[([\w.]+)\]", heading)
        alone = re.search(r" of a (layer|plane body|rectangle|mesh)", heading)
        if row[0] != "key" and (alone is None or kind in HEADINGS[alone[1]]):
            rows |= {(path, row[0].strip("`")): row[1:] for path in paths}
    return rows


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_of_a_scene_is_told_with_type_unit_and_range(kind: str) -> None:
    told = {at: row for at, row in told_keys(kind).items() if at[0] != "material"}
    known = {(path, key): described(key, field) for path, key, field in schema(KINDS[kind], kind)}
    assert {at: (row[0], row[1], row[3]) for at, row in told.items()} == known


@pytest.mark.parametrize("kind", KINDS)
def test_every_default_of_a_scene_is_told(kind: str) -> None:
    told = told_keys(kind)
    for path, key, field in schema(KINDS[kind], kind):
        cell = told[path, key][2]
        if field.is_required() or field.get_default(call_default_factory=True) is None:
            assert cell == ("required" if field.is_required() else "—"), key
        else:
            default = field.get_default(call_default_factory=True)
            value = tomllib.loads(f"value = {cell.strip('`')}")["value"]
            assert default == ((value,) if isinstance(default, tuple) else value), key


def test_the_example_of_a_plane_scene_is_one() -> None:
    (block,) = pages.blocks("docs/scene.md", "toml")
    scene = parse_scene(tomllib.loads(block))
    assert isinstance(scene, PlaneScene)
    assert isinstance(scene.geometry, RectangleGeometry)
    assert scene.output.columns["axial_stress_Pa"].factor == -1 / scene.geometry.width


def test_the_boundaries_of_a_rectangle_are_told() -> None:
    named = ", ".join(f"`{name}`" for name in list(RECTANGLE_BOUNDARIES)[:-1])
    assert f"A rectangle has {named} and `{list(RECTANGLE_BOUNDARIES)[-1]}`" in pages.words("docs/scene.md")


def test_the_default_elements_are_told() -> None:
    told = f'`"auto"` is `"{DEFAULT["quadrilateral"]}"` or `"{DEFAULT["triangle"]}"`, by the cells of the mesh.'
    assert told in pages.words("docs/scene.md")


def test_the_constants_are_told_with_range_and_default() -> None:
    """The ranges are expressions, tried on both sides of every bound: page and class allow the same values."""
    told = {key: row for (path, key), row in told_keys("layer").items() if path == "material"}
    assert told.pop("constants")[2:4] == [f'`"{DEFAULT_SET}"`', ", ".join(f'`"{name}"`' for name in NAMED_SETS)]
    names = [field.name for field in fields(Material)]
    assert list(told) == names
    base = {name: float(getattr(NAMED_SETS[DEFAULT_SET], name)) for name in names}
    assert {name: float(row[2].strip("`")) for name, row in told.items()} == base
    *rules, last = sorted((row[3].strip("`") for row in told.values()), key=lambda rule: "h_i" in rule)
    assert "h_i" in last
    for name in names:
        for value in (-1.0, 0.0, 0.12, 0.2, 0.51, 0.7, 0.82, 0.9, 1.0, 1.2, 1.3, 30.0, 89.9, 90.0, 91.0):
            values = base | {name: value}
            fair = all(eval(rule, {}, values) for rule in rules) and eval(last, {}, values | {"h_i": bracket(**values)})
            with contextlib.nullcontext() if fair else pytest.raises(MaterialError):
                Material(**values)


def bracket(e_i0: float, e_d0: float, e_c0: float, phi_c: float, alpha: float, **_: float) -> float:
    """h_i as the theory page has it."""
    sine = np.sin(np.radians(phi_c))
    a_0 = np.sqrt(8 / 3) * sine / (3 - sine)
    return float(a_0**2 + 1 / 3 - ((e_i0 - e_d0) / (e_c0 - e_d0)) ** alpha * a_0 / np.sqrt(3))


def test_numbers_in_the_prose_of_the_scene_page() -> None:
    page = pages.words("docs/scene.md")
    assert f"differ by more than {100 * numerics.LARGE_DISPLACEMENT:g} % of the body's smallest extent" in page
    assert f"warns if shear strains exceeded {100 * audit.FAIR_SMALL_STRAIN:g} %" in page
    assert "By default 10 %, 1/3, 2/3 and all of a path of one leg, or the ends of the legs." in page
    assert default_profiles((Leg(3.0, 0.0),)) == pytest.approx((0.3, 1.0, 2.0, 3.0))
    assert default_profiles((Leg(3.0, 0.0), Leg(1.0, 0.0))) == (3.0, 1.0)
