"""What a study looks at in a run: numbers and profiles that can be compared from mesh to mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cosserat_fx.output.layer_bands import vertex
from cosserat_fx.results import BOUNDARY_COLUMNS, Run, Table
from cosserat_fx.scene import LayerScene, PlaneScene, Scene, SceneError
from cosserat_fx.studies.convergence import size
from cosserat_fx.typing import Array

HEIGHTS = 200
"""Evenly spaced places over the height of a layer at which profiles are compared."""
PROFILES = {
    "u1_m": "displacement profiles",
    "omega_rad": "rotation profiles",
    "void_ratio": "void ratio profiles",
    "m32_N_per_m": "couple stress profiles",
}
"""The profiles of a layer that are compared; shear and normal stress are constant over its height."""

type Group = Literal["stress", "band", "profiles"]
type Measured = Mapping[str, Array]
"""Values by quantity, those that a run has."""


@dataclass(frozen=True)
class Quantity:
    """Something that is compared.

    Attributes:
        name: in words.
        unit: of its values; empty for profiles over the height.
        group: what it belongs to.
    """

    name: str
    unit: str
    group: Group

    @property
    def is_number(self) -> bool:
        """Whether it is one number, the error of which has a sign, and not a profile."""
        return self.group != "profiles"

    def scale(self, reference: Array) -> float:
        """What errors are relative to: the largest magnitude of what has a unit, the range of profiles."""
        return float(np.max(np.abs(reference))) if self.unit else float(np.ptp(reference))

    def error(self, value: Array, reference: Array) -> float:
        """Relative error (%), signed where it is that of a number."""
        scale = self.scale(reference)
        if not scale:
            return 0.0 if np.array_equal(value, reference) else np.inf
        return 100 * (float(value - reference) if self.is_number else size(value - reference)) / scale


def quantities(scene: Scene) -> list[Quantity]:
    """What can be compared of a scene's runs, if they come to their end."""
    if isinstance(scene, LayerScene):
        stress: list[Quantity] = [Quantity(f"{word} shear stress", "Pa", "stress") for word in ("peak", "residual")]
        profiles = [Quantity(name, "", "profiles") for name in PROFILES.values() if scene.output.profiles_at]
        return [*stress, Quantity("band thickness", "m", "band"), *profiles]
    assert isinstance(scene, PlaneScene)
    column = stress_column(scene)
    unit = "Pa" if column.endswith("_Pa") else "N/m"
    return [
        *(Quantity(f"{word} {_words(column)}", unit, "stress") for word in ("peak", "final")),
        Quantity("band thickness", "m", "band"),
        Quantity("band inclination", "degrees", "band"),
        Quantity(f"{_words(column)} at the travels in fields_at", unit, "profiles"),
    ]


def left_out(scene: Scene) -> dict[str, str]:
    """What a run has and is not compared, with the reason."""
    return {} if isinstance(scene, LayerScene) else {"fields": "those of a plane body live on meshes that differ"}


def stress_column(scene: PlaneScene) -> str:
    """The column of a plane body's history that is compared: the scene's first force or stress.

    A scene without one is compared by the force on the first boundary, or wall, that is moved.

    Raises:
        SceneError: there is neither.
    """
    for name, column in scene.output.columns.items():
        if column.quantity in ("force1", "force2"):
            return name
    for name, boundary in scene.boundaries.items():
        moved = boundary.wall or boundary
        for component, given in enumerate((moved.u1, moved.u2), start=1):
            if given is not None and given != 0.0:
                return f"{name}_{BOUNDARY_COLUMNS[f'force{component}']}"
    raise SceneError(
        "output.columns is missing: a study compares the first column whose quantity is a force, and without one the "
        "force on the first boundary that is moved, of which there is none"
    )


def _words(column: str) -> str:
    """A column's name without its unit, in words."""
    return column.removesuffix("_Pa").removesuffix("_N_per_m").replace("_", " ")


def measure(run: Run, scene: Scene) -> Measured:
    """What a run comes to; what it does not have is missing.

    Args:
        run: one that came to its end.
        scene: of the study, by which quantities are named.
    """
    wanted = quantities(scene)
    values = _layer(run, scene) if isinstance(scene, LayerScene) else _plane(run, scene, wanted)
    return {it.name: values[it.name] for it in wanted if it.name in values}


def _layer(run: Run, scene: LayerScene) -> dict[str, Array]:
    friction, band = run.summary["friction"], run.summary.get("band")
    values = {
        "peak shear stress": np.array(friction["refined_peak_shear_stress_Pa"]),
        "residual shear stress": np.array(friction["residual_shear_stress_Pa"]),
    }
    if band:
        values["band thickness"] = np.array(band["thickness_m"])
    blocks = run.profile_blocks()
    if len(blocks) == len(scene.output.profiles_at or ()):
        values |= {
            name: np.concatenate([_resampled(block, column, scene.geometry.height) for block in blocks])
            for column, name in PROFILES.items()
            if blocks
        }
    return values


def _resampled(block: Table, column: str, height: float) -> Array:
    """A profile at the places of comparison, linear between the points and beyond the outermost ones.

    A point's value is the mean of its cell, which is that of the middle up to second order; so is the interpolation.
    """
    y = (np.arange(HEIGHTS) + 0.5) / HEIGHTS * height
    at, values = block["y_m"], block[column]
    if at.size == 1:
        return np.full(HEIGHTS, values[0])
    inner = np.interp(y, at, values)
    below = values[0] + (y - at[0]) * (values[1] - values[0]) / (at[1] - at[0])
    above = values[-1] + (y - at[-1]) * (values[-1] - values[-2]) / (at[-1] - at[-2])
    return np.asarray(np.where(y < at[0], below, np.where(y > at[-1], above, inner)))


def _plane(run: Run, scene: Scene, wanted: list[Quantity]) -> dict[str, Array]:
    assert isinstance(scene, PlaneScene)
    travel, curve = run.history["travel_m"], run.history[stress_column(scene)]
    top = int(np.argmax(np.abs(curve)))
    peak, final, *_, course = (it.name for it in wanted)
    values = {peak: np.array(vertex(travel, np.abs(curve), top)[1]), final: np.array(abs(curve[-1]))}
    if band := run.summary.get("band"):
        values |= {
            "band thickness": np.array(band["thickness_m"]),
            "band inclination": np.array(band["inclination_deg"]),
        }
    stations = [np.flatnonzero(np.isclose(travel, at, rtol=1e-9, atol=0.0)) for at in run.summary["stations_m"]]
    if stations and all(rows.size for rows in stations):
        values[course] = np.array([curve[rows[0]] for rows in stations])
    return values
