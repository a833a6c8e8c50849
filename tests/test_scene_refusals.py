"""What a scene of a layer may not say, and how it is told."""

import math
from datetime import date

import pytest
from scenes import ABSENT, FRACTIONS, changed_layer

from cosserat_fx.scene import SceneError, parse_scene

BAD_INPUT: list[tuple[dict[str, object], str, str]] = [
    # keys and tables
    ({"geometry.hieght": 0.04}, "geometry.hieght = 0.04", "unknown key, did you mean height?"),
    ({"geometri": {"height": 1}}, "geometri = {height = 1}", "unknown key, did you mean geometry?"),
    ({"walls.top.shear_displacment": 1}, "walls.top.shear_displacment = 1", "did you mean shear_displacement?"),
    ({"walls.bottom.normal_stress": -1}, "walls.bottom.normal_stress = -1", "unknown key. The keys here are rolling"),
    ({"material.phi": 30}, "material.phi = 30", "did you mean phi_c?"),
    ({'geometry.two\nlines "': 1}, r'geometry."two\nlines \"" = 1', "unknown key"),
    ({"geometry.height": ABSENT}, "geometry.height is missing", "must be a finite number greater than 0 (m)"),
    ({"initial": ABSENT}, "initial is missing", "must be a table with the keys stress, void_ratio"),
    ({"walls": [1]}, "walls = [1]", "must be a table with the keys bottom, top"),
    ({"material": "paper-sand"}, 'material = "paper-sand"', "must be a table"),
    (
        {"boundaries.top.u2": 1},
        "boundaries = {top = {...}}",
        'only geometry.kind = "rectangle" or "mesh" has this key; a',
    ),
    ({"geometry.width": 1}, "geometry.width = 1", 'must be left out, as only geometry.kind = "rectangle" has this key'),
    ({"solver.element": "Q1"}, 'solver.element = "Q1"', 'only geometry.kind = "rectangle" or "mesh" has this key. The'),
    # initial state and weight
    ({"initial.zones": [{"x": [0, 1], "void_ratio": 0.7}]}, "initial.zones[0].x = [0.0, 1.0]", "zones are given by y"),
    ({"initial.zones": [{"region": "a", "void_ratio": 0.7}]}, 'initial.zones[0].region = "a"', "zones are given by y"),
    ({"initial.zones": [{"y": [1, 2], "void_ratio": 0.7}]}, "initial.zones[0].y = [1.0, 2.0]", "y from 0 to 0.04 m"),
    ({"initial.zones": [{"y": [0, 1], "void_ratio": 0.1}]}, "initial.zones[0].void_ratio = 0.1", "greater than e_d"),
    ({"initial.field.file": "nowhere.csv"}, 'initial.field.file = "nowhere.csv"', "there is none at nowhere.csv"),
    ({"weight.density": -1}, "weight.density = -1", "greater than 0 (kg/m3)"),
    # types
    ({"geometry.height": "3"}, 'geometry.height = "3"', "must be a finite number greater than 0 (m)"),
    ({"geometry.height": True}, "geometry.height = true", "must be a finite number"),
    ({"geometry.height": [0.04]}, "geometry.height = [0.04]", "must be a finite number"),
    ({"geometry.height": date(2020, 1, 2)}, "geometry.height = 2020-01-02", "must be a finite number"),
    ({"geometry.height": math.nan}, "geometry.height = nan", "must be a finite number"),
    ({"initial.stress": -math.inf}, "initial.stress = -inf", "must be a finite number"),
    ({"geometry.height": 10**400}, "geometry.height = 0x", "must be a finite number"),
    ({"geometry.cells": 80.0}, "geometry.cells = 80.0", "must be a whole number"),
    ({"geometry.cells": True}, "geometry.cells = true", "must be a whole number"),
    ({"effects.polar": 1}, "effects.polar = 1", "must be true or false"),
    ({"title": 3}, "title = 3", "must be a string"),
    ({"solver.integration_points": True}, "solver.integration_points = true", "must be a whole number"),
    ({"solver.petsc": 3}, "solver.petsc = 3", "must be a table"),
    ({"solver.petsc.snes_rtol": [1]}, "solver.petsc.snes_rtol = [1]", "must be a string, true, false, a finite number"),
    (
        {"solver.petsc.snes_rtol": math.nan},
        "solver.petsc.snes_rtol = nan",
        "must be a string, true, false, a finite number",
    ),
    ({"solver.petsc.snes_max_it": 2**63}, f"solver.petsc.snes_max_it = {2**63}", "a 64-bit integer"),
    ({"walls.top.shear_displacement": "far"}, 'walls.top.shear_displacement = "far"', "a finite number or a list"),
    ({"walls.top.shear_displacement": [1, "far"]}, 'walls.top.shear_displacement[1] = "far"', "or a list of 1 to"),
    ({"walls.top.shear_displacement": ["far"]}, 'walls.top.shear_displacement[0] = "far"', "or a list of 1 to"),
    # ranges
    ({"geometry.kind": "box"}, 'geometry.kind = "box"', 'must be "layer", "rectangle" or "mesh"'),
    ({"geometry.kind": ["layer"]}, 'geometry.kind = ["layer"]', 'must be "layer", "rectangle" or "mesh"'),
    ({"geometry.height": -1}, "geometry.height = -1", "greater than 0 (m)"),
    ({"geometry.cells": 0}, "geometry.cells = 0", "at least 1 and at most 10000000"),
    ({"geometry.cells": 10_000_001}, "geometry.cells = 10000001", "at least 1 and at most 10000000"),
    ({"initial.stress": 0}, "initial.stress = 0", "less than 0 (Pa, tension positive)"),
    ({"initial.stress": 100e3}, "initial.stress = 100000.0", "less than 0 (Pa, tension positive)"),
    ({"initial.void_ratio": 0.4727}, "initial.void_ratio = 0.4727", "greater than e_d = 0.472797 and less than e_i"),
    ({"initial.void_ratio": 1.1125}, "initial.void_ratio = 1.1125", "less than e_i = 1.11246"),
    ({"solver.integration_points": 3}, "solver.integration_points = 3", "at least 1 and at most 2"),
    ({"solver.newton_tolerance": 0}, "solver.newton_tolerance = 0", "greater than 0 and less than 1"),
    ({"solver.max_iterations": 0}, "solver.max_iterations = 0", "at least 1"),
    ({"solver.local_tolerance": 1}, "solver.local_tolerance = 1", "greater than 0 and less than 1"),
    ({"stepping.max_steps": 0}, "stepping.max_steps = 0", "at least 1"),
    ({"stepping.tolerance": 0}, "stepping.tolerance = 0", "greater than 0"),
    ({"stepping.strain": -0.4}, "stepping.strain = -0.4", "greater than 0"),
    ({"stepping.first_step": 0}, "stepping.first_step = 0", "greater than 0 (m)"),
    ({"stepping": {"min_step": 1e-3, "max_step": 1e-4}}, "stepping.max_step = 0.0001", "stepping.min_step = 0.001"),
    ({"stepping": {"first_step": 1e-3, "max_step": 1e-4}}, "stepping.max_step = 0.0001", "stepping.first_step = 0.001"),
    ({"stepping": {"first_step": 1e-5, "min_step": 1e-4}}, "stepping.first_step = 1e-05", "stepping.min_step = 0.0001"),
    # material
    ({"material.constants": "papersand"}, 'material.constants = "papersand"', 'one of "paper-sand" (did you mean'),
    ({"material.constants": [1]}, "material.constants = [1]", 'must be one of "paper-sand"'),
    ({"material.e_d0": 0.9}, "material.e_d0 = 0.9", "less than e_c0 = 0.82"),
    ({"material.alpha": 2}, "material.alpha = 2", "bracket h_i = -0.494176 is not positive"),
    ({"material.n": "0.4"}, 'material.n = "0.4"', "must be a finite number"),
    # walls
    ({"walls.top.rolling": -1}, "walls.top.rolling = -1", "at least 0"),
    ({"walls.bottom": {**FRACTIONS, "f_s": 0.1}}, "walls.bottom.f_u = 0.8", "f_u + f_r + f_s = 1, but the sum is 1.05"),
    ({"walls.bottom": {"f_u": 0, "f_r": 0.5, "f_s": 0.5}}, "walls.bottom.f_u = 0", "greater than 0 and at most 1"),
    ({"walls.bottom": {"f_u": 0.5, "f_s": 0.5}}, "walls.bottom.f_r is missing", "the other two of f_u, f_r and f_s"),
    ({"walls.bottom": {**FRACTIONS, "rolling": 0.1}}, "walls.bottom.rolling = 0.1", "left out"),
    (
        {"walls.top.constant_height": True},
        "walls.top.normal_stress = -100000.0",
        "left out where constant_height = true",
    ),
    ({"walls.top.normal_stress": ABSENT}, "walls.top.normal_stress is missing", "unless constant_height = true"),
    ({"walls.top.normal_stress": 0}, "walls.top.normal_stress = 0", "less than 0 (Pa, tension positive)"),
    # path
    ({"walls.top.shear_displacement": ABSENT}, "walls.top.shear_displacement = [0.0]", "no wall would move"),
    ({"walls.top.shear_displacement": []}, "walls.top.shear_displacement = []", "a list of 1 to 100000"),
    (
        {"walls.top.shear_displacement": [0.1] * 100_001},
        "walls.top.shear_displacement = [0.1, ",
        "a list of 1 to 100000",
    ),
    ({"walls.top.shear_displacement": [1, 1]}, "walls.top.shear_displacement[1] = 1.0", "must move a wall"),
    ({"walls.top.shear_displacement": [0, 1]}, "walls.top.shear_displacement[0] = 0.0", "must move a wall"),
    (
        {"walls.bottom.shear_displacement": [1, 2]},
        "walls.top.shear_displacement = [0.03]",
        "as many targets as walls.b",
    ),
    # effects
    ({"effects.spin": "marco"}, 'effects.spin = "marco"', 'must be "macro", "cosserat" or "none"'),
    ({"effects.finite_strain": 1}, "effects.finite_strain = 1", 'must be "auto" or true or false'),
    ({"effects": {"spin": "cosserat", "polar": False}}, 'effects.spin = "cosserat"', "where effects.polar = false"),
    ({"effects.polar": False, "walls.top.rolling": 0.1}, "walls.top.rolling = 0.1", "no rotation to prescribe"),
    ({"effects.polar": False, "walls.bottom": FRACTIONS}, "walls.bottom.f_r = 0.15", "no rotation to prescribe"),
    # output
    (
        {"output.profiles_at": [0.01, 0.031]},
        "output.profiles_at[1] = 0.031",
        "relative wall travel (top minus bottom), 0 to",
    ),
    ({"output.profiles_at": [-0.01]}, "output.profiles_at[0] = -0.01", "0 to 0.03 m"),
    ({"output.profiles_at": [0.02, 0.01]}, "output.profiles_at[1] = 0.01", "in the order of the path"),
    ({"output.profiles_at": [0.02, 0.02]}, "output.profiles_at[1] = 0.02", "once each"),
]


@pytest.mark.parametrize(
    ("changes", "subject", "allowed"), BAD_INPUT, ids=[subject[:50] for _, subject, _ in BAD_INPUT]
)
def test_bad_input_is_refused_in_one_line(changes: dict[str, object], subject: str, allowed: str) -> None:
    with pytest.raises(SceneError) as caught:
        parse_scene(changed_layer(changes))
    (line,) = str(caught.value).splitlines()
    assert line.startswith(subject)
    assert allowed in line
    assert "pydantic" not in line
    assert "http" not in line


def test_each_wrong_key_has_its_line() -> None:
    with pytest.raises(SceneError) as caught:
        parse_scene(changed_layer({"geometry.height": -1, "geometry.cells": 0, "effects.spin": 3}))
    keys = [line.split(" = ")[0] for line in str(caught.value).splitlines()]
    assert keys == ["geometry.height", "geometry.cells", "effects.spin"]


def test_many_wrong_keys_are_cut_to_a_readable_number() -> None:
    with pytest.raises(SceneError) as caught:
        parse_scene(changed_layer({"walls.top.shear_displacement": ["far"] * 1000}))
    lines = str(caught.value).splitlines()
    assert len(lines) == 21
    assert lines[-1] == "... and 980 more"
