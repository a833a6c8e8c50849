"""What the tables of every scene have in common: their rules, and the tables that layers and plane bodies share.

The tables of layers are in `layer`, those of plane bodies in `plane`, the initial state in `initial`. Units are SI and
stresses are positive in tension. Every table is frozen, takes no unknown key, and takes neither truth values nor
strings for numbers. Conditions that pydantic cannot state raise `AdmissibilityError` with the key relative to the table
that checks them; `cosserat_fx.scenes.refusals` turns all of them into one message.
"""

import json
import math
import os.path
import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from annotated_types import Ge, MaxLen
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator
from pydantic.fields import FieldInfo

from cosserat_fx.material import AdmissibilityError

MAX_CELLS: Final = 10_000_000
MAX_LIST: Final = 100_000
MAX_NAMED: Final = 1_000
"""Number of boundaries, and of points, that a scene may have."""
ROUNDING: Final = 1e-9
"""Differences of fractions, of places on the path and of places in the body that are taken for rounding, relative."""

_LARGEST_INTEGER: Final = 2**63


@dataclass(frozen=True)
class Unit:
    """The unit of a key, for messages."""

    symbol: str


def list_as_tuple(value: object) -> object:
    """Returns a list as a tuple, and anything else as it came."""
    return tuple(value) if isinstance(value, list) else value


def _as_tuple(value: object) -> object:
    """Returns a list, or a number standing for a list of one, as a tuple, and anything else as it came."""
    return (value,) if isinstance(value, int | float) and not isinstance(value, bool) else list_as_tuple(value)


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


def _find_file(name: str, info: ValidationInfo) -> str:
    """Returns the path of a file that exists, from the folder in the validation's context or the current one."""
    path = Path((info.context or {}).get("folder", "."), name)
    if not os.path.isfile(path):
        allowed = f"must be a file, relative to the folder of the scene unless absolute, but there is none at {path}"
        raise AdmissibilityError("", name, allowed)
    return str(path)


Length = Annotated[float, Unit("m")]
Stress = Annotated[float, Unit("Pa, tension positive")]
Displacements = Annotated[tuple[float, ...], BeforeValidator(_as_tuple), MaxLen(MAX_LIST), Unit("m")]
Position = Annotated[tuple[float, float], BeforeValidator(list_as_tuple), Unit("m")]
PetscOption = Annotated[str | bool | int | float, BeforeValidator(_check_petsc_option)]
File = Annotated[str, AfterValidator(_find_file)]


class Table(BaseModel):
    """A table of a scene file."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, protected_namespaces=())

    @classmethod
    def known_keys(cls) -> dict[str, Any]:
        """Returns the annotation of each key, with its constraints."""
        return {key: _with_constraints(field) for key, field in cls.model_fields.items()}


def _with_constraints(field: FieldInfo) -> Any:
    return Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation


class WallLaw(Table):
    """How particles at a rough wall move and roll with it (paper, equations 8 to 11).

    Either `rolling` is given, and the displacement of the wall's table is u_p, that of the particles, which rotate by
    |w| = rolling u_p/(d50/2); or `f_u`, `f_r` and `f_s` are given, and it is the displacement u_b of the wall: the
    particles move by f_u u_b and rotate by |w| = f_r u_b/(d50/2). With none given the wall is very rough, rolling = 0.
    """

    rolling: float | None = Field(default=None, ge=0)
    """Ratio f_r/f_u of rolling to transmitted displacement; None where the fractions are given."""
    f_u: float | None = Field(default=None, gt=0, le=1)
    """Fraction of the wall's displacement transmitted to the particles."""
    f_r: float | None = Field(default=None, ge=0, le=1)
    """Fraction of the wall's displacement taken up by rolling of the particles."""
    f_s: float | None = Field(default=None, ge=0, le=1)
    """Fraction of the wall's displacement taken up by sliding."""

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
        if abs(total - 1) > ROUNDING:
            raise AdmissibilityError("f_u", self.f_u, f"must make f_u + f_r + f_s = 1, but the sum is {total:.10g}")
        return self

    @property
    def displacement_factor(self) -> float:
        """Displacement of the particles per unit of the table's displacement (f_u, or 1 where `rolling` is given)."""
        return 1.0 if self.f_u is None else self.f_u

    def rolling_rotation_factor(self, d50: float) -> float:
        """Returns the size |w| of the particles' rotation per unit of the table's displacement, rad/m.

        It is f_r/(d50/2) (paper, equation 10) or rolling/(d50/2) (equation 11). The sign of w depends on the side.

        Args:
            d50: mean grain diameter, m.
        """
        return (self.rolling or self.f_r or 0.0) / (d50 / 2)

    def check_rotation_exists(self, table: str, *, polar: bool) -> None:
        """Refuses rolling in a continuum without rotations.

        Args:
            table: dotted key of the wall.
            polar: whether there are rotations.

        Raises:
            AdmissibilityError: the particles roll, and `polar` is false.
        """
        for key, value in (("rolling", self.rolling), ("f_r", self.f_r)):
            if value and not polar:
                allowed = "must be 0 where effects.polar = false, as there is no rotation to prescribe"
                raise AdmissibilityError(f"{table}.{key}", value, allowed)


class Weight(Table):
    """The body's own weight, a force along -x2 that is brought up before the first leg."""

    density: Annotated[float, Unit("kg/m3")] = Field(gt=0)
    """Bulk density in the initial state, kg/m^3."""
    gravity: Annotated[float, Unit("m/s2")] = Field(default=9.81, gt=0)
    """Acceleration, m/s^2."""


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
    """Load steps, measured as travel along the path, m. What is None is chosen by the program."""

    first_step: Length | None = Field(default=None, gt=0)
    max_step: Length | None = Field(default=None, gt=0)
    min_step: Length | None = Field(default=None, gt=0)
    tolerance: float = Field(default=0.12, gt=0)
    """Aimed change of the strain rate over a step, relative to the strain rate."""
    strain: float = Field(default=0.4, gt=0)
    """Aimed largest strain increment of any point."""
    max_steps: int = Field(default=100_000, ge=1)
    """Number of accepted steps after which the run stops."""
    max_jumps: int = Field(default=150, ge=0)
    """Number of jumps to another equilibrium that a run may have; with more the body moves by stick and slip."""
    branch: Literal["stable", "primary"] | None = None
    """What to do where equilibrium bifurcates: go on along a stable branch (the default in the plane), or stay on the
    primary one (in a layer)."""

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        steps = {"min_step": self.min_step, "first_step": self.first_step, "max_step": self.max_step}
        given = [(key, value) for key, value in steps.items() if value is not None]
        for (lower_key, lower), (key, value) in pairwise(given):
            if value < lower:
                raise AdmissibilityError(key, value, f"must be at least stepping.{lower_key} = {lower:g} (m)")
        return self


class Solver(Table):
    """Solution of the equations."""

    newton_tolerance: float = Field(default=1e-9, gt=0, lt=1)
    """Relative tolerance of the global Newton iteration."""
    max_iterations: int = Field(default=25, ge=1, le=MAX_LIST)
    """Newton iterations after which a step is cut back."""
    local_tolerance: float = Field(default=1e-3, gt=0, lt=1)
    """Relative error allowed in the integration of the law over a step."""
    linear: Literal["auto", "direct", "iterative"] = "auto"
    """How linear systems are solved: by factors, or by GMRES with multigrid."""
    petsc: dict[str, PetscOption] = Field(default_factory=dict)
    """Options passed through to PETSc; none by which it would call Python code or write files."""

    @model_validator(mode="after")
    def _check_petsc_stays_inside(self) -> Self:
        for name, value in self.petsc.items():
            key = f"petsc.{spell_key(name)}"
            if "python" in f"{name} {value}".lower():
                raise AdmissibilityError(
                    key, value, "must not make PETSc call Python code, as no scene executes anything"
                )
            if isinstance(value, str) and any(value.split(":")[1:2]):
                allowed = (
                    "must not name a file, as a scene writes to its run's folder only (type:file:format is PETSc's way)"
                )
                raise AdmissibilityError(key, value, allowed)
        return self


class Output(Table):
    """What a run writes beside its history."""

    fields: bool = True
    """Whether to write fields for ParaView."""
    figures: bool = True
    """Whether to draw figures."""
    checkpoints: Literal["auto", "off"] | Annotated[float, Unit("s"), Ge(0)] = "auto"
    """Seconds between checkpoints, 0 for one after every step; "auto" as often as 1 % of the run's time allows."""


def spell_key(key: str) -> str:
    """Returns a key as TOML spells it: in quotes unless it is made of letters, digits, dashes and underscores."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)


def unknown_key(key: str, known: Sequence[str]) -> str:
    """Returns what to say about a key that does not exist where others do."""
    nearest = get_close_matches(key, known, n=1)
    question = f", did you mean {nearest[0]}?" if nearest else "."
    return f"unknown key{question} The keys here are {', '.join(known)}"
