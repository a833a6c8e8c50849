"""The cache of compiled forms: marks of killed processes are removed, and what waited for them is done again."""

import os
from pathlib import Path
from time import time

import pytest
from planes import BASE, BIAXIAL
from scenes import change

from cosserat_fx import bodies
from cosserat_fx import run as runs
from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.form_cache import PATIENCE, remove_abandoned, with_forms
from cosserat_fx.output.recording import Recording
from cosserat_fx.results import read_run
from cosserat_fx.scene import parse_scene


def mark(folder: Path, name: str, age: float, *, done: bool) -> Path:
    """The file by which a form is marked, and the one that says that it is compiled."""
    file = folder / f"libffcx_forms_{name}.c"
    file.touch()
    os.utime(file, (time() - age, time() - age))
    if done:
        file.with_suffix(".c.cached").touch()
    return file


def test_marks_of_killed_processes_are_removed_and_no_others(tmp_path: Path) -> None:
    abandoned = mark(tmp_path, "abandoned", PATIENCE + 60, done=False)
    going_on, compiled = mark(tmp_path, "new", 0, done=False), mark(tmp_path, "old", PATIENCE + 60, done=True)
    remove_abandoned(tmp_path)
    assert not abandoned.exists()
    assert going_on.exists()
    assert compiled.exists()
    remove_abandoned(tmp_path / "absent")


@pytest.mark.parametrize("error", [TimeoutError("JIT compilation timed out"), RuntimeError("Failed JIT compilation")])
def test_what_waited_in_vain_is_done_again_without_the_mark(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dolfinx.jit, "get_options", lambda: {"cache_dir": tmp_path})
    monkeypatch.setitem(dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS, "timeout", (10, ""))
    abandoned = mark(tmp_path, "abandoned", 0, done=False)

    def compile_form() -> str:
        if not abandoned.exists():
            return "compiled"
        os.utime(abandoned, (0, 0))  # so long did it wait
        raise error

    assert with_forms(MPI.COMM_SELF, compile_form) == "compiled"
    assert dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS["timeout"][0] == PATIENCE


def test_other_errors_are_not_tried_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def fail() -> None:
        calls.append(1)
        raise RuntimeError("something else")

    with pytest.raises(RuntimeError, match="something else"):
        with_forms(MPI.COMM_SELF, fail)
    assert len(calls) == 1


def test_a_run_is_set_up_again_where_it_waited_in_vain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The forms of what observes the body as well as those of the body; nothing is in the folder twice."""
    waited: list[bodies.Body] = []

    def wait_once(body: bodies.Body) -> Recording:
        if not waited:
            waited.append(body)
            raise TimeoutError("JIT compilation timed out")
        return bodies.recording_of(body)

    monkeypatch.setattr(runs, "recording_of", wait_once)
    scene = parse_scene(change(BASE, BIAXIAL | {"stepping": {"max_steps": 1}, "output": {"figures": False}}))
    ledger = runs.run(scene, tmp_path / "run", comm=MPI.COMM_SELF)
    assert len(waited) == ledger.steps == len(read_run(tmp_path / "run").history["step"]) == 1
