"""Bad input: exit status 2, one message that names the key, the value and what is allowed, and nothing written."""

import os
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from console import BAD_INPUT, Call, assert_refused, listing, quick
from layers import PRESSURE, demo
from meshes import square, write_msh
from scenes import RECTANGLE, change, to_toml

FRACTIONS = f"walls.top={{f_u=0.8, f_r=0.1, f_s=0.2, shear_displacement=0.03, normal_stress={-PRESSURE}}}"
BAD_KEYS = {
    "an unknown key": ("geometry.cell=80", "geometry.cell = 80: unknown key, did you mean cells?"),
    "a wrong type": ("geometry.cells=many", 'geometry.cells = "many": must be a whole number'),
    "a negative height": ("geometry.height=-0.04", "geometry.height = -0.04: must be a finite number greater than 0"),
    "zero cells": ("geometry.cells=0", "geometry.cells = 0: must be a whole number of at least 1"),
    "too dense": ("initial.void_ratio=0.4", "initial.void_ratio = 0.4: must be greater than e_d = 0.472797"),
    "too loose": ("initial.void_ratio=1.2", "less than e_i = 1.11246"),
    "tension": ("initial.stress=100e3", "initial.stress = 100000.0: must be a finite number less than 0"),
    "e_d0 above e_c0": ("material.e_d0=0.9", "material.e_d0 = 0.9: must be"),
    "a bracket h_i below zero": ("material.alpha=2.0", "material.alpha = 2.0: must"),
    "wall fractions": (FRACTIONS, "walls.top.f_u = 0.8: must make f_u + f_r + f_s = 1, but the sum is 1.1"),
    "profiles beyond the end": ("output.profiles_at=[0.04]", "output.profiles_at[0] = 0.04: must lie within"),
    "a bad override": ("geometry.cells", '"geometry.cells": an override must read key.path=value'),
    "an option that PETSc refuses": ("solver.petsc={snes_type='guess'}", "solver.petsc: PETSc says: "),
}


@pytest.mark.parametrize("case", BAD_KEYS)
def test_a_bad_scene_is_refused_with_one_message_and_nothing_written(case: str, call: Call, tmp_path: Path) -> None:
    override, message = BAD_KEYS[case]
    (tmp_path / "bystander").write_text("stays")
    before = listing(tmp_path)
    assert_refused(call("run", demo("medium_rough"), "--out", tmp_path / "run", "--set", override), message)
    assert listing(tmp_path) == before


PLANE_BAD_KEYS = {
    "an unknown boundary": (
        "boundaries.topp.u1=0",
        "boundaries.topp = {u1 = 0.0}: must name a boundary of the rectangle",
    ),
    "an unknown condition": ("boundaries.top.u3=0", "boundaries.top.u3 = 0: unknown key"),
    "a contradiction": ("boundaries.top.t2=1e3", "boundaries.top.t2 = 1000.0: must be left out where u2 is given"),
    "a wall in the plane": (
        "walls.top.rolling=0.1",
        "walls = {top = {...}}: must be left out, as only geometry.kind = ",
    ),
    "lists of two lengths": (
        "boundaries.top={u2=[0.1, 0], u1=[0.1]}",
        "boundaries.top.u2 = [0.1, 0.0]: must have one entry",
    ),
    "a table that goes back": (
        "boundaries.top.u2={travel=[0, 2, 1], value=[0, 1, 2]}",
        "boundaries.top.u2.travel[2] = 1.0: must be greater than the entry before",
    ),
    "nothing that happens": (
        "boundaries.top.u2=0",
        "boundaries = {bottom = {...}, top = {...}, left = {...}, right = {...}}: must p",
    ),
    "a point outside": ("points.a={at=[1, 0], u1=0}", "points.a.at = [1.0, 0.0]: must lie in the rectangle"),
    "a zone outside": (
        "initial.zones=[{y=[1, 2], void_ratio=0.7}]",
        "initial.zones[0].y = [1.0, 2.0]: must reach into",
    ),
    "a zone too loose": ("initial.zones=[{y=[0, 2], void_ratio=1.2}]", "initial.zones[0].void_ratio = 1.2: must be"),
    "a negative scatter": (
        "initial.random={standard_deviation=-1, correlation_length_d50=4, seed=1}",
        "initial.random.standard_deviation = -1: must be",
    ),
    "a field that is not there": ("initial.field.file=e.csv", 'initial.field.file = "e.csv": must be a file'),
    "a mesh that is not there": ("geometry={kind='mesh', file='a.msh'}", 'geometry.file = "a.msh": must be a file'),
    "cells that coarsen nowhere": (
        "geometry.grading.x={fine='left', ratio=0.5}",
        "geometry.grading.x.ratio = 0.5: must",
    ),
    "no density": ("weight.gravity=9.81", "weight.density is missing: must be a finite number greater than 0"),
    "triangles": ("solver.element=P1", 'solver.element = "P1": must be'),
    "a field beyond the end": ("output.fields_at=0.02", "output.fields_at[0] = 0.02: must lie on the path"),
    "a column of nothing": (
        "output.columns.a={boundary='tip', quantity='u1'}",
        'output.columns.a.boundary = "tip": must name a boundary of the rectangle',
    ),
}


@pytest.mark.parametrize("case", PLANE_BAD_KEYS)
def test_a_bad_plane_scene_is_refused_with_one_message_and_nothing_written(
    case: str, call: Call, tmp_path: Path
) -> None:
    override, message = PLANE_BAD_KEYS[case]
    (tmp_path / "plane.toml").write_text(to_toml(RECTANGLE))
    before = listing(tmp_path)
    outcome = call("run", tmp_path / "plane.toml", "--out", tmp_path / "run", "--set", override)
    assert_refused(outcome, message)
    assert listing(tmp_path) == before


HELD = change(RECTANGLE, {"material.d50": 1e-3, "geometry.cells": [8, 28]})
PLANE_BAD_BODIES = {
    "a body that can move rigidly": ("points={}", "the body can move rigidly, nothing holds its displacement along x1"),
    "grains under no pressure": ("boundaries.left={}", "boundaries.left is missing a condition normal to it"),
    "elements larger than a band": ("geometry.cells=[2, 7]", "geometry.cells = [2, 7]: elements must be smaller"),
    "no such boundary": (
        "boundaries.lid.w=0",
        'boundaries.lid = "lid": must be a boundary of the mesh, bottom, top, l',
    ),
    "no such region": ("initial.zones=[{region='core', void_ratio=0.7}]", 'initial.zones[0].region = "core": must'),
    "cells of another kind": ("solver.element=P1", 'solver.element = "P1": must be "Q1R", "Q1", "Q2Q1" or "auto" on a'),
    "a file without names": ("geometry.file=nameless.msh", "nameless.msh: has no named boundaries: name them in Gmsh"),
    "a file that is none": ("geometry.file=plane.toml", "plane.toml: cannot be read as a mesh file"),
    "a field that is none": ("initial.field.file=plane.toml", "plane.toml: cannot be read as a mesh file"),
}


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize("case", PLANE_BAD_BODIES)
def test_a_bad_plane_body_is_refused_with_one_message_and_nothing_written(
    case: str, command: str, call: Call, tmp_path: Path
) -> None:
    override, message = PLANE_BAD_BODIES[case]
    body = square(8, 28, shape=lambda points: points * (0.04, 0.14))
    write_msh(tmp_path / "plane.msh", body)
    write_msh(tmp_path / "nameless.msh", replace(body, lines={}))
    mesh = {} if "cells" in override else {"geometry": {"kind": "mesh", "file": "plane.msh"}}
    (tmp_path / "plane.toml").write_text(to_toml(change(HELD, mesh)))
    before = listing(tmp_path)
    out = ["--out", tmp_path / "run"] if command == "run" else []
    assert_refused(call(command, tmp_path / "plane.toml", *out, "--set", override), message)
    assert listing(tmp_path) == before


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "scene.toml: cannot be read as a scene file: No such file"), ("[geometry\n", "scene.toml: not valid TOML")],
)
def test_a_bad_file_is_refused(command: str, content: str | None, message: str, call: Call, tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    if content is not None:
        file.write_text(content)
    before = listing(tmp_path)
    assert_refused(call(command, file, *(["--out", tmp_path / "run"] if command == "run" else [])), message)
    assert listing(tmp_path) == before


def test_several_faults_are_told_together(call: Call, tmp_path: Path) -> None:
    faults = ("--set", "geometry.cells=0", "--set", "geometry.height=-1.0")
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "run", *faults)
    assert outcome.status == BAD_INPUT
    assert len(outcome.err.splitlines()) == 2
    assert outcome.err.count("cosserat-fx: ") == 1


def test_a_folder_that_is_no_run_is_left_alone(call: Call, tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    before = listing(tmp_path)
    for more in ([], ["--overwrite"]):
        outcome = call("run", demo("medium_rough"), "--out", tmp_path / "thesis", *quick(), *more)
        assert_refused(outcome, "thesis: holds something other than a run")
        assert listing(tmp_path) == before


def test_an_output_folder_may_be_no_file_and_lie_below_none(call: Call, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("stays")
    before = listing(tmp_path)
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "file", *quick())
    assert_refused(outcome, "file: exists and is not a folder")
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "file" / "below", *quick())
    assert_refused(outcome, "is not a folder")
    assert listing(tmp_path) == before


@pytest.fixture
def no_privileges() -> Iterator[None]:
    """Root may write everywhere; for the test it becomes nobody."""
    if os.getuid() != 0:
        yield
        return
    nobody = 65534
    os.setresuid(nobody, nobody, 0)
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)


@pytest.mark.usefixtures("no_privileges")
@pytest.mark.parametrize("out", ["/usr/run", "/proc/run"])
def test_a_folder_that_may_not_be_written_is_refused(out: str, call: Call) -> None:
    outcome = call("run", demo("medium_rough"), "--out", out, *quick())
    assert_refused(outcome, f"output folder {out}: ")
    assert re.search("no permission to write in|cannot be written", outcome.err)
    assert not Path(out).exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--colour", "red"], "--colour: unknown option; options for PETSc have a single dash"),
        (["another.toml"], "another.toml: unexpected argument; a run takes one scene"),
    ],
)
def test_what_a_run_does_not_know_is_refused(arguments: list[str], message: str, call: Call, tmp_path: Path) -> None:
    assert_refused(call("run", demo("medium_rough"), "--out", tmp_path / "run", *quick(), *arguments), message)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", demo("medium_rough")], "--out"),
        (["check", demo("medium_rough"), "--colour"], "--colour"),
        (["fly"], "fly"),
    ],
)
def test_a_command_line_that_makes_no_sense_is_refused(arguments: list[object], message: str, call: Call) -> None:
    outcome = call(*arguments)
    assert outcome.status == BAD_INPUT
    assert message in outcome.err
    assert "Traceback" not in outcome.err
