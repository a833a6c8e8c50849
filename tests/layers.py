"""The layers of the demos, changed as a test needs them, and run through in this process."""

import re
from pathlib import Path

import numpy as np

from cosserat_fx.material import Material
from cosserat_fx.output.layer_bands import BandMetrics, band_metrics
from cosserat_fx.results import Run, Table, read_run
from cosserat_fx.run import run
from cosserat_fx.scene import LayerScene, load_scene
from cosserat_fx.typing import Array

DEMOS = Path(__file__).parents[1] / "demos"
ACCURACY_PAGE = Path(__file__).parents[1] / "docs" / "layer-accuracy.md"
WALLS = ("very_rough", "medium_rough")
HEIGHT, PRESSURE, VOID_RATIO = 0.04, 100e3, 0.6
REQUESTED = (0.004, 0.01, 0.02, 0.03)
SAND = Material.named("paper-sand")
D50 = SAND.d50
NOTHING_TO_LOOK_AT = ("output.figures=false", "output.fields=false")


def demo(wall: str) -> Path:
    return DEMOS / f"layer_{wall}.toml"


def scene(wall: str, *overrides: str) -> LayerScene:
    loaded = load_scene(demo(wall), [*NOTHING_TO_LOOK_AT, *overrides])
    assert isinstance(loaded, LayerScene)
    return loaded


def walk(folder: Path, wall: str, *overrides: str) -> Run:
    """Runs a demo's scene with some keys replaced, and reads what it left."""
    run(scene(wall, *overrides), folder)
    return read_run(folder)


def converged(wall: str, quantity: str) -> float:
    """Shear stress in Pa, "peak" or "residual" (at 3 cm), in the limit of fine meshes and small steps."""
    row = rf"^\| {wall.replace('_', ' ')} \| {quantity} \(Pa\) \| ([\d.]+) \|"
    [value] = re.findall(row, ACCURACY_PAGE.read_text(), re.MULTILINE)
    return float(value)


def mean_pressure(profile: Table) -> Array:
    return -(profile["s11_Pa"] + profile["s22_Pa"] + profile["s33_Pa"]) / 3


def critical_void_ratio(profile: Table, material: Material = SAND) -> Array:
    """e_c at the pressure of each point."""
    return material.characteristic_void_ratios(mean_pressure(profile)).e_c


def measure(profile: Table, material: Material = SAND) -> BandMetrics:
    critical = critical_void_ratio(profile, material)
    return band_metrics(profile, critical, d50=material.d50, height=HEIGHT)


def unevenness(column: Array) -> float:
    """Largest less smallest value, relative to the largest magnitude."""
    return float(np.ptp(column) / np.max(np.abs(column)))


def difference(a: Array, b: Array) -> float:
    """Largest difference of two columns, relative to the largest magnitude of the first."""
    scale = np.max(np.abs(a))
    return float(np.max(np.abs(a - b)) / scale) if scale else float(np.max(np.abs(b)))
