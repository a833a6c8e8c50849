"""The tables of a scene of an infinite layer between two walls, and the path that the walls take."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, NamedTuple, Self

from pydantic import Field, model_validator

from cosserat_fx.material import AdmissibilityError
from cosserat_fx.scenes.schema import (
    MAX_CELLS,
    ROUNDING,
    Displacements,
    Length,
    Output,
    Solver,
    Stress,
    Table,
    WallLaw,
)


class LayerGeometry(Table):
    """An infinite layer of a given height, sheared along x1; everything depends on x2 alone."""

    kind: Literal["layer"] = "layer"
    height: Length = Field(gt=0)
    """Height of the undeformed layer, m."""
    cells: int | None = Field(default=None, ge=1, le=MAX_CELLS)
    """Number of finite elements over the height; None where an accuracy chooses it."""


class Wall(WallLaw):
    """A rough wall of a layer."""

    shear_displacement: Displacements = Field(default=(0.0,), min_length=1)
    """Targets along x1 visited in turn, m; the single target 0 keeps the wall at rest all the way."""


class BottomWall(Wall):
    """The wall at x2 = 0, which never moves along x2."""


class TopWall(Wall):
    """The wall at x2 = height: it carries a constant normal stress or stays at its height."""

    normal_stress: Stress | None = Field(default=None, lt=0)
    """Constant normal stress s22, Pa, tension positive, hence negative; u2 is free but uniform."""
    constant_height: bool = False
    """Whether the wall is kept at its height (constant volume) instead."""

    @model_validator(mode="after")
    def _check_one_normal_condition(self) -> Self:
        if self.normal_stress is None and not self.constant_height:
            raise AdmissibilityError("normal_stress", None, "must be given unless constant_height = true")
        if self.normal_stress is not None and self.constant_height:
            allowed = "must be left out where constant_height = true (the wall has one condition along x2)"
            raise AdmissibilityError("normal_stress", self.normal_stress, allowed)
        return self


class Leg(NamedTuple):
    """Prescribed displacements of the two walls at the end of a leg of the path, m."""

    top: float
    bottom: float

    @property
    def travel(self) -> float:
        """Relative wall travel, top minus bottom, m."""
        return self.top - self.bottom


class Walls(Table):
    """The two walls and the path they take."""

    bottom: BottomWall = BottomWall()
    top: TopWall

    @property
    def legs(self) -> tuple[Leg, ...]:
        """The targets in turn. The path starts at (0, 0) and is linear between targets."""
        top, bottom = self.top.shear_displacement, self.bottom.shear_displacement
        count = max(len(top), len(bottom))
        return tuple(
            Leg(*targets) for targets in zip(_over_all_legs(top, count), _over_all_legs(bottom, count), strict=True)
        )

    @model_validator(mode="after")
    def _check_path(self) -> Self:
        top, bottom = self.top.shear_displacement, self.bottom.shear_displacement
        if not any(top) and not any(bottom):
            allowed = "must not be 0 where walls.bottom.shear_displacement is 0 as well (m): no wall would move"
            raise AdmissibilityError("top.shear_displacement", top, allowed)
        if len(top) != len(bottom) and (0.0,) not in (top, bottom):
            allowed = f"must have as many targets as walls.bottom.shear_displacement, {len(bottom)} and not {len(top)}"
            raise AdmissibilityError("top.shear_displacement", top, allowed)
        here = Leg(0.0, 0.0)
        for index, target in enumerate(self.legs):
            if target == here:
                key = f"top.shear_displacement[{index}]" if any(top) else f"bottom.shear_displacement[{index}]"
                value = target.top if any(top) else target.bottom
                raise AdmissibilityError(key, value, "must move a wall, but both are there already (m)")
            here = target
        return self


def _over_all_legs(targets: tuple[float, ...], count: int) -> tuple[float, ...]:
    """Returns the targets of a wall, repeated over all legs where it is a wall at rest."""
    return targets * count if targets == (0.0,) else targets


class LayerSolver(Solver):
    """Discretisation in the cell and solution of the equations."""

    integration_points: int = Field(default=1, ge=1, le=2)
    """Quadrature points per cell."""


class LayerOutput(Output):
    """What the run of a layer writes beside its history."""

    profiles_at: Displacements | None = None
    """Relative wall travels (top minus bottom, m) at which profiles are written, in the order of the path."""


class Station(NamedTuple):
    """A place on the path."""

    leg: int
    """Index of the leg."""
    fraction: float
    """Fraction of the leg that is done, 0 to 1."""
    travel: float
    """Relative wall travel there, top minus bottom, m."""


def find_stations(travels: Sequence[float], legs: Sequence[Leg]) -> tuple[Station, ...]:
    """Returns where the path first passes each relative wall travel after having passed the one before it.

    Args:
        travels: relative wall travels, top minus bottom, m.
        legs: the path, from (0, 0).

    Raises:
        AdmissibilityError: the path does not reach a travel, or not after the one before it.
    """
    ends = [0.0, *(leg.travel for leg in legs)]
    stations: list[Station] = []
    position = -1.0  # legs done at the last station
    for index, travel in enumerate(travels):
        for leg in range(max(0, int(position)), len(legs)):
            begin, end = ends[leg], ends[leg + 1]
            fraction = (travel - begin) / (end - begin) if begin != end else -1.0
            for end_of_leg in (0.0, 1.0):
                fraction = end_of_leg if abs(fraction - end_of_leg) < ROUNDING else fraction
            if 0 <= fraction <= 1 and leg + fraction > position + ROUNDING:
                stations.append(Station(leg, fraction, travel))
                position = leg + fraction
                break
        else:
            within = min(ends) <= travel <= max(ends)
            raise AdmissibilityError(
                f"output.profiles_at[{index}]",
                travel,
                "must be passed after the entry before it: list the travels once each, in the order of the path"
                if within
                else f"must lie within the relative wall travel (top minus bottom), {min(ends):g} to {max(ends):g} m",
            )
    return tuple(stations)


def default_profiles(legs: Sequence[Leg]) -> tuple[float, ...]:
    """Returns the travels at which profiles are written unless asked otherwise, m.

    They are the ends of the legs, or 10 %, 1/3, 2/3 and all of the travel where there is one leg. A leg without
    relative travel has none.
    """
    if len(legs) == 1:
        travel = legs[0].travel
        return (travel / 10, travel / 3, 2 * travel / 3, travel) if travel else ()
    ends = [0.0, *(leg.travel for leg in legs)]
    return tuple(end for begin, end in pairwise(ends) if end != begin)
