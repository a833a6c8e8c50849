"""The initial void ratio of a body: a base, zones in it and a random field added, on any mesh and number of ranks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cosserat_fx.geometry import Geometry
from cosserat_fx.initial.cell_samples import Samples, map_to_cells, reference_samples, share_out
from cosserat_fx.initial.measured_field import read_field
from cosserat_fx.initial.random_field import RandomField
from cosserat_fx.material import AdmissibilityError
from cosserat_fx.meshes.sizes import size_report
from cosserat_fx.scenes.initial import Initial, Zone
from cosserat_fx.typing import Array

PARTS = 8
"""Parts of each side of a cell, by which the shares of zones in it are found."""
MARGIN = 1e-3
"""Distance from the bounds, over the distance between them, to which void ratios outside of them are brought."""
_DIGITS = 12
"""Decimals of shares that mean something; a cell beside a zone has none of it, not a rounding error's worth."""
_BLOCK = 4096
"""Cells whose samples are held at a time."""


@dataclass(frozen=True)
class VoidRatio:
    """The initial void ratio at the quadrature points.

    Attributes:
        values: (cells * points,) of this rank's own cells in their order.
        clipped: number of points on all ranks that were brought inside the bounds.
        warnings: what to tell, the same on all ranks.
    """

    values: Array
    clipped: int
    warnings: tuple[str, ...]


def initial_void_ratio(
    initial: Initial,
    geometry: Geometry,
    points: Array,
    weights: Array,
    *,
    d50: float,
    bounds: tuple[float, float],
) -> VoidRatio:
    """Evaluate a scene's initial void ratio. Collective.

    Base and random field are taken at the quadrature points. Zones count by their share in the part of the cell that
    belongs to a point, so that they have their area on every mesh, aligned with them or not; regions are whole cells.
    A layer is the section of the plane at x1 = 0.

    Args:
        initial: base, zones (later ones win) and random field, which is added everywhere.
        geometry: a layer or a plane body.
        points: (n, dim) quadrature points of the reference cell.
        weights: (n,) their weights, positive.
        d50: mean grain diameter (m).
        bounds: e_d and e_i at the initial pressure, between which void ratios have to be.

    Raises:
        AdmissibilityError: a zone names a region that the mesh does not have.
        FieldFileError, MeshError: the file of the base cannot be used.
    """
    comm = geometry.mesh.comm
    base = _base(initial, geometry)
    zones = _Zones(initial.zones, geometry, points, weights) if initial.zones else None
    noise = _noise(initial, d50)
    cell, corners = geometry.mesh.basix_cell().name, geometry.cell_corners()
    values = np.empty((len(corners), len(points)))
    for start in range(0, len(corners), _BLOCK):
        block = slice(start, start + _BLOCK)
        at = map_to_cells(cell, corners[block], points).positions
        here = base(at.reshape(-1, 2)).reshape(at.shape[:2])
        if zones is not None:
            here = zones.replace(here, block)
        if noise is not None:
            here = here + noise(at.reshape(-1, 2)).reshape(at.shape[:2])
        values[block] = here

    warnings = _unresolved(initial, geometry, d50)
    if zones is not None:
        warnings += [
            f"initial.zones[{number}] has no part of the body: it is outside, or later zones cover it"
            for number in np.flatnonzero(comm.allreduce(zones.seen) == 0.0)
        ]
    low, high = bounds
    out = ~((values > low) & (values < high))
    values[out] = np.clip(values[out], low + MARGIN * (high - low), high - MARGIN * (high - low))
    clipped, total = comm.allreduce(int(out.sum())), comm.allreduce(values.size)
    if clipped:
        warnings.append(
            f"the initial void ratio of {clipped} of {total} points was not between e_d = {low:.6g} and "
            f"e_i = {high:.6g}, the densest and the loosest state at the initial pressure, and was brought inside"
        )
    return VoidRatio(values.reshape(-1), clipped, tuple(warnings))


def _base(initial: Initial, geometry: Geometry) -> Callable[[Array], Array]:
    """The void ratio without zones and random field, a function of coordinates, (m, 2) to (m,)."""
    if initial.field is not None:
        return read_field(Path(initial.field.file), geometry.mesh.comm)
    return lambda points: np.full(len(points), initial.void_ratio)


def _noise(initial: Initial, d50: float) -> RandomField | None:
    """The random field."""
    random = initial.random
    if random is None:
        return None
    return RandomField(random.standard_deviation, random.correlation_length_d50 * d50, random.seed)


def _unresolved(initial: Initial, geometry: Geometry, d50: float) -> list[str]:
    """A warning where the random field changes within the elements."""
    median = size_report(geometry, d50).median
    if initial.random is None or initial.random.correlation_length_d50 >= median:
        return []
    return [
        f"initial.random.correlation_length_d50 = {initial.random.correlation_length_d50:g} is less than the size of "
        f"the elements, {median:.3g} d50 in the median: they do not resolve the field"
    ]


class _Zones:
    """The zones' shares in the cells.

    Attributes:
        seen: (zones,) sum of the shares of each zone in all points asked for so far.
    """

    def __init__(self, zones: tuple[Zone, ...], geometry: Geometry, points: Array, weights: Array) -> None:
        self.seen = np.zeros(len(zones))
        self._zones, self._corners = zones, geometry.cell_corners()
        self._cell = geometry.mesh.basix_cell().name
        self._samples = reference_samples(self._cell, PARTS)
        self._shares = share_out(self._samples, points, weights)
        # Zones are smeared over samples, so boxes around the cells are larger by one.
        self._low, self._high = self._corners.min(axis=1), self._corners.max(axis=1)
        margin = (self._high - self._low) / PARTS
        self._low, self._high = self._low - margin, self._high + margin
        self._members: dict[str, npt.NDArray[np.bool_]] = {}
        for number, zone in enumerate(zones):
            if zone.region is not None:
                if zone.region not in geometry.regions:
                    known = ", ".join(geometry.regions) or "none"
                    allowed = f"must be the name of a region of the mesh ({known})"
                    raise AdmissibilityError(f"initial.zones[{number}].region", zone.region, allowed)
                self._members[zone.region] = np.isin(geometry.own_cells, geometry.regions[zone.region])

    def replace(self, base: Array, cells: slice) -> Array:
        """The void ratio with the zones in place of the base, both (cells, points)."""
        values = base.copy()
        near = np.array([self._may_hold(zone, cells) for zone in self._zones])  # (zones, cells)
        cut = np.flatnonzero(near.any(axis=0))
        samples = map_to_cells(self._cell, self._corners[cells][cut], self._samples, PARTS)
        of_points = samples.measures @ self._shares.T
        free = np.ones_like(samples.measures)  # what the zones looked at leave of each sample
        for number in reversed(range(len(self._zones))):
            zone, rows = self._zones[number], np.flatnonzero(near[number, cut])
            part = Samples(samples.positions[rows], samples.sizes[rows], samples.measures[rows])
            covered = np.round(free[rows] * _coverage(zone, part), _DIGITS)
            free[rows] -= covered
            share = (covered * part.measures) @ self._shares.T / of_points[rows]
            values[cut[rows]] += share * (zone.void_ratio - base[cut[rows]])
            self.seen[number] += share.sum()
        return values

    def _may_hold(self, zone: Zone, cells: slice) -> npt.NDArray[np.bool_]:
        """Whether a zone may have a part in cells, (cells,)."""
        if zone.region is not None:
            return self._members[zone.region][cells]
        low, high = self._low[cells], self._high[cells]
        touched = np.ones(len(low), dtype=bool)
        axes = (1,) if low.shape[1] == 1 else (0, 1)  # a layer's only coordinate is x2
        for column, axis in enumerate(axes):
            start, end = _interval(zone, axis)
            touched &= (high[:, column] > start) & (low[:, column] < end)
        return touched


def _interval(zone: Zone, axis: int) -> tuple[float, float]:
    """The first and the last coordinate of a zone along an axis, infinite where it says nothing."""
    if zone.centre is not None and zone.radius is not None:
        return zone.centre[axis] - zone.radius, zone.centre[axis] + zone.radius
    return (zone.x, zone.y)[axis] or (-np.inf, np.inf)


def _coverage(zone: Zone, samples: Samples) -> Array:
    """The part of each sample that is in a zone, 0 to 1, (cells, samples).

    Samples are taken to be rectangles along the axes, which is exact for rectangular cells. The edge of a circle is
    smeared over the sample's mean size h, which makes its area pi (r^2 + h^2/12); a smaller radius makes up for it.
    """
    if zone.region is not None:
        return np.ones_like(samples.measures)
    if zone.centre is not None and zone.radius is not None:
        width = samples.sizes.mean(axis=2)
        distance = np.hypot(*np.moveaxis(samples.positions - np.array(zone.centre), 2, 0))
        with np.errstate(over="ignore"):
            radius = zone.radius * np.sqrt(np.maximum(1.0 - (width / zone.radius) ** 2 / 12, 0.0))
        smeared: Array = np.clip(0.5 - (distance - radius) / width, 0.0, 1.0)
        return smeared
    covered = np.ones_like(samples.measures)
    for axis, interval in enumerate((zone.x, zone.y)):
        if interval is not None:
            at, size = samples.positions[..., axis], samples.sizes[..., axis]
            overlap = np.minimum(at + size / 2, interval[1]) - np.maximum(at - size / 2, interval[0])
            covered *= np.maximum(overlap, 0.0) / size
    return covered
