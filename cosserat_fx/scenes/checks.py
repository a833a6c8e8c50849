"""What the tables of a plane scene ask of each other: names that exist, places in the body, a path that leads on.

Each check raises `AdmissibilityError` with the key from the top of the scene.
"""

import re
from bisect import bisect
from collections.abc import Mapping, Sequence
from math import isfinite

from cosserat_fx.material import AdmissibilityError
from cosserat_fx.results import BOUNDARY_COLUMNS, PLANE_COLUMNS
from cosserat_fx.scenes.histories import Given, History, HistoryTable, Meaning
from cosserat_fx.scenes.plane import RECTANGLE_BOUNDARIES, Boundary, BoundaryWall, Column, Point, RectangleGeometry
from cosserat_fx.scenes.registry import IDENTIFIER
from cosserat_fx.scenes.schema import MAX_NAMED, ROUNDING, Table, spell_key


def check_number(**tables: Mapping[str, Table]) -> None:
    """Refuses more boundaries or points, by these keys, than a scene may have."""
    for key, named in tables.items():
        if len(named) > MAX_NAMED:
            raise AdmissibilityError(key, len(named), f"must not be more than {MAX_NAMED}")


def check_points(points: Mapping[str, Point], geometry: RectangleGeometry) -> None:
    """Refuses points outside a rectangle."""
    for name, point in points.items():
        sizes = geometry.width, geometry.height
        if any(abs(at - size / 2) > (0.5 + ROUNDING) * size for at, size in zip(point.at, sizes, strict=True)):
            allowed = f"must lie in the rectangle, [0, 0] to [{geometry.width:g}, {geometry.height:g}] (m)"
            raise AdmissibilityError(f"points.{spell_key(name)}.at", point.at, allowed)


def check_boundaries(boundaries: Mapping[str, Boundary], *, rectangle: bool) -> None:
    """Refuses boundaries that a rectangle does not have, and what contradicts the direction of a boundary."""
    for name, boundary in boundaries.items():
        key = f"boundaries.{spell_key(name)}"
        if rectangle and name not in RECTANGLE_BOUNDARIES:
            _refuse_boundary(key, boundary.model_dump(mode="json", exclude_defaults=True))
        if not name.isprintable():
            raise AdmissibilityError(key, name, "must be named by characters that can be printed, as columns are too")
        normal = RECTANGLE_BOUNDARIES[name] if rectangle else None
        if boundary.wall:
            _check_wall(f"{key}.wall", boundary.wall, normal)
        if normal and boundary.pressure is not None and getattr(boundary, normal) is not None:
            allowed = f"must be left out where {normal} is given, the displacement normal to this boundary"
            raise AdmissibilityError(f"{key}.pressure", boundary.pressure, allowed)


def _refuse_boundary(key: str, value: object) -> None:
    allowed = f"must name a boundary of the rectangle: {', '.join(RECTANGLE_BOUNDARIES)}"
    raise AdmissibilityError(key, value, allowed)


def _check_wall(key: str, wall: BoundaryWall, normal: str | None) -> None:
    """Refuses motions of a wall that it does not pass on to the body."""
    if normal is None:
        idle = ["u1", "u2"] if wall.free and wall.pressure is not None else []
    else:
        along = "u1" if normal == "u2" else "u2"
        idle = [normal] * (wall.pressure is not None) + [along] * wall.free
    for component in idle:
        value = getattr(wall, component)
        if value != 0:
            allowed = (
                "must be 0: a wall's displacement is free along its normal under a pressure, and along it where free"
            )
            raise AdmissibilityError(f"{key}.{component}", value, f"{allowed} = true")


def check_columns(
    columns: Mapping[str, Column], boundaries: Mapping[str, Boundary], *, polar: bool, rectangle: bool
) -> None:
    """Refuses columns without a proper name of their own, and those of something that does not exist."""
    standard = {*PLANE_COLUMNS, *(f"{name}_{ending}" for name in boundaries for ending in BOUNDARY_COLUMNS.values())}
    for name, column in columns.items():
        key = f"output.columns.{spell_key(name)}"
        if not re.fullmatch(IDENTIFIER, name):
            allowed = "must have a name of letters, digits and underscores, beginning with a letter"
            raise AdmissibilityError(key, column, allowed)
        if name in standard:
            raise AdmissibilityError(key, column, "must have another name, as every history has a column of this one")
        if rectangle and column.boundary not in RECTANGLE_BOUNDARIES:
            _refuse_boundary(f"{key}.boundary", column.boundary)
        if column.quantity in ("w", "couple") and not polar:
            allowed = "must be another one where effects.polar = false, as there are no rotations and couples"
            raise AdmissibilityError(f"{key}.quantity", column.quantity, allowed)


def check_rotations_exist(boundaries: Mapping[str, Boundary], points: Mapping[str, Point], *, polar: bool) -> None:
    """Refuses rotations, couples and resistances other than 0 in a continuum without rotations."""
    if polar:
        return
    given: dict[str, object] = {f"points.{spell_key(name)}.w": point.w for name, point in points.items()}
    for name, boundary in boundaries.items():
        key = f"boundaries.{spell_key(name)}"
        given |= {f"{key}.{it}": getattr(boundary, it) for it in ("w", "couple", "rotational_resistance")}
        if boundary.wall:
            boundary.wall.check_rotation_exists(f"{key}.wall", polar=polar)
    for key, value in given.items():
        if value not in (None, 0.0):
            allowed = "must be 0 or left out where effects.polar = false, as there are no rotations and couples"
            raise AdmissibilityError(key, value, allowed)


def check_something_happens(
    given: Sequence[Given], boundaries: Mapping[str, Boundary], *, weight: bool, stress: float
) -> None:
    """Refuses a scene without any motion or change of load.

    Args:
        given: all histories.
        boundaries: the boundaries; what the extensions among their keys do is not known, so they count as something.
        weight: whether the body has weight.
        stress: initial stress, which a pressure of the same size balances, Pa.
    """
    if weight or any(boundary.extensions for boundary in boundaries.values()):
        return
    for it in given:
        rest = -stress if it.key.endswith(".pressure") else 0.0
        if any(value != rest for value in _values(it.history)):
            return
    tables = {name: boundary.model_dump(mode="json", exclude_defaults=True) for name, boundary in boundaries.items()}
    allowed = "must prescribe a displacement or rotation other than 0, or a load that does not balance initial.stress"
    raise AdmissibilityError("boundaries", tables or None, f"{allowed}: nothing would happen")


def check_path_is_finite(given: Sequence[Given], travel: float) -> None:
    """Refuses displacements so large that the path has no finite length.

    Args:
        given: all histories.
        travel: length of the path, m.
    """
    if not isfinite(travel):
        largest = max(given, key=lambda it: max(abs(value) for value in _values(it.history)))
        raise AdmissibilityError(largest.key, largest.history, "must be smaller, as the path has no finite length")


def _values(history: History) -> tuple[float, ...]:
    if isinstance(history, HistoryTable):
        return history.value
    return history if isinstance(history, tuple) else (history,)


def displacement_groups(given: Sequence[Given], boundaries: Mapping[str, Boundary]) -> list[list[History]]:
    """Returns the displacements prescribed along x1 and along x2.

    A plane of symmetry rests, in both directions as its normal may not be known. So do extensions count in both, unless
    their key is u1 or u2.
    """
    resting: list[History] = [0.0 for boundary in boundaries.values() if boundary.symmetry]
    motions = [it for it in given if it.meaning is Meaning.DISPLACEMENT]
    return [resting + [it.history for it in motions if not it.key.endswith(f".{other}")] for other in ("u2", "u1")]


def reached(travels: Sequence[float], ends: Sequence[float]) -> tuple[float, ...]:
    """Returns travels that lie on the path, moved to the end of a leg where they differ from it by rounding.

    Args:
        travels: what is asked for, m.
        ends: travel at the end of each leg, m.
    """
    total = ends[-1]
    found: list[float] = []
    for index, travel in enumerate(travels):
        before = max(0, bisect(ends, travel) - 1)
        end = min(ends[before : before + 2], key=lambda end: abs(end - travel))
        here = end if abs(end - travel) <= ROUNDING * total else travel
        key = f"output.fields_at[{index}]"
        if not 0 <= here <= total:
            raise AdmissibilityError(key, travel, f"must lie on the path, whose travel is 0 to {total:g} m")
        if found and here <= found[-1]:
            raise AdmissibilityError(key, travel, "must be greater than the entry before it (m)")
        found.append(here)
    return tuple(found)
