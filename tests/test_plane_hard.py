"""Hard variants of the biaxial test, on its own mesh or a coarser one, reach the end without help."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meshes import square, write_msh
from planes import DEMO, build

WIDTH, HEIGHT = DEMO["geometry"]["width"], DEMO["geometry"]["height"]

Changes = dict[str, Any]


def low_pressure(folder: Path) -> Changes:
    """1 kPa, at which the law is ten times as stiff against its pressure as at 100 kPa."""
    return {"initial.stress": -1e3, "boundaries.left.pressure": 1e3, "boundaries.right.pressure": 1e3}


def finer_grains(folder: Path) -> Changes:
    """Grains of half the size, so that an element measures five of them."""
    return {"material.d50": DEMO["material"]["d50"] / 2}


def larger_imperfection(folder: Path) -> Changes:
    """A weak zone three times as wide and as high."""
    [zone] = DEMO["initial"]["zones"]
    return {"initial.zones": [zone | {axis: [zone[axis][0], zone[axis][0] + 0.0075] for axis in ("x", "y")}]}


def weaker_imperfection(folder: Path) -> Changes:
    """A weak zone whose void ratio differs three times as much from that around it."""
    [zone] = DEMO["initial"]["zones"]
    around = DEMO["initial"]["void_ratio"]
    return {"initial.zones": [zone | {"void_ratio": around + 3 * (zone["void_ratio"] - around)}]}


def distorted_mesh(folder: Path) -> Changes:
    """Corners inside moved at random by up to a quarter of a cell."""
    nx, ny = DEMO["geometry"]["cells"]
    mesh = square(nx, ny)
    inside = np.all((mesh.points > 1e-9) & (mesh.points < 1 - 1e-9), axis=1, keepdims=True)
    moves = np.random.default_rng(7).uniform(-0.25, 0.25, mesh.points.shape)
    mesh.points = (mesh.points + inside * moves / [nx, ny]) * [WIDTH, HEIGHT]
    return {"geometry": {"kind": "mesh", "file": str(write_msh(folder / "distorted.msh", mesh))}}


def reversal(folder: Path) -> Changes:
    """Pulled back half of the way after the peak and pressed again beyond."""
    return {"boundaries.top.u2": [-0.006, -0.003, -0.01], "output.fields_at": [0.006, 0.009, 0.016]}


@pytest.mark.parametrize(
    "variant", [low_pressure, finer_grains, larger_imperfection, weaker_imperfection, distorted_mesh, reversal]
)
def test_a_hard_variant_reaches_the_end(variant: Any, tmp_path: Path) -> None:
    """With an axial stress below the peak's and above what the sand bears in the end, and all forces in balance."""
    body = build(variant(tmp_path), DEMO)
    steps = list(body.stepper)
    problem = body.problem
    assert steps[-1].travel == pytest.approx(sum(body.scene.leg_lengths), rel=1e-12)
    forces = problem.boundary_forces()
    axial, pressure = -forces["top"]["force2"] / WIDTH, -body.scene.initial.stress
    # The critical state bears (1 + sin phi_c)/(1 - sin phi_c) = 3 times the lateral pressure, on a width that grows by
    # a tenth at most; of what dense sand bears beyond no more than a half of that is left.
    assert 3.0 < axial / pressure < 4.5
    for component in ("force1", "force2"):
        balance = sum(row[component] for row in forces.values())
        assert abs(balance) < 1e-6 * pressure * HEIGHT
    # The elastic stiffness falls more slowly with the pressure than the work does: 1 % at 1 kPa, 0.1 % at 100 kPa.
    assert problem.hourglass_energy() < 0.02 * problem.internal_work
    assert np.all(np.isfinite(problem.committed.x.array))
