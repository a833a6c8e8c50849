"""A step costs compiled work and nothing else: no Python per point, nothing compiled or created on the way."""

import gc
import sys
import weakref
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from layers import NOTHING_TO_LOOK_AT, WALLS, demo, scene, walk

from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.layer import Layer, build
from cosserat_fx.layout import layout
from cosserat_fx.results import Run
from cosserat_fx.run import run
from cosserat_fx.scene import load_scene
from cosserat_fx.timing import Stopwatch
from cosserat_fx.update import build_update


def jit_cache() -> Path:
    return Path(str(dolfinx.jit.get_options()["cache_dir"])).expanduser()


def compiled_forms() -> dict[str, int]:
    """Everything in the cache of compiled forms with its time."""
    return {path.name: path.stat().st_mtime_ns for path in jit_cache().iterdir()}


def test_a_second_run_compiles_nothing(tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """The forms come from the cache on disk, the kernel from this process, whatever the mesh."""
    assert default_runs
    kernel: Any = build_update(layout("layer"), spin=True, void_ratio=True)
    forms, signatures = compiled_forms(), list(kernel.func.signatures)
    assert len(signatures) == 1
    assert forms
    walk(tmp_path / "run", "medium_rough", "geometry.cells=50", "stepping.max_steps=3")
    assert compiled_forms() == forms
    assert kernel.func.signatures == signatures


def test_a_walk_creates_no_form_space_or_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    layer = build(scene("medium_rough"), MPI.COMM_SELF)

    def forbidden(*arguments: Any, **keywords: Any) -> None:
        pytest.fail("something is compiled or created on the way")

    for owner, names in (
        (dolfinx.fem, ("form", "Expression", "functionspace", "Function", "Constant", "dirichletbc")),
        (dolfinx.fem, ("create_matrix",)),
        (dolfinx.fem.petsc, ("create_matrix", "create_vector")),
        (dolfinx.jit, ("ffcx_jit",)),
    ):
        for name in names:
            monkeypatch.setattr(owner, name, forbidden)
    steps = iter(layer.stepper)
    handles, nonzeros = set(), set()
    for _ in range(3):
        next(steps)
        handles.add((layer.problem.matrix.handle, layer.problem.vector.handle))
        info = layer.problem.matrix.getInfo()
        nonzeros.add((info["nz_allocated"], info["nz_used"], info["mallocs"]))
    assert len(handles) == len(nonzeros) == 1
    assert info["mallocs"] == 0


def python_calls(layer: Layer) -> int:
    """How many Python functions one evaluation of residual and Jacobian calls, compiled ones included."""
    problem, count = layer.problem, 0

    def watch(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    problem.apply(1e-4)
    problem.impose()
    for _ in range(2):  # the first time fills caches
        count = 0
        sys.setprofile(watch)
        try:
            problem.update(adapt=True)
            problem.assemble_residual(problem.vector)
            problem.assemble_jacobian()
        finally:
            sys.setprofile(None)
    return count


def test_the_python_work_of_an_iteration_does_not_depend_on_the_number_of_points() -> None:
    calls = [python_calls(build(scene("medium_rough", f"geometry.cells={n}"), MPI.COMM_SELF)) for n in (20, 640)]
    assert 0 < calls[0] == calls[1] < 500


def test_every_iteration_enters_every_phase_equally_often_on_80_and_640_cells(
    tmp_path: Path, default_runs: dict[str, Run]
) -> None:
    """One Jacobian an iteration, and little more than one update and one residual."""
    fine = walk(tmp_path / "run", "very_rough", "geometry.cells=640", "stepping.max_steps=15")
    for summary in (default_runs["very_rough"].summary, fine.summary):
        calls, iterations, steps = summary["calls"], summary["newton_iterations"], summary["steps"]
        assert iterations <= calls["Jacobian assembly"] <= iterations + steps
        for phase in ("strains", "constitutive update"):
            assert iterations + steps <= calls[phase] <= 1.2 * iterations + 3 * steps
        assert iterations <= calls["residual assembly"] <= 1.2 * iterations + 2 * steps
        assert calls["output"] == steps


@pytest.mark.parametrize("wall", WALLS)
def test_the_phases_add_up_to_the_run(wall: str, tmp_path: Path) -> None:
    """What is in no phase, Python between the phases, is less than a third of a short run; none is counted twice."""
    run(load_scene(demo(wall), NOTHING_TO_LOOK_AT), tmp_path / "warm")
    seconds = walk(tmp_path / "run", wall, "geometry.cells=640").summary["seconds"]
    whole = seconds.pop("whole run")
    assert 0.67 * whole < sum(seconds.values()) <= whole
    assert seconds["constitutive update"] > 0.3 * whole


def test_phases_inside_others_are_counted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks: Iterator[float] = iter([0.0, 1.0, 4.0, 10.0, 20.0, 23.0])
    monkeypatch.setattr("cosserat_fx.timing.perf_counter", lambda: next(ticks))
    watch = Stopwatch()
    with watch("outer"), watch("inner"):
        pass
    with watch("inner"):
        pass
    assert dict(watch.seconds) == {"outer": 10.0 - 3.0, "inner": 3.0 + 3.0}
    assert dict(watch.calls) == {"outer": 1, "inner": 2}


def test_a_layer_that_nobody_holds_is_gone() -> None:
    """PETSc keeps its callbacks where Python's garbage collector does not see them; they must not hold the problem."""
    layer = build(scene("medium_rough"), MPI.COMM_SELF)
    next(iter(layer.stepper))
    problem = weakref.ref(layer.problem)
    del layer
    gc.collect()
    assert problem() is None
