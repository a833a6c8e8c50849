"""Plane bodies against the law at a point and against the layer, on several ranks, and their Jacobian."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from derivative import order_of_remainder
from meshes import square
from planes import BIAXIAL, D50, DEMO, PRESSURE, build, kind, on_file, scattered, stress, visits
from points import update
from ranks import on_ranks
from scenes import change
from scipy.optimize import brentq

from cosserat_fx import layer
from cosserat_fx._compat import MPI
from cosserat_fx.elements import ELEMENTS
from cosserat_fx.layout import layout
from cosserat_fx.material import Material
from cosserat_fx.plane import Plane
from cosserat_fx.scene import LayerScene, parse_scene
from cosserat_fx.typing import Array

SAND = Material.named("paper-sand", d50=D50)
WIDTH = 0.02


def at_fixed_steps(body: Plane | layer.Layer) -> None:
    """Only what the scene says decides on the size of the steps."""
    body.stepper.control = replace(body.stepper.control, tolerance=1e9, strain=1e9)


# -- the law at a point ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("polar", [True, False], ids=["polar", "classical"])
def test_an_even_biaxial_test_is_the_law_under_mixed_control(polar: bool) -> None:
    """Three per cent of shortening; at the point the strain along x1 is what keeps s11 at the pressure."""
    tolerance = 1e-6
    body = build(
        BIAXIAL
        | {
            "boundaries.top.u2": -0.03 * WIDTH,
            "effects.polar": polar,
            "solver.local_tolerance": tolerance,
            "stepping": {"first_step": 4e-5, "max_step": 4e-5},
        }
    )
    at_fixed_steps(body)
    one = layout("plane", polar=polar)
    forces = np.array([[-PRESSURE if i == j else 0.0 for i, j in one.forces]])
    void_ratio, height, travel = np.array([0.6]), WIDTH, 0.0
    for reached, problem in visits(body):
        if reached == 0.0:
            continue
        step = reached - travel
        axial = -step / (height - step / 2)

        def reach(lateral: float, axial: float = axial, forces: Array = forces, void_ratio: Array = void_ratio) -> Any:
            increment = np.zeros((1, one.n_inputs))
            increment[0, [one.strain.index((0, 0)), one.strain.index((1, 1))]] = lateral, axial
            return update(
                one, increment, forces, void_ratio, adapt=True, tolerance=tolerance, tangent=False, material=SAND
            )

        lateral = brentq(lambda e: float(reach(e).forces[0, 0]) + PRESSURE, 0.0, -2 * axial, xtol=1e-13)
        point = reach(lateral)
        forces, void_ratio, height, travel = point.forces, point.void_ratio, height - step, reached
        for k, (i, j) in enumerate(one.stress):
            assert stress(problem, i, j) == pytest.approx(forces[0, k], abs=1e-4 * PRESSURE)
        assert problem.state.e_n[problem.state.points] == pytest.approx(void_ratio[0], abs=1e-6)
    assert travel == pytest.approx(0.03 * WIDTH)
    assert forces[0, 1] < -3 * PRESSURE


# -- the infinite layer ------------------------------------------------------------------------------------------------

HEIGHT, LENGTH = 0.02, 30
"""Of the strip, in m and in heights. 0.4 mm past the peak its ends are felt in its middle under a medium rough wall, of
10 heights by 5 %, of 20 by 0.4 % and of 30 by 0.01 %."""
LAYER: dict[str, Any] = {
    "material": {"d50": 0.5e-3},
    "initial": {"stress": -PRESSURE, "void_ratio": 0.6},
    "stepping": {"first_step": 1e-4, "max_step": 1e-4},
    "effects": {"finite_strain": True},
}
STATIONS = [0.5e-3, 1e-3, 1.5e-3, 2e-3]


@pytest.mark.parametrize("rolling", [0.0, 0.0125], ids=["very_rough", "medium_rough"])
def test_the_middle_of_a_long_strip_is_a_layer(rolling: float) -> None:
    """The mean shear stress of the middle column, through the peak at 1.6 mm; and the normal stress along x1."""
    walls = {
        "bottom": {"rolling": 0.0},
        "top": {"rolling": rolling, "shear_displacement": STATIONS[-1], "normal_stress": -PRESSURE},
    }
    changes = {"geometry": {"kind": "layer", "height": HEIGHT, "cells": 10}, "walls": walls}
    scene = parse_scene(LAYER | changes | {"output": {"profiles_at": STATIONS}})
    assert isinstance(scene, LayerScene)
    infinite = layer.build(scene, MPI.COMM_SELF)
    at_fixed_steps(infinite)
    expected = {}
    for step in infinite.stepper:
        problem = infinite.problem
        forces = problem.state.forces_n[problem.state.points].mean(axis=0)
        expected[round(step.travel, 9)] = [forces[problem.layout.stress_index(*at)] for at in ((0, 1), (0, 0))]
    strip = build(
        LAYER
        | {
            "geometry": {"kind": "rectangle", "width": LENGTH * HEIGHT, "height": HEIGHT, "cells": [2 * LENGTH, 10]},
            "boundaries": {
                "bottom": {"wall": {"rolling": 0.0}},
                "top": {"wall": {"rolling": rolling, "u1": STATIONS[-1], "pressure": PRESSURE}},
                "left": {"pressure": PRESSURE},
                "right": {"pressure": PRESSURE},
            },
            "output": {"fields_at": STATIONS},
        }
    )
    at_fixed_steps(strip)
    x = strip.problem.state.coordinates[:, 0]
    column = np.isclose(x, x[np.abs(x - LENGTH * HEIGHT / 2 + 1e-9).argmin()])
    assert column.sum() == 10
    compared = 0
    for travel, problem in visits(strip):
        if round(travel, 9) in expected:
            found = [stress(problem, *at)[column].mean() for at in ((0, 1), (0, 0))]
            assert found == pytest.approx(expected[round(travel, 9)], rel=2e-3)
            compared += 1
    assert compared >= 12
    peak = max(shear for shear, _ in expected.values())
    assert expected[STATIONS[-1]][0] < peak


# -- ranks -------------------------------------------------------------------------------------------------------------

PROGRAM = """
import json, sys
from cosserat_fx import plane
from cosserat_fx._compat import MPI
from cosserat_fx.scene import parse_scene
body = plane.build(parse_scene(json.loads(sys.argv[1])), MPI.COMM_WORLD)
rows = []
for step in body.stepper:
    forces = body.problem.boundary_forces()
    row = [step.cutbacks, step.passages, step.travel, body.problem.internal_work, body.problem.hourglass_energy()]
    row += [body.problem.boundary_mean(side, "u1") for side in forces]
    rows.append(row + [forces[side][name] for side in forces for name in ("force1", "force2")])
    if step.travel > 0.0038:
        break
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps(rows))
"""


def test_one_two_and_three_ranks_pass_a_bifurcation_alike() -> None:
    """The demo on coarse cells in long steps, one of which ends on an unstable branch, which is left."""
    scene = change(
        DEMO,
        {
            "geometry.cells": [8, 28],
            "initial.zones": [{"x": [0.0, 0.005], "y": [0.075, 0.08], "void_ratio": 0.7}],
            "boundaries.top.u2": -0.006,
            "output": {},
            "stepping": {"first_step": 4e-4, "max_step": 4e-4},
        },
    )
    one, *others = (np.array(json.loads(on_ranks(ranks, PROGRAM, json.dumps(scene)))) for ranks in (1, 2, 3))
    assert one[:, 1].sum() >= 1
    for several in others:
        assert several.shape == one.shape
        assert several[:, :2].tolist() == one[:, :2].tolist()
        assert np.all(np.abs(several - one).max(axis=0) <= 1e-8 * np.abs(one).max(axis=0))


# -- the Jacobian ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("element", ELEMENTS.values(), ids=ELEMENTS)
@pytest.mark.parametrize("polar", [True, False], ids=["polar", "classical"])
def test_jacobian_of_a_plane_body_is_the_derivative_of_its_residual(element: Any, polar: bool, tmp_path: Path) -> None:
    """With a pressure that follows, walls that tie the components on inclined sides, and a resistance."""
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    mesh = square(3, 3, kind(element), lambda at: scattered(3)(at) @ turn.T)
    rolling = 0.01 if polar else 0.0
    boundaries = {
        "bottom": {"u1": 0.0, "u2": 0.0},
        "top": {"wall": {"rolling": rolling, "pressure": PRESSURE}},
        "left": {"wall": {"rolling": rolling, "free": True}},
        "right": {"pressure": [1.2 * PRESSURE], **({"rotational_resistance": 50.0} if polar else {})},
    }
    body = build(
        on_file(tmp_path / "mesh.msh", mesh)
        | {
            "boundaries": boundaries,
            "solver": {"element": element.name, "local_tolerance": 1e-4},
            "effects.polar": polar,
            "stepping": {"first_step": 1e-5, "max_step": 1e-5},
        }
    )
    for travel, _ in visits(body):
        if travel > 1e-5:
            break
    body.problem.apply(travel + 1e-5)
    assert body.stepper.solver.predict()
    assert order_of_remainder(body.problem, WIDTH / 3, strain=5e-4) == pytest.approx(2.0, abs=0.05)
