"""The tables of a scene: their keys, the conditions on them and the path that the walls take.

Units are SI and stresses are positive in tension. Every table is frozen, takes no unknown key, and takes neither truth
values nor strings for numbers. Conditions that pydantic cannot state raise `AdmissibilityError` with the key relative
to the table that checks them; `cosserat_fx.scene` turns all of them into one message.
"""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from typing import Annotated, Final, Literal, NamedTuple, Self

from annotated_types import MaxLen
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from cosserat_fx.material import AdmissibilityError

MAX_CELLS: Final = 10_000_000
MAX_LIST: Final = 100_000

_LARGEST_INTEGER: Final = 2**63
_FRACTION_TOLERANCE: Final = 1e-9
"""How far the fractions f_u + f_r + f_s may be from one, and a profile (in fractions of its leg) from the path."""


@dataclass(frozen=True)
class Unit:
    """The unit of a key, for messages."""

    symbol: str


def _as_tuple(value: object) -> object:
    """Returns a list, or a number standing for a list of one, as a tuple, and anything else as it came."""
    if isinstance(value, list):
        return tuple(value)
    return (value,) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _check_petsc_option(value: object) -> object:
    """Returns a value that PETSc can take as an option."""
    match value:
        case str() | bool():
            return value
        case int() if abs(value) < _LARGEST_INTEGER:
            return value
        case float() if math.isfinite(value):
            return value
    raise AdmissibilityError("", value, "must be a string, true, false, a finite number or a 64-bit integer")


Length = Annotated[float, Unit("m")]
Stress = Annotated[float, Unit("Pa, tension positive")]
Displacements = Annotated[tuple[float, ...], BeforeValidator(_as_tuple), MaxLen(MAX_LIST), Unit("m")]
PetscOption = Annotated[str | bool | int | float, BeforeValidator(_check_petsc_option)]


class Table(BaseModel):
    """A table of a scene file."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class LayerGeometry(Table):
    """An infinite layer of a given height, sheared along x1; everything depends on x2 alone."""

    kind: Literal["layer"] = Field(default="layer", description="the only kind so far")
    height: Length = Field(gt=0)
    """Height of the undeformed layer, m."""
    cells: int = Field(ge=1, le=MAX_CELLS)
    """Number of finite elements over the height."""


class Initial(Table):
    """The homogeneous initial state; couple stresses start at zero."""

    stress: Stress = Field(lt=0)
    """Isotropic stress, Pa, tension positive, hence negative."""
    void_ratio: float = Field(gt=0)
    """Void ratio e_0, between e_d and e_i at the initial pressure."""


class Wall(Table):
    """A rough wall: what it prescribes to the particles that touch it when it moves (paper, equations 8 to 11).

    Either `rolling` is given, and `shear_displacement` is the displacement u_p of the particles, which rotate by
    |w| = rolling u_p/(d50/2); or `f_u`, `f_r` and `f_s` are given, and `shear_displacement` is the displacement u_b of
    the wall: the particles move by f_u u_b and rotate by |w| = f_r u_b/(d50/2). With none given the wall is very rough,
    rolling = 0.
    """

    rolling: float | None = Field(default=None, ge=0)
    """Ratio f_r/f_u of rolling to transmitted displacement; None where the fractions are given."""
    f_u: float | None = Field(default=None, gt=0, le=1)
    """Fraction of the wall's displacement transmitted to the particles."""
    f_r: float | None = Field(default=None, ge=0, le=1)
    """Fraction of the wall's displacement taken up by rolling of the particles."""
    f_s: float | None = Field(default=None, ge=0, le=1)
    """Fraction of the wall's displacement taken up by sliding."""
    shear_displacement: Displacements = Field(default=(0.0,), min_length=1)
    """Targets along x1 visited in turn, m; the single target 0 keeps the wall at rest all the way."""

    @model_validator(mode="before")
    @classmethod
    def _default_is_very_rough(cls, table: object) -> object:
        if isinstance(table, dict) and not table.keys() & {"rolling", "f_u", "f_r", "f_s"}:
            return {**table, "rolling": 0.0}
        return table

    @model_validator(mode="after")
    def _check_one_wall_law(self) -> Self:
        fractions = {"f_u": self.f_u, "f_r": self.f_r, "f_s": self.f_s}
        given = {key: value for key, value in fractions.items() if value is not None}
        if self.rolling is not None:
            if given:
                allowed = f"must be left out where the wall is described by {', '.join(given)}"
                raise AdmissibilityError("rolling", self.rolling, allowed)
            return self
        for key, value in fractions.items():
            if value is None:
                raise AdmissibilityError(key, None, "must be given along with the other two of f_u, f_r and f_s")
        total = sum(given.values())
        if abs(total - 1) > _FRACTION_TOLERANCE:
            raise AdmissibilityError("f_u", self.f_u, f"must make f_u + f_r + f_s = 1, but the sum is {total:.10g}")
        return self

    @property
    def displacement_factor(self) -> float:
        """Displacement of the particles per unit of `shear_displacement` (f_u, or 1 where `rolling` is given)."""
        return 1.0 if self.f_u is None else self.f_u

    def rolling_rotation_factor(self, d50: float) -> float:
        """Returns the size |w| of the particles' rotation per unit of `shear_displacement`, rad/m.

        It is f_r/(d50/2) (paper, equation 10) or rolling/(d50/2) (equation 11). The sign of w depends on the side.

        Args:
            d50: mean grain diameter, m.
        """
        return (self.rolling or self.f_r or 0.0) / (d50 / 2)


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


class Effects(Table):
    """What the user asks for or rules out; "auto" leaves the choice to the program."""

    polar: bool = True
    """Grain rotation and couple stress; without them the law is classical hypoplasticity."""
    finite_strain: Literal["auto"] | bool = "auto"
    """Finite kinematics, with it the spin terms."""
    spin: Literal["macro", "cosserat", "none"] = "macro"
    """Spin of the objective stress rate: of the displacement field, of the Cosserat rotation, or none."""
    void_ratio: bool = True
    """Whether the void ratio evolves."""

    @model_validator(mode="after")
    def _check_spin(self) -> Self:
        if self.spin == "cosserat" and not self.polar:
            raise AdmissibilityError("spin", self.spin, 'must be "macro" or "none" where effects.polar = false')
        return self


class Stepping(Table):
    """Load steps, measured as wall travel, m. What is None is chosen by the program."""

    first_step: Length | None = Field(default=None, gt=0)
    max_step: Length | None = Field(default=None, gt=0)
    min_step: Length | None = Field(default=None, gt=0)
    max_steps: int = Field(default=100_000, ge=1)
    """Number of accepted steps after which the run stops."""

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        steps = {"min_step": self.min_step, "first_step": self.first_step, "max_step": self.max_step}
        given = [(key, value) for key, value in steps.items() if value is not None]
        for (lower_key, lower), (key, value) in pairwise(given):
            if value < lower:
                raise AdmissibilityError(key, value, f"must be at least stepping.{lower_key} = {lower:g} (m)")
        return self


class Solver(Table):
    """Discretisation in the cell and solution of the equations."""

    integration_points: int = Field(default=1, ge=1, le=2)
    """Quadrature points per cell of a layer."""
    newton_tolerance: float = Field(default=1e-9, gt=0, lt=1)
    """Relative tolerance of the global Newton iteration."""
    max_iterations: int = Field(default=25, ge=1)
    """Newton iterations after which a step is cut back."""
    local_tolerance: float = Field(default=1e-3, gt=0, lt=1)
    """Relative error allowed in the integration of the law over a step."""
    petsc: dict[str, PetscOption] = Field(default_factory=dict)
    """Options passed through to PETSc."""


class Output(Table):
    """What a run writes beside its history."""

    profiles_at: Displacements | None = None
    """Relative wall travels (top minus bottom, m) at which profiles are written, in the order of the path."""
    fields: bool = True
    """Whether to write fields for ParaView."""
    figures: bool = True
    """Whether to draw figures."""


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
                fraction = end_of_leg if abs(fraction - end_of_leg) < _FRACTION_TOLERANCE else fraction
            if 0 <= fraction <= 1 and leg + fraction > position + _FRACTION_TOLERANCE:
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


def spell_key(key: str) -> str:
    """Returns a key as TOML spells it: in quotes unless it is made of letters, digits, dashes and underscores."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)


def unknown_key(key: str, known: Sequence[str]) -> str:
    """Returns what to say about a key that does not exist where others do."""
    nearest = get_close_matches(key, known, n=1)
    question = f", did you mean {nearest[0]}?" if nearest else "."
    return f"unknown key{question} The keys here are {', '.join(known)}"
