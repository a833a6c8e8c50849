"""Layers whose grains are not packed alike everywhere, and layers under their own weight."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import change

from cosserat_fx._compat import MPI
from cosserat_fx.layer import Layer, build
from cosserat_fx.results import Run, read_run
from cosserat_fx.run import run
from cosserat_fx.scene import LayerScene, SceneError, parse_scene

HEIGHT, PRESSURE, D50 = 0.04, 100e3, 0.5e-3
DENSITY, GRAVITY = 1600.0, 9.81
BASE: dict[str, Any] = {
    "geometry": {"height": HEIGHT, "cells": 40},
    "initial": {"stress": -PRESSURE, "void_ratio": 0.6},
    "walls": {"top": {"normal_stress": -PRESSURE, "shear_displacement": 0.002}},
    "output": {"figures": False, "fields": False},
}


def layer(changes: Mapping[str, object]) -> Layer:
    scene = parse_scene(change(BASE, changes))
    assert isinstance(scene, LayerScene)
    return build(scene, MPI.COMM_SELF)


def walk(folder: Path, changes: Mapping[str, object]) -> Run:
    run(parse_scene(change(BASE, changes)), folder)
    return read_run(folder)


def density(body: Layer) -> Any:
    state = body.problem.state
    return state.coordinates[:, 0], state.e_n[state.points]


@pytest.mark.parametrize("cells", [40, 7])
def test_a_zone_has_its_share_of_the_cells(cells: int) -> None:
    """Between 0.01 and 0.03 m, whether or not the cells end there, the excess of voids is that of the zone."""
    zone = {"y": [0.01, 0.03], "void_ratio": 0.7}
    y, e = density(layer({"initial.zones": [zone], "geometry.cells": cells}))
    assert (e - 0.6).sum() * HEIGHT / cells == pytest.approx(0.1 * 0.02)
    assert e.max() == pytest.approx(0.7)
    assert np.all(e[(y < 0.01 - HEIGHT / cells) | (y > 0.03 + HEIGHT / cells)] == 0.6)


def test_a_random_layer_is_the_same_on_every_mesh() -> None:
    """Points of the coarse mesh are points of one three times as fine."""
    field = {"initial.random": {"standard_deviation": 0.01, "correlation_length_d50": 10.0, "seed": 5}}
    y, e = density(layer(field))
    fine_y, fine_e = density(layer(field | {"geometry.cells": 120}))
    assert fine_y[1::3] == pytest.approx(y)
    assert fine_e[1::3] == pytest.approx(e, abs=1e-9)
    assert 0.005 < e.std() < 0.015


def test_a_measured_profile_is_read(tmp_path: Path) -> None:
    file = tmp_path / "profile.csv"
    file.write_text("x_m,y_m,void_ratio\n0,0,0.6\n0,0.04,0.7\n")
    y, e = density(layer({"initial.field": {"file": str(file)}}))
    assert e == pytest.approx(0.6 + 0.1 * y / HEIGHT)


def test_a_profile_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "profile.csv"
    file.write_text("height,void_ratio\n0,0.6\n")
    with pytest.raises(SceneError, match="x_m"):
        layer({"initial.field": {"file": str(file)}})


def test_what_is_odd_about_the_initial_state_is_told(tmp_path: Path) -> None:
    noise = {"initial.random": {"standard_deviation": 0.01, "correlation_length_d50": 1.0, "seed": 5}}
    [warning] = walk(tmp_path / "run", noise).summary["warnings"]
    assert warning.startswith("initial.random.correlation_length_d50 = 1 is less than the size of the elements")


def test_the_band_forms_in_the_weak_zone(tmp_path: Path) -> None:
    """To a few grains, as the walls push it away; in an even layer it forms in the middle, 18 grains from the zone."""
    zone = {"initial.zones": [{"y": [0.028, 0.030], "void_ratio": 0.65}]}
    weak = walk(tmp_path / "run", zone | {"walls.top.shear_displacement": 0.01})
    assert weak.summary["band"]["position_m"] == pytest.approx(0.029, abs=6 * D50)


def test_weight_adds_to_the_normal_stress_downwards(tmp_path: Path) -> None:
    """s22 = -p - rho g (H - y), whatever the deformation: mass stays, and the area of a layer does not change."""
    heavy = walk(tmp_path / "run", {"weight.density": DENSITY, "weight.gravity": GRAVITY})
    assert heavy.summary["status"] == "done"
    profile = heavy.profile_blocks()[-1]
    expected = -PRESSURE - DENSITY * GRAVITY * (HEIGHT - profile["y_m"])
    assert profile["s22_Pa"] == pytest.approx(expected, rel=1e-7)
    assert heavy.history["normal_stress_Pa"][-1] == pytest.approx(-PRESSURE - DENSITY * GRAVITY * HEIGHT, rel=1e-7)


def test_weight_comes_first_and_only_where_there_is_some() -> None:
    """In a leg of its own, of one grain's length, in which the walls rest; without weight there is no such leg."""
    light, heavy = layer({}).path, layer({"weight.density": DENSITY}).path
    assert light.corners == [0.0, 0.002]
    assert heavy.corners == pytest.approx([0.0, D50, D50 + 0.002])
    assert [heavy.load(travel) for travel in heavy.corners] == [0.0, 1.0, 1.0]
    assert heavy.top(D50) == 0.0
