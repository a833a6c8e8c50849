"""Numbers that describe a shear band and the friction it leaves, from the profiles and the history of a layer.

Arrays are keyed by the column names of ``profiles.csv`` and ``history.csv``; SI units, tension positive.
"""
# ruff: noqa: N815  (units keep their capitals)

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from cosserat_fx.typing import Array

type Columns = Mapping[str, Array]
"""Columns by name, each of shape ``(rows,)``."""


@dataclass(frozen=True)
class BandMetrics:
    """The shear band: the part of the layer around the largest |shear strain| where at least half of it is reached.

    The shear strain is the total du1/dx2; heights and thickness are those of the reference configuration. Where the
    shear strain is nearly homogeneous, so that it nowhere falls below half its maximum, the band is the whole layer.
    The state in the middle is interpolated linearly at ``centre_m``.

    A band that a wall cuts short loses its outer half but widens its inner one, so that its thickness says little about
    how much of the layer takes part. The dilated zone does: it lies between the outermost points whose void ratio is
    half-way between the smallest and the largest of the layer, and is what looks light in the source paper's figure 2.

    Attributes:
        position_m: height of the point with the largest |shear strain|.
        relative_position: that height over the height of the layer, 0 at the bottom, 1 at the top.
        centre_m: height of the middle of the band, half-way between its edges.
        lower_m: height of the lower edge.
        upper_m: height of the upper edge.
        thickness_m: distance of the edges.
        thickness_d50: the same in mean grain diameters.
        touches: the wall which the band reaches: there the edge is the wall.
        dilated_lower_m: height of the lower edge of the dilated zone.
        dilated_upper_m: height of its upper edge.
        dilated_thickness_d50: their distance in mean grain diameters.
        shear_strain_max: the largest |shear strain|.
        void_ratio: in the middle.
        critical_void_ratio: in the middle, at the pressure there.
        void_ratio_over_critical: their ratio e/e_c in the middle.
        s11_over_s22: in the middle.
        s33_over_s22: in the middle.
        s12_Pa: in the middle.
        void_ratio_max: the largest void ratio of the layer.
        void_ratio_max_y_m: the height at which it is found.
        void_ratio_over_critical_max: the largest e/e_c of the layer.
    """

    position_m: float
    relative_position: float
    centre_m: float
    lower_m: float
    upper_m: float
    thickness_m: float
    thickness_d50: float
    touches: Literal["bottom", "top", "both"] | None
    dilated_lower_m: float
    dilated_upper_m: float
    dilated_thickness_d50: float
    shear_strain_max: float
    void_ratio: float
    critical_void_ratio: float
    void_ratio_over_critical: float
    s11_over_s22: float
    s33_over_s22: float
    s12_Pa: float
    void_ratio_max: float
    void_ratio_max_y_m: float
    void_ratio_over_critical_max: float


@dataclass(frozen=True)
class FrictionMetrics:
    """Peak and residual friction over the first leg of the path, up to the first reversal.

    ``friction`` is |s12|/|s22| at the wall, ``shear_stress`` is |s12|, ``travel`` is the displacement of the top wall
    relative to the bottom wall. A ``refined`` value is the vertex of the parabola through the largest row and its two
    neighbours; where the largest row is the first or the last of the leg it is that row.

    Attributes:
        peak_friction: the largest friction among the rows.
        peak_friction_travel_m: the travel of that row.
        refined_peak_friction: the vertex.
        refined_peak_friction_travel_m: the travel of the vertex.
        peak_shear_stress_Pa: the largest shear stress among the rows.
        peak_shear_stress_travel_m: the travel of that row.
        refined_peak_shear_stress_Pa: the vertex.
        refined_peak_shear_stress_travel_m: the travel of the vertex.
        residual_friction: friction of the last row of the leg.
        residual_shear_stress_Pa: shear stress of the last row of the leg.
        residual_travel_m: travel of the last row of the leg.
    """

    peak_friction: float
    peak_friction_travel_m: float
    refined_peak_friction: float
    refined_peak_friction_travel_m: float
    peak_shear_stress_Pa: float
    peak_shear_stress_travel_m: float
    refined_peak_shear_stress_Pa: float
    refined_peak_shear_stress_travel_m: float
    residual_friction: float
    residual_shear_stress_Pa: float
    residual_travel_m: float


def band_metrics(profile: Columns, critical_void_ratio: ArrayLike, *, d50: float, height: float) -> BandMetrics:
    """Measure the shear band in one profile across the layer.

    Args:
        profile: at least the columns ``y_m`` (ascending), ``shear_strain``, ``void_ratio``, ``s11_Pa``, ``s22_Pa``,
            ``s33_Pa`` and ``s12_Pa``.
        critical_void_ratio: e_c at the pressure of each point, or one value for all.
        d50: mean grain diameter (m).
        height: height of the layer in the reference configuration (m).

    Raises:
        ValueError: the heights do not ascend within the layer, or nothing has been sheared.
    """
    y = profile["y_m"]
    if y.size == 0 or np.any(np.diff(y) <= 0.0) or y[0] < 0.0 or y[-1] > height:
        raise ValueError(f"the heights of the points must ascend from 0 to {height} m")
    strain = np.abs(profile["shear_strain"])
    peak = int(np.argmax(strain))
    if not strain[peak] > 0.0:
        raise ValueError("there is no band where the shear strain is zero everywhere")
    lower, upper = _edges(y, strain, 0.5 * strain[peak], peak, peak, height)
    centre = 0.5 * (lower + upper)
    void_ratio = profile["void_ratio"]
    dilated = 0.5 * (np.min(void_ratio) + np.max(void_ratio))
    loose = np.flatnonzero(void_ratio >= dilated)
    dilated_lower, dilated_upper = _edges(y, void_ratio, dilated, loose[0], loose[-1], height)

    critical = np.broadcast_to(np.asarray(critical_void_ratio, dtype=np.float64), y.shape)
    e, e_c, s11, s22, s33, s12 = (
        float(np.interp(centre, y, column))
        for column in (void_ratio, critical, *(profile[f"s{ij}_Pa"] for ij in ("11", "22", "33", "12")))
    )
    loosest = int(np.argmax(void_ratio))
    return BandMetrics(
        position_m=float(y[peak]),
        relative_position=float(y[peak] / height),
        centre_m=centre,
        lower_m=lower,
        upper_m=upper,
        thickness_m=upper - lower,
        thickness_d50=(upper - lower) / d50,
        touches=_touches(bottom=lower == 0.0, top=upper == height),
        dilated_lower_m=dilated_lower,
        dilated_upper_m=dilated_upper,
        dilated_thickness_d50=(dilated_upper - dilated_lower) / d50,
        shear_strain_max=float(strain[peak]),
        void_ratio=e,
        critical_void_ratio=e_c,
        void_ratio_over_critical=e / e_c,
        s11_over_s22=s11 / s22,
        s33_over_s22=s33 / s22,
        s12_Pa=s12,
        void_ratio_max=float(void_ratio[loosest]),
        void_ratio_max_y_m=float(y[loosest]),
        void_ratio_over_critical_max=float(np.max(void_ratio / critical)),
    )


def friction_metrics(history: Columns) -> FrictionMetrics:
    """Measure peak and residual friction over the first leg of a history.

    Args:
        history: at least the columns ``top_displacement_m``, ``bottom_displacement_m``, ``shear_stress_Pa`` and
            ``normal_stress_Pa``.

    Raises:
        ValueError: there is no row.
    """
    if history["shear_stress_Pa"].size == 0:
        raise ValueError("a history without a step has no friction")
    travel = wall_travel(history)
    leg = slice(0, _first_leg(travel))
    travel = travel[leg]
    shear = np.abs(history["shear_stress_Pa"][leg])
    friction = shear / np.abs(history["normal_stress_Pa"][leg])
    top_friction, top_shear = int(np.argmax(friction)), int(np.argmax(shear))
    friction_vertex = vertex(travel, friction, top_friction)
    shear_vertex = vertex(travel, shear, top_shear)
    return FrictionMetrics(
        peak_friction=float(friction[top_friction]),
        peak_friction_travel_m=float(travel[top_friction]),
        refined_peak_friction=friction_vertex[1],
        refined_peak_friction_travel_m=friction_vertex[0],
        peak_shear_stress_Pa=float(shear[top_shear]),
        peak_shear_stress_travel_m=float(travel[top_shear]),
        refined_peak_shear_stress_Pa=shear_vertex[1],
        refined_peak_shear_stress_travel_m=shear_vertex[0],
        residual_friction=float(friction[-1]),
        residual_shear_stress_Pa=float(shear[-1]),
        residual_travel_m=float(travel[-1]),
    )


def wall_travel(history: Columns) -> Array:
    """Displacement of the top wall relative to the bottom wall (m), of shape ``(rows,)``."""
    return history["top_displacement_m"] - history["bottom_displacement_m"]


def _edges(y: Array, value: Array, level: float, first: int, last: int, height: float) -> tuple[float, float]:
    """Edges of the zone around the points first to last where the level is reached; a wall where it is not left."""
    lower = _crossing(y[first::-1], value[first::-1], level, 0.0)
    return lower, _crossing(y[last:], value[last:], level, height)


def _crossing(y: Array, value: Array, level: float, wall: float) -> float:
    """Where the value, linear between the points, first falls below the level on the way to the wall; or the wall."""
    lower = np.flatnonzero(value < level)
    if lower.size == 0:
        return wall
    after = int(lower[0])
    share = (value[after - 1] - level) / (value[after - 1] - value[after])
    return float(y[after - 1] + share * (y[after] - y[after - 1]))


def _touches(*, bottom: bool, top: bool) -> Literal["bottom", "top", "both"] | None:
    if bottom and top:
        return "both"
    return "bottom" if bottom else "top" if top else None


def _first_leg(travel: Array) -> int:
    """Number of rows before the first reversal of a path that starts at zero."""
    direction = np.sign(np.diff(travel, prepend=0.0))
    moving = direction[direction != 0.0]
    if moving.size == 0:
        return int(travel.size)
    back = np.flatnonzero(direction == -moving[0])
    return int(back[0]) if back.size else int(travel.size)


def vertex(x: Array, value: Array, top: int) -> tuple[float, float]:
    """Vertex of the parabola through the largest row and its neighbours (Newton's divided differences)."""
    if 0 < top < x.size - 1 and np.all(np.diff(x[top - 1 : top + 2])):
        x0, x1, x2 = x[top - 1 : top + 2]
        v0, v1, v2 = value[top - 1 : top + 2]
        rise, fall = (v1 - v0) / (x1 - x0), (v2 - v1) / (x2 - x1)
        bend = (fall - rise) / (x2 - x0)
        if bend != 0.0:
            vertex = 0.5 * (x0 + x1) - 0.5 * rise / bend
            return float(vertex), float(v0 + (vertex - x0) * (rise + bend * (vertex - x1)))
    return float(x[top]), float(value[top])
