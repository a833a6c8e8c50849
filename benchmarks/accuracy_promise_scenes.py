"""Random layers that hold the key `accuracy` to its promise: one set was used to tune, the other was not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from cosserat_fx.material import Material
from cosserat_fx.scene import LayerScene, parse_scene

type Name = Literal["tuning", "test"]

SEEDS: Final[dict[Name, int]] = {"tuning": 101, "test": 303}
"""Of two sets that share no scene."""


@dataclass(frozen=True)
class RandomLayer:
    """A layer under a top wall that moves.

    Attributes:
        pressure: initial and at the wall (Pa).
        phi_c, a_c, d50: constants of the law (degrees, -, m).
        density: (e - e_d)/(e_c - e_d) of the initial void ratio: 0 densest, above 1 loose.
        height: over d50.
        rolling: f_r/f_u of the top wall.
        targets: of the top wall (m).
    """

    pressure: float
    phi_c: float
    a_c: float
    d50: float
    density: float
    height: float
    rolling: float
    targets: tuple[float, ...]

    def scene(self, accuracy: float | None = None, cells: int | None = None) -> LayerScene:
        """The scene, with an accuracy or with a number of cells."""
        constants = {"phi_c": self.phi_c, "a_c": self.a_c, "d50": self.d50}
        _, e_c, e_d = Material.named("paper-sand", **constants).characteristic_void_ratios(self.pressure)
        tables: dict[str, Any] = {
            "geometry": {"kind": "layer", "height": self.height * self.d50},
            "material": {"constants": "paper-sand", **constants},
            "initial": {"stress": -self.pressure, "void_ratio": float(e_d + self.density * (e_c - e_d))},
            "walls": {
                "top": {
                    "rolling": self.rolling,
                    "normal_stress": -self.pressure,
                    "shear_displacement": list(self.targets),
                }
            },
            "output": {"profiles_at": [], "fields": False, "figures": False, "checkpoints": "off"},
        }
        if accuracy is not None:
            tables["accuracy"] = accuracy
        if cells is not None:
            tables["geometry"]["cells"] = cells
        scene = parse_scene(tables)
        assert isinstance(scene, LayerScene)
        return scene


def layers(name: Name, count: int) -> list[RandomLayer]:
    """The first layers of a set.

    Pressures from 10 kPa to 1 MPa, heights from 20 to 200 d50, d50 from 0.25 to 1 mm and travels from 3 mm to 3 cm are
    spread evenly over their logarithms, the rest over their range. One layer in seven is loose, one wall in four very
    rough, one path in four goes back and half of these come again.

    Args:
        name: of the set.
        count: of layers.
    """
    return [_layer(np.random.default_rng([SEEDS[name], number])) for number in range(count)]


def _layer(rng: np.random.Generator) -> RandomLayer:
    def logarithmic(low: float, high: float) -> float:
        return float(low * (high / low) ** rng.random())

    pressure, phi_c, a_c = logarithmic(10e3, 1e6), float(rng.uniform(25, 40)), float(rng.uniform(0.5, 2.0))
    d50 = logarithmic(0.25e-3, 1e-3)
    density = float(rng.uniform(1.05, 1.25) if rng.random() < 0.15 else rng.uniform(0.1, 0.9))
    height = logarithmic(20.0, 200.0)
    rolling = 0.0 if rng.random() < 0.25 else float(rng.uniform(0.0, 0.1))
    travel = logarithmic(3e-3, 3e-2)
    targets = [travel]
    if rng.random() < 0.25:
        targets = [travel / 2, -travel / 2 if rng.random() < 0.5 else 0.0]
        targets += [travel / 2] * (rng.random() < 0.5)
    return RandomLayer(pressure, phi_c, a_c, d50, density, height, rolling, tuple(targets))
