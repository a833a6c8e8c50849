"""What a scene of a plane body may not say, and how it is told; what looks like it and is taken."""

import pytest
from scenes import (
    ABSENT,
    FRACTIONS,
    changed,
)

from cosserat_fx.scene import SceneError, parse_scene

HISTORY = "must be a finite number, a list of 1 to 100000 finite numbers or a table with the keys travel, value (m)"
BAD_INPUT: list[tuple[dict[str, object], str, str]] = [
    # keys of other kinds, and of none
    (
        {"walls": {"top": {}}},
        "walls = {top = {...}}",
        'only geometry.kind = "layer" has this key; plane bodies have bou',
    ),
    (
        {"solver.integration_points": 2},
        "solver.integration_points = 2",
        'only geometry.kind = "layer" has this key. The',
    ),
    ({"output.profiles_at": 0.1}, "output.profiles_at = 0.1", 'only geometry.kind = "layer" has this key. The keys he'),
    ({"geometry.file": "a"}, 'geometry.file = "a"', 'must be left out, as only geometry.kind = "mesh" has this key'),
    (
        {"boundaries.top.u3": 1},
        "boundaries.top.u3 = 1",
        "unknown key. The keys here are u1, u2, w, t1, t2, couple",
    ),
    ({"boundaries.top.wall": {"roling": 0}}, "boundaries.top.wall.roling = 0", "did you mean rolling?"),
    ({"points.pin": {"at": [0, 0], "t1": 0}}, "points.pin.t1 = 0", "unknown key"),
    (
        {"boundaries.tøp.u2": 1},
        'boundaries."t\\u00f8p" = {u2 = 1.0}',
        "must name a boundary of the rectangle: bottom, to",
    ),
    # types and ranges
    ({"geometry.cells": 80}, "geometry.cells = 80", "a list of 2 whole numbers of at least 1 and at most 10000000"),
    ({"geometry.cells": [80]}, "geometry.cells[1] is missing", "a list of 2 whole numbers"),
    ({"geometry.cells": [80, 0]}, "geometry.cells[1] = 0", "a list of 2 whole numbers of at least 1"),
    ({"geometry.cells": [4000, 4000]}, "geometry.cells = [4000, 4000]", "at most 10000000 cells in all"),
    ({"geometry.width": ABSENT}, "geometry.width is missing", "must be a finite number greater than 0 (m)"),
    ({"geometry.grading": {"x": {"fine": "left", "ratio": 0.5}}}, "geometry.grading.x.ratio = 0.5", "of at least 1"),
    (
        {"geometry.grading": {"x": {"fine": "top", "ratio": 2}}},
        'geometry.grading.x.fine = "top"',
        '"left", "right", "c',
    ),
    ({"geometry.grading": {"y": {"fine": "left", "ratio": 2}}}, 'geometry.grading.y.fine = "left"', '"bottom", "top"'),
    ({"boundaries": 3}, "boundaries = 3", "must be a table"),
    ({"boundaries.top": 3}, "boundaries.top = 3", "must be a table with the keys u1, u2, w, t1, t2, couple, pressure"),
    ({"boundaries.top.u2": "far"}, 'boundaries.top.u2 = "far"', HISTORY),
    ({"boundaries.top.u2": True}, "boundaries.top.u2 = true", HISTORY),
    ({"boundaries.top.u2": [1, "far"]}, 'boundaries.top.u2[1] = "far"', HISTORY),
    ({"boundaries.top.u2": []}, "boundaries.top.u2 = []", HISTORY),
    ({"boundaries.top": {"pressure": "a"}}, 'boundaries.top.pressure = "a"', "(Pa, compression positive)"),
    (
        {"boundaries.top.rotational_resistance": -1},
        "boundaries.top.rotational_resistance = -1",
        "of at least 0 (N/m per",
    ),
    ({"weight": {"density": 0}}, "weight.density = 0", "greater than 0 (kg/m3)"),
    ({"solver.element": "Q3"}, 'solver.element = "Q3"', '"auto", "Q1R", "Q1", "Q2Q1", "P1" or "P2P1"'),
    ({"solver.hourglass": -1}, "solver.hourglass = -1", "of at least 0"),
    ({"stepping.branch": "any"}, 'stepping.branch = "any"', 'must be "stable" or "primary"'),
    ({"solver.element": "P1"}, 'solver.element = "P1"', '"Q1R", "Q1", "Q2Q1" or "auto" on a mesh of quad'),
    # histories
    (
        {"boundaries.top.u2": {"travel": [0, 1]}},
        "boundaries.top.u2.value is missing",
        "a list of 2 to 100000 finite num",
    ),
    (
        {"boundaries.top.u2": {"travel": 1, "value": [0, 1]}},
        "boundaries.top.u2.travel = 1",
        "a list of 2 to 100000 finite n",
    ),
    ({"boundaries.top.u2": {"travel": [1, 2], "value": [0, 1]}}, "boundaries.top.u2.travel[0] = 1.0", "must be 0"),
    (
        {"boundaries.top.u2": {"travel": [0, 2, 2], "value": [0, 1, 2]}},
        "boundaries.top.u2.travel[2] = 2.0",
        "greater th",
    ),
    (
        {"boundaries.top.u2": {"travel": [0, 2], "value": [0, 1, 2]}},
        "boundaries.top.u2.value = [",
        "as many entries as",
    ),
    (
        {"boundaries.top.u2": {"travel": [0, 2], "value": [1, 2]}},
        "boundaries.top.u2.value[0] = 1.0",
        "starts undeformed",
    ),
    (
        {"boundaries.top.u2": {"travel": [0, 2], "value": [0, 2], "travels": 3}},
        "boundaries.top.u2.travels = 3",
        "unknown key, did you mean travel? The keys here are travel, value",
    ),
    (
        {"boundaries.top.u2": [1, 2], "boundaries.right.pressure": [1, 2, 3]},
        "boundaries.right.pressure = [1.0, 2.0, 3.0]",
        "one entry for each leg of the path: boundaries.top.u2 has 2, and not 3",
    ),
    (
        {"boundaries.top.u2": {"travel": [0, 1, 2], "value": [0, 1, 2]}, "boundaries.top.u1": [1, 2, 3]},
        "boundaries.top.u1 = [1.0, 2.0, 3.0]",
        "the travels of the tables make 2, and not 3",
    ),
    ({"boundaries.top.u2": [1e308, -1e308]}, "boundaries.top.u2 = [1e+308, -1e+308]", "no finite length"),
    (
        {"boundaries.top.u2": 0},
        "boundaries = {bottom = {...}, top = {...}, left = {...}, right = {...",
        "nothing would happen",
    ),
    ({"boundaries": ABSENT}, "boundaries is missing", "nothing would happen"),
    ({"boundaries": {"top": {"pressure": 100e3}}}, "boundaries = {top = {...}}", "does not balance initial.stress"),
    # contradictions
    ({"boundaries.top.t2": 1}, "boundaries.top.t2 = 1.0", "left out where u2 is given"),
    ({"boundaries.top": {"u1": 0, "t1": 1}}, "boundaries.top.t1 = 1.0", "left out where u1 is given"),
    (
        {"boundaries.top.symmetry": True},
        "boundaries.top.symmetry = true",
        "left out where u2 is given, as symmetry says",
    ),
    ({"boundaries.top": {"t1": 0, "symmetry": True}}, "boundaries.top.symmetry = true", "left out where t1 is given"),
    ({"boundaries.top": {"t1": 0, "pressure": 1}}, "boundaries.top.pressure = 1.0", "left out where t1 is given"),
    (
        {"boundaries.top": {"u1": 0, "u2": 0, "pressure": 1}},
        "boundaries.top.pressure = 1.0",
        "where u1 and u2 are given",
    ),
    ({"boundaries.top.pressure": 1}, "boundaries.top.pressure = 1.0", "where u2 is given, the displacement normal to"),
    ({"boundaries.left": {"u1": 0, "pressure": 1}}, "boundaries.left.pressure = 1.0", "where u1 is given"),
    ({"boundaries.top": {"w": 0, "couple": 0}}, "boundaries.top.couple = 0.0", "left out where w is given"),
    (
        {"boundaries.top": {"w": 0, "rotational_resistance": 1}},
        "boundaries.top.rotational_resistance = 1",
        "where w is",
    ),
    ({"boundaries.top.wall": {}}, "boundaries.top.wall = {", "left out where u2 is given, as a wall says all"),
    ({"boundaries.top": {"wall": {}, "symmetry": True}}, "boundaries.top.wall = {", "left out where symmetry is given"),
    ({"boundaries.top": {"wall": {"rolling": 1, **FRACTIONS}}}, "boundaries.top.wall.rolling = 1", "must be left out"),
    (
        {"boundaries.top": {"wall": {"f_u": 1}}},
        "boundaries.top.wall.f_r is missing",
        "the other two of f_u, f_r and f_s",
    ),
    ({"boundaries.top": {"wall": {"u2": 1, "pressure": 1}}}, "boundaries.top.wall.u2 = 1.0", "must be 0"),
    ({"boundaries.top": {"wall": {"u1": 1, "free": True}}}, "boundaries.top.wall.u1 = 1.0", "must be 0"),
    ({"points.pin": {"at": [0, 0]}}, "points.pin.u1 is missing", "unless u2 or w is"),
    # without rotations
    ({"effects.polar": False, "boundaries.top.w": 1}, "boundaries.top.w = 1.0", "where effects.polar = false"),
    (
        {"effects.polar": False, "boundaries.top.couple": 1},
        "boundaries.top.couple = 1.0",
        "where effects.polar = false",
    ),
    ({"effects.polar": False, "points.a": {"at": [0, 0], "w": 1}}, "points.a.w = 1.0", "where effects.polar = false"),
    (
        {"effects.polar": False, "boundaries.left": {"wall": {"rolling": 1}}},
        "boundaries.left.wall.rolling = 1",
        "where effects.polar = false",
    ),
    (
        {"effects.polar": False, "output.columns.a": {"boundary": "top", "quantity": "w"}},
        'output.columns.a.quantity = "w"',
        "where effects.polar = false",
    ),
    # places
    (
        {"points.pin": {"at": [0, 0.15], "u1": 0}},
        "points.pin.at = [0.0, 0.15]",
        "must lie in the rectangle, [0, 0] to [0",
    ),
    ({"points.pin": {"at": [0, 0, 0], "u1": 0}}, "points.pin.at = [0, 0, 0]", "must be a list of 2 finite numbers (m)"),
    ({"initial.zones": {"x": [0, 1]}}, "initial.zones = {x = [...]}", "must be a list of tables with the keys x, y, c"),
    (
        {"initial.zones": [{"void_ratio": 0.7}]},
        "initial.zones[0] = {void_ratio = 0.7}",
        "must say where: x and/or y, cen",
    ),
    ({"initial.zones": [{"x": [1, 0], "void_ratio": 0.7}]}, "initial.zones[0].x = [1.0, 0.0]", "ascending"),
    (
        {"initial.zones": [{"x": [0.05, 1], "void_ratio": 0.7}]},
        "initial.zones[0].x = [0.05, 1.0]",
        "reach into the body",
    ),
    ({"initial.zones": [{"x": [0, 1]}]}, "initial.zones[0].void_ratio is missing", "greater than 0"),
    (
        {"initial.zones": [{"x": [0, 1], "void_ratio": 1.2}]},
        "initial.zones[0].void_ratio = 1.2",
        "less than e_i = 1.112",
    ),
    (
        {"initial.zones": [{"region": "a", "void_ratio": 0.7}]},
        'initial.zones[0].region = "a"',
        "only meshes from files",
    ),
    (
        {"initial.zones": [{"radius": 1, "void_ratio": 0.7}]},
        "initial.zones[0].centre is missing",
        "a centre and a radi",
    ),
    (
        {"initial.zones": [{"centre": [0, 0], "void_ratio": 0.7}]},
        "initial.zones[0].radius is missing",
        "a centre and a",
    ),
    (
        {"initial.zones": [{"x": [0, 1], "radius": 1, "void_ratio": 0.7}]},
        "initial.zones[0].radius = 1",
        "left out where x is given",
    ),
    (
        {"initial.zones": [{"centre": [-1, -1], "radius": 1.4, "void_ratio": 0.7}]},
        "initial.zones[0].centre = [-1.0, -1.0]",
        "must make a circle that reaches into the rectangle, 0.04 by 0.14 m",
    ),
    (
        {"initial.random": {"standard_deviation": 0, "correlation_length_d50": 1, "seed": 1}},
        "initial.random.standard_deviation = 0",
        "greater than 0",
    ),
    (
        {"initial.random": {"standard_deviation": 1, "correlation_length_d50": 1, "seed": -1}},
        "initial.random.seed = -1",
        "at least 0",
    ),
    # output
    (
        {"output.fields_at": [0.005, 0.011]},
        "output.fields_at[1] = 0.011",
        "must lie on the path, whose travel is 0 to 0.01",
    ),
    ({"output.fields_at": [-0.001]}, "output.fields_at[0] = -0.001", "must lie on the path"),
    ({"output.fields_at": [0.002, 0.002]}, "output.fields_at[1] = 0.002", "greater than the entry before"),
    ({"output.frames": -1}, "output.frames = -1", "at least 0"),
    ({"output.columns.a": {"quantity": "u1"}}, "output.columns.a.boundary is missing", "must be a string"),
    (
        {"output.columns.a": {"boundary": "top", "quantity": "u3"}},
        'output.columns.a.quantity = "u3"',
        '"force1", "force2"',
    ),
    (
        {"output.columns.a": {"boundary": "tip", "quantity": "u1"}},
        'output.columns.a.boundary = "tip"',
        "must name a boundary of the rectangle: bottom, top, left, right",
    ),
    ({"output.columns.2a": {"boundary": "top", "quantity": "u1"}}, "output.columns.2a = {", "beginning with a letter"),
    (
        {"output.columns.a b": {"boundary": "top", "quantity": "u1"}},
        'output.columns."a b" = {',
        "letters, digits and un",
    ),
    (
        {"output.columns.step": {"boundary": "top", "quantity": "u1"}},
        "output.columns.step = {",
        "must have another name",
    ),
    ({"output.columns.top_u1_m": {"boundary": "top", "quantity": "u1"}}, "output.columns.top_u1_m = {", "another name"),
]


@pytest.mark.parametrize(
    ("changes", "subject", "allowed"), BAD_INPUT, ids=[subject[:50] for _, subject, _ in BAD_INPUT]
)
def test_bad_input_is_refused_in_one_line(changes: dict[str, object], subject: str, allowed: str) -> None:
    with pytest.raises(SceneError) as caught:
        parse_scene(changed(changes))
    (line,) = str(caught.value).splitlines()
    assert line.startswith(subject)
    assert allowed in line
    assert "pydantic" not in line


@pytest.mark.parametrize(
    "changes",
    [
        {"boundaries.top": {"u1": 0.01, "t2": -50e3}},
        {"boundaries.top": {"u1": 0.01, "pressure": 50e3}},
        {"boundaries.top": {"u2": 0.0, "couple": 1.0, "rotational_resistance": 5.0}},
        {"boundaries.top": {"wall": {"u1": 0.01, "pressure": 50e3, "rolling": 0.1}}},
        {"boundaries.top": {"wall": {"u2": -0.01, "free": True, **FRACTIONS}}},
        {"boundaries.top.u2": 0.0, "weight.density": 1600.0},
        {"boundaries": {"top": {"pressure": 200e3}}},
        {"boundaries.top": {"pressure": [100e3, 200e3]}},
        {"boundaries.left": {}},
        {"effects.polar": False, "boundaries.top.w": 0.0, "boundaries.left": {"symmetry": True}},
        {"initial.zones": [{"x": [-1.0, 1e-6], "void_ratio": 0.7}]},
        {"points.corner": {"at": [0.04, 0.1 + 0.04], "u1": 0.0}},
    ],
)
def test_what_goes_together_is_taken(changes: dict[str, object]) -> None:
    parse_scene(changed(changes))
