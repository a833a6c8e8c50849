"""The scenes of the stability atlas: a box of layers, sampled evenly with a fixed seed, and its corners."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from math import log
from typing import Any, Final, Literal, NamedTuple, get_args

from scipy.stats import qmc

from cosserat_fx.material import Material

D50: Final = Material.named("paper-sand").d50
MAX_CELLS: Final = 2000
"""More make the atlas take a day; a tall layer is so much coarser than asked for."""

Walk = Literal["own steps", "at once", "cyclic"]
"""To the target with the program's own steps, or with a first step as long as the way; to and fro by a fifth of it."""

WALKS: Final[tuple[Walk, ...]] = get_args(Walk)


class Axis(NamedTuple):
    """One side of the box."""

    key: str
    label: str
    low: float
    high: float
    logarithmic: bool = False

    def at(self, part: float) -> float:
        """The value at a part (0 to 1) of the side."""
        if self.logarithmic:
            return float(self.low * (self.high / self.low) ** part)
        return self.low + part * (self.high - self.low)

    def part(self, value: float) -> float:
        """Which part (0 to 1) of the side a value is at."""
        if self.logarithmic:
            return log(value / self.low) / log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


AXES: Final = (
    Axis("pressure", "pressure (Pa)", 10.0, 10e6, logarithmic=True),
    Axis("density", "$(e - e_d)/(e_i - e_d)$", 0.005, 0.995),
    Axis("rolling", "rolling $f_r/f_u$", 0.0, 0.25),
    Axis("height", "height/$d_{50}$", 8.0, 800.0, logarithmic=True),
    Axis("fineness", "cells per $d_{50}$", 0.2, 10.0, logarithmic=True),
    Axis("a_c", "$a_c$", 0.5, 2.0),
    Axis("phi_c", r"$\varphi_c$ (degrees)", 20.0, 45.0),
    Axis("target", "target (m)", 1e-5, 0.03, logarithmic=True),
)
"""The sides that make a scene; the walk is one more, of three places."""


@dataclass(frozen=True)
class AtlasScene:
    """One layer of the atlas.

    Attributes:
        number: counts from 0 over the samples, then over the corners.
        kind: "sample" or "corner".
        walk: how the target is gone to; the way is as long in any case.
        pressure: initial and at the wall (Pa, compression positive).
        density: (e - e_d)/(e_i - e_d) of the initial void ratio at that pressure, 0 densest and 1 loosest.
        rolling: f_r/f_u of the top wall.
        height: over d50.
        fineness: cells per d50.
        a_c, phi_c: constants of the law; phi_c in degrees.
        target: displacement of the top wall (m).
    """

    number: int
    kind: Literal["sample", "corner"]
    walk: Walk
    pressure: float
    density: float
    rolling: float
    height: float
    fineness: float
    a_c: float
    phi_c: float
    target: float

    @property
    def cells(self) -> int:
        """Number of cells over the height."""
        return max(1, round(self.height * self.fineness))

    def tables(self) -> dict[str, Any]:
        """The tables of the scene, as a scene file has them."""
        sand = Material.named("paper-sand", a_c=self.a_c, phi_c=self.phi_c)
        e_i, _, e_d = sand.characteristic_void_ratios(self.pressure)
        turn = self.target / 5
        targets = [turn, -turn, turn] if self.walk == "cyclic" else [self.target]
        tables = {
            "geometry": {"kind": "layer", "height": self.height * D50, "cells": self.cells},
            "material": {"constants": "paper-sand", "a_c": self.a_c, "phi_c": self.phi_c},
            "initial": {"stress": -self.pressure, "void_ratio": e_d + self.density * (e_i - e_d)},
            "walls": {
                "top": {
                    "rolling": self.rolling,
                    "normal_stress": -self.pressure,
                    "shear_displacement": targets,
                }
            },
            "output": {"profiles_at": targets},
        }
        return tables | ({"stepping": {"first_step": self.target}} if self.walk == "at once" else {})


def samples(count: int, seed: int = 4) -> list[AtlasScene]:
    """Scenes spread over the box and the walks by a scrambled Sobol sequence.

    Args:
        count: of scenes; powers of two spread best.
        seed: of the scrambling.
    """
    sequence = qmc.Sobol(len(AXES) + 1, seed=seed).random(count)
    return [_scene(number, "sample", WALKS[int(len(WALKS) * row[-1])], row[:-1]) for number, row in enumerate(sequence)]


def corners(first_number: int) -> list[AtlasScene]:
    """Every other corner of the box: those with an even number of far ends, and with the far target all of them.

    Of the 128 corners of the other seven sides these 64 are the half in which no effect of one side, and no joint
    effect of two, is confounded with another such. Half of them go at once, half to and fro.
    """
    sides = len(AXES) - 1
    places = [place for place in product((0, 1), repeat=sides) if sum(place) % 2 == 0]
    walks: tuple[Walk, Walk] = ("at once", "cyclic")
    return [
        _scene(first_number + k, "corner", walks[sum(place[: sides // 2]) % 2], [*place, 1])
        for k, place in enumerate(places)
    ]


def _coarsened(fineness: float, height: float) -> float:
    """Cells per d50 of a layer that is not to have too many."""
    return min(fineness, MAX_CELLS / height)


def _scene(number: int, kind: Literal["sample", "corner"], walk: Walk, parts: Iterable[float]) -> AtlasScene:
    values = {axis.key: axis.at(float(part)) for axis, part in zip(AXES, parts, strict=True)}
    values["fineness"] = _coarsened(values["fineness"], values["height"])
    return AtlasScene(number, kind, walk, **values)
