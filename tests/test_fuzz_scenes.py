"""Scenes that nobody should write: whatever they hold, they are valid or refused with one clear message.

Cases are the same on every machine; benchmarks/fuzz.py tries thousands of others.
"""

import pytest
from console import Call, assert_refused
from fuzz_bases import FIELD, LAYER, PLANE, Case, document
from fuzz_mutations import PAYLOADS, scene_cases
from fuzzing import assert_same_on_command_line, refusal
from hypothesis import HealthCheck, given, settings
from layers import demo
from scenes import change

NO_EXCUSES = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]


@pytest.mark.parametrize("tables", [LAYER, PLANE], ids=["layer", "plane"])
def test_what_is_broken_here_is_whole_to_begin_with(tables: dict[str, object]) -> None:
    assert refusal(Case({"scene.toml": document(tables), "field.csv": FIELD})) is None


@settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=NO_EXCUSES)
@given(case=scene_cases())
def test_whatever_a_scene_holds_it_is_valid_or_refused_clearly(case: Case) -> None:
    refusal(case)


@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=NO_EXCUSES)
@given(case=scene_cases())
def test_the_command_line_says_the_same(case: Case) -> None:
    assert_same_on_command_line(case, refusal(case))


PLACES = {
    "a title": "title",
    "a name of a material": "material.constants",
    "a file": "initial.field.file",
    "a word": "effects.spin",
    "an option for PETSc": "solver.petsc.snes_type",
    "a number": "geometry.height",
    "a column": "output.columns.force.boundary",
}


@pytest.mark.parametrize("payload", PAYLOADS)
def test_nothing_is_executed_and_what_could_be_is_told_as_text_at_most(payload: str) -> None:
    for key in PLACES.values():
        parent, _, last = key.rpartition(".")
        for place in (key, f"{parent}.{payload}" if "." not in payload else parent):
            tables = change(PLANE, {place or last: payload})
            refusal(Case({"scene.toml": document(tables), "field.csv": FIELD}))
        given = [f"{key}={payload}", f"{payload}={key}"]
        for override in given:
            refusal(Case({"scene.toml": document(PLANE), "field.csv": FIELD}, [override.replace("\0", "")]))


NESTED = "[" * 30 + "]" * 30
HOSTILE = {
    "more frames than memory": (PLANE, "output.frames", 10**12, "output.frames = 1000000000000: must be"),
    "more frames than a number": (PLANE, "output.frames", 10**400, "output.frames = 0x"),
    "more iterations than PETSc counts": (
        LAYER,
        "solver.max_iterations",
        2**31,
        "solver.max_iterations = 2147483648: ",
    ),
    "a preconditioner in Python": (
        LAYER,
        "solver.petsc",
        {"pc_type": "python", "pc_python_type": "os.abort"},
        'solver.petsc.pc_type = "python": must not make PETSc call Python code, as no scene executes anything',
    ),
    "a monitor in Python": (
        LAYER,
        "solver.petsc",
        {"snes_monitor_python": "os.abort"},
        'solver.petsc.snes_monitor_python = "os.abort": must not make PETSc call Python code',
    ),
    "a monitor in a file": (
        LAYER,
        "solver.petsc",
        {"snes_monitor": "ascii:executed"},
        'solver.petsc.snes_monitor = "ascii:executed": must not name a file, as a scene writes to',
    ),
    "an option that PETSc refuses": (
        LAYER,
        "solver.petsc",
        {"snes_rtol": -0.5},
        "solver.petsc: PETSc says: Relative tolerance -0.5 must be",
    ),
    "a circle whose size overflows": (
        PLANE,
        "initial.zones",
        [{"centre": [1e308, -1e308], "radius": 1e200, "void_ratio": 0.7}],
        "initial.zones[0].centre = [1e+308, -1e+308]: must make a circle that reaches into the rectangle",
    ),
    "depth": (
        LAYER,
        "solver.petsc",
        {"a": [[[[{"b": [[[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]]}]]]]},
        "must not be nested more than",
    ),
    "a key of a page": (LAYER, "x" * 5000, 1, "x" * 200 + "... = 1: unknown key"),
    "a key that rings": (LAYER, "\x1b[2J\x07\n", 1, '"\\u001b[2J\\u0007\\n" = 1: unknown key'),
    "more boundaries than bodies have": (
        PLANE,
        "boundaries",
        {f"b{number}": {} for number in range(1_001)},
        "boundaries = 1001: must not be more than 1000",
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_scenes_are_refused(case: str) -> None:
    tables, key, value, message = HOSTILE[case]
    refused = refusal(Case({"scene.toml": document(change(tables, {key: value})), "field.csv": FIELD}), compiling=True)
    assert refused is not None
    assert message in refused
    assert len(refused.splitlines()) == 1


@pytest.mark.parametrize("content", [b"a." * 20_000 + b"a = 1", b"[" + b"a." * 60_000 + b"a]"])
def test_a_scene_that_takes_too_long_to_read_is_refused(content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosserat_fx.guard.SECONDS", 0.2)
    assert refusal(Case({"scene.toml": content})) == "scene.toml: not valid TOML: nested too deeply"


@pytest.mark.parametrize("path", ["a" + ".a" * 60_000, "solver.petsc" + ".a" * 60_000])
def test_an_override_may_not_dig_too_deep(path: str) -> None:
    refused = refusal(Case({"scene.toml": document(LAYER)}, [f"{path}=1"]))
    assert refused is not None
    assert "must not be nested more than 20 tables and lists deep" in refused


def test_an_override_that_takes_too_long_to_read_is_a_text(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosserat_fx.guard.SECONDS", 0.2)
    refused = refusal(Case({"scene.toml": document(LAYER)}, ["geometry.height={" + "a." * 30_000 + "a=1}"]))
    assert refused is not None
    assert refused.startswith('geometry.height = "{a.a.a')


def test_check_refuses_what_petsc_cannot_solve(call: Call) -> None:
    """It sees that in its calibration, not before."""
    outcome = call("check", demo("medium_rough"), "--set", "solver.petsc.pc_factor_mat_solver_type=guess")
    assert_refused(outcome, "solver.petsc: PETSc says: Could not locate solver type guess")
