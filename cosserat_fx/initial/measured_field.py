"""A void ratio known at points, from a table or a mesh file, interpolated in between."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import QhullError

from cosserat_fx._compat import MPI
from cosserat_fx.guard import bounded
from cosserat_fx.meshes.file import read_with_meshio
from cosserat_fx.parallel import on_first_rank
from cosserat_fx.text import printable
from cosserat_fx.typing import Array

COLUMNS = ("x_m", "y_m", "void_ratio")
COLLINEAR = 1e-9
"""Largest deviation of points from a line, over their extent, for which they are taken to be on it."""


FAR = 1e9
"""Distance from the points, over their extent, beyond which it makes no difference."""


class FieldFileError(ValueError):
    """A file of void ratios that cannot be used; the message names the file and what is allowed."""

    def __init__(self, message: str) -> None:
        """Keeps the message in one line, though names in it may come from a file."""
        super().__init__(printable(message))


class MeasuredField:
    """Linear interpolation over the Delaunay triangles of the points; outside them, the value of the nearest point.

    Points on one line are interpolated along it, and the field does not change across it.
    """

    def __init__(self, points: Array, values: Array) -> None:
        """Set up the interpolation.

        Args:
            points: (n, 2) coordinates (m); of points given twice the mean value is taken.
            values: (n,).
        """
        distinct, number = np.unique(points, axis=0, return_inverse=True)
        values = np.bincount(number.reshape(-1), values) / np.bincount(number.reshape(-1))
        self._origin = distinct.min(axis=0)
        self._extent = float(np.ptp(distinct, axis=0).max()) or 1.0
        distinct = self._scaled(distinct)
        _, spread, axes = np.linalg.svd(distinct - distinct.mean(axis=0), full_matrices=True)
        self._along: Array = axes[0]
        if len(spread) < 2 or spread[1] <= COLLINEAR * spread[0]:
            station = distinct @ self._along
            order = np.argsort(station)
            self._line: tuple[Array, Array] | None = station[order], values[order]
        else:
            self._line = None
            self._inside = LinearNDInterpolator(distinct, values)
            self._outside = NearestNDInterpolator(distinct, values)

    def __call__(self, points: Array) -> Array:
        """Values at points, (m, 2) to (m,)."""
        found: Array
        points = self._scaled(points)
        if self._line is not None:
            found = np.interp(points @ self._along, *self._line)
            return found
        found = self._inside(points)
        outside = np.isnan(found)
        found[outside] = self._outside(points[outside])
        return found

    def _scaled(self, points: Array) -> Array:
        """Coordinates between 0 and 1 where the field is known."""
        with np.errstate(over="ignore"):
            scaled: Array = np.clip((points - self._origin) / self._extent, -FAR, FAR)
        return scaled


def read_field(file: Path, comm: MPI.Intracomm) -> MeasuredField:
    """The void ratio that a file holds. Collective.

    Args:
        file: a table (.csv) with the columns x_m, y_m and void_ratio, others being ignored; or a mesh file that meshio
            reads, its coordinates in m, with point data "void_ratio" or cell data of this name, which then belong to
            the means of the cells' corners.
        comm: the ranks that want it.

    Raises:
        FieldFileError: on every rank, where the file holds no such numbers.
        MeshError: on every rank, where meshio cannot read the file.
    """
    points, values = on_first_rank(comm, lambda: _table(file) if file.suffix.lower() == ".csv" else _mesh(file))
    try:
        return MeasuredField(points, values)
    except QhullError:
        raise FieldFileError(f"{file}: must have its points on a line or spread over the plane") from None


def _table(file: Path) -> tuple[Array, Array]:
    """Points and values of a table."""
    try:
        with bounded(file.stat().st_size):
            table = _numbers(file, file.read_text(encoding="utf-8-sig").splitlines())
    except (MemoryError, TimeoutError):
        raise FieldFileError(
            f"{file}: cannot be read with the memory and time that a table of its size takes"
        ) from None
    except OSError as error:
        raise FieldFileError(f"{file}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise FieldFileError(f"{file}: must be UTF-8 text") from None
    return _checked(file, table[:, :2], table[:, 2])


def _numbers(file: Path, lines: list[str]) -> Array:
    """Coordinates and void ratio in each line of a table, (n, 3)."""
    header = [name.strip() for name in lines[0].split(",")] if lines else []
    if missing := [name for name in COLUMNS if name not in header]:
        raise FieldFileError(
            f"{file}: the first line must name the columns {','.join(COLUMNS)}, but {', '.join(missing)} is missing"
        )
    picked = [header.index(name) for name in COLUMNS]
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        if line.strip():
            cells = line.split(",")
            try:
                rows.append([float(cells[column]) for column in picked])
            except (ValueError, IndexError):
                raise FieldFileError(f"{file}: line {number} must hold a number in each column") from None
    return np.array(rows).reshape(-1, 3)


def _mesh(file: Path) -> tuple[Array, Array]:
    """Points and values of a mesh file."""
    raw = read_with_meshio(file)
    if "void_ratio" in raw.point_data:
        return _checked(file, raw.points, raw.point_data["void_ratio"])
    if "void_ratio" in raw.cell_data:
        try:
            middles = np.concatenate([raw.points[block.data].mean(axis=1) for block in raw.cells])
            values = np.concatenate(raw.cell_data["void_ratio"])
        except (IndexError, ValueError):
            raise FieldFileError(
                f"{file}: cells must have nodes that are in the file, and one void ratio each"
            ) from None
        return _checked(file, middles, values)
    known = ", ".join([*raw.point_data, *raw.cell_data]) or "none"
    raise FieldFileError(f'{file}: must have point data or cell data "void_ratio"; the data in it: {known}')


def _checked(file: Path, points: Array, values: Array) -> tuple[Array, Array]:
    """Points in the plane and their values, of which there is one at least; all finite, the values positive."""
    values = np.asarray(values, dtype=np.float64)
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise FieldFileError(f"{file}: must have two or three coordinates of each point")
    points = points[:, :2]
    if values.shape != (len(points),) or not len(values):
        raise FieldFileError(f"{file}: must hold one void ratio at each of one or more points")
    if not (np.isfinite(points).all() and np.isfinite(values).all() and np.all(values > 0)):
        raise FieldFileError(f"{file}: coordinates must be finite numbers, and void ratios must be greater than 0")
    with np.errstate(over="ignore"):
        extent = np.ptp(points, axis=0)
    if not np.isfinite(extent).all():
        raise FieldFileError(f"{file}: coordinates must be smaller, as they have no finite extent")
    return points, values
