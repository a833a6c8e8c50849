"""The memory that a run is said to need against what it takes, and the refusal of what does not fit."""

import json
import re
import resource
from pathlib import Path
from typing import Any

import pytest
from console import Call, assert_refused, listing
from fuzz_bases import LAYER
from layers import demo
from meshes import square, write_msh
from ranks import on_ranks
from scenes import RECTANGLE, change, to_toml

from cosserat_fx import memory
from cosserat_fx._compat import MPI
from cosserat_fx.bodies import build
from cosserat_fx.cost import expected_cost
from cosserat_fx.machine import limit_of_process, memory_of_node
from cosserat_fx.memory import Sizes, available_memory, footprint, in_words, refuse_too_large
from cosserat_fx.scene import SceneError, load_scene, parse_scene
from cosserat_fx.weakform import Numerics

SMALL_MACHINE = 305e6
"""Has room for the program, and for little else (bytes)."""


def strip(nx: int, ny: int, changes: dict[str, object]) -> dict[str, Any]:
    """A rectangle of 1 mm grains and 2.5 mm cells."""
    size = {"kind": "rectangle", "width": 2.5e-3 * nx, "height": 2.5e-3 * ny, "cells": [nx, ny]}
    return change(RECTANGLE, {"geometry": size, "material": {"d50": 1e-3}, **changes})


def on_mesh(folder: Path, nx: int, ny: int, changes: dict[str, object]) -> dict[str, Any]:
    """The same of triangles, from a file."""
    body = square(nx, ny, "triangle", lambda points: points * (2.5e-3 * nx, 2.5e-3 * ny))
    file = {"kind": "mesh", "file": str(write_msh(folder / "body.msh", body))}
    return change(strip(nx, ny, changes), {"geometry": file})


@pytest.fixture
def small_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "memory_of_node", lambda: SMALL_MACHINE)


# -- the estimate ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("element", "changes"),
    [
        ("Q1R", {}),
        ("Q1", {"effects.polar": False}),
        ("Q2Q1", {"effects.void_ratio": False}),
        ("P1", {}),
        ("P2P1", {}),
        ("P2P1", {"effects.polar": False}),
    ],
)
def test_plane_bodies_take_what_was_estimated(element: str, changes: dict[str, object], tmp_path: Path) -> None:
    """The state exactly; the rows of a matrix are shorter at the border, and MUMPS counts in megabytes."""
    make = strip if element.startswith("Q") else lambda *sizes: on_mesh(tmp_path, *sizes)
    cost = expected_cost(build(parse_scene(make(20, 70, {"solver.element": element, **changes})), MPI.COMM_SELF))
    assert cost.expected.state == cost.state_bytes
    assert cost.expected.matrix == pytest.approx(12 * cost.nonzeros, rel=0.2)
    assert cost.factor_bytes is not None
    assert 1 / 1.5 < cost.expected.factors / cost.factor_bytes < 1.5


@pytest.mark.parametrize("points", [1, 2])
def test_layers_take_what_was_estimated(points: int) -> None:
    scene = load_scene(demo("medium_rough"), ["geometry.cells=20000", f"solver.integration_points={points}"])
    cost = expected_cost(build(scene, MPI.COMM_SELF))
    assert cost.expected.state == cost.state_bytes
    assert cost.expected.matrix == pytest.approx(12 * cost.nonzeros, rel=0.01)
    assert cost.factor_bytes is not None
    assert 1 / 1.5 < cost.expected.factors / cost.factor_bytes < 1.5


WHOLE = """
import json, sys
from cosserat_fx._compat import MPI
from cosserat_fx.bodies import build
from cosserat_fx.cost import expected_cost
from cosserat_fx.scene import parse_scene
cost = expected_cost(build(parse_scene(json.loads(sys.argv[1])), MPI.COMM_WORLD))
[peak] = [int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM")]
total = MPI.COMM_WORLD.allreduce(1024 * peak)
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([cost.expected.total, total]))
"""


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_program_takes_in_all_what_was_estimated(ranks: int) -> None:
    scene = json.dumps(strip(64, 224, {"output": {"figures": False}}))
    expected, taken = json.loads(on_ranks(ranks, WHOLE, scene))
    assert 1 / 1.5 < expected / taken < 1.5


def test_the_shorter_side_decides_how_factors_fill() -> None:
    """Of as many cells, a square fills in more than a strip."""
    square_one, thin = (
        footprint(
            parse_scene(RECTANGLE), Numerics(), Sizes("plane", "quadrilateral", 1_000_000, 1_000_000, across), ranks=1
        )
        for across in (1000, 10)
    )
    assert thin.factors < 0.5 * square_one.factors
    assert (thin.state, thin.matrix, thin.rest) == (square_one.state, square_one.matrix, square_one.rest)


def test_cost_tells_the_whole_and_what_there_is() -> None:
    cost = expected_cost(build(load_scene(demo("medium_rough")), MPI.COMM_SELF))
    assert f"about {in_words(cost.expected.total)} in all, of {in_words(cost.available)}" in str(cost)
    assert cost.available == available_memory(MPI.COMM_SELF)


# -- the refusal -------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("small_machine")
@pytest.mark.parametrize("command", ["check", "run"])
@pytest.mark.parametrize("kind", ["layer", "rectangle", "mesh"])
def test_what_does_not_fit_is_refused(kind: str, command: str, call: Call, tmp_path: Path) -> None:
    file, value = tmp_path / "scene.toml", "[32, 112]"
    if kind == "layer":
        file.write_text(demo("medium_rough").read_text().replace("cells = 80", "cells = 5000"))
        value = "5000"
    else:
        file.write_text(to_toml(strip(32, 112, {}) if kind == "rectangle" else on_mesh(tmp_path, 32, 112, {})))
        value = value if kind == "rectangle" else '"'
    before = listing(tmp_path)
    key = "file" if kind == "mesh" else "cells"
    outcome = call(command, file, *(["--out", tmp_path / "run"] if command == "run" else []))
    assert_refused(outcome, f"geometry.{key} = {value}")
    assert "must make a problem that fits into the memory of this machine, 305 MB, but this one would" in outcome.err
    assert re.search(r"need about \d{3} MB \(state", outcome.err)
    assert listing(tmp_path) == before


@pytest.mark.usefixtures("small_machine")
@pytest.mark.parametrize("cells", [10_000_000, [3000, 3000]])
def test_nothing_is_allocated_for_what_does_not_fit(cells: object, monkeypatch: pytest.MonkeyPatch) -> None:
    def made(*arguments: object, **more: object) -> None:
        pytest.fail("a mesh was made")

    monkeypatch.setattr("cosserat_fx.geometry.layer", made)
    monkeypatch.setattr("cosserat_fx.geometry.rectangle", made)
    if isinstance(cells, int):
        scene = load_scene(demo("medium_rough"), [f"geometry.cells={cells}"])
    else:
        scene = parse_scene(strip(3000, 3000, {}))
    with pytest.raises(SceneError, match=r"fits into the memory of this machine, 305 MB, but .* need about \d+"):
        build(scene, MPI.COMM_SELF)


def test_other_solvers_take_no_memory_for_factors(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(demo("medium_rough"), ["geometry.cells=1000000", "output.figures=false"])
    monkeypatch.setattr(memory, "memory_of_node", lambda: 2.4e9)
    with pytest.raises(SceneError, match="factors"):
        refuse_too_large(scene, MPI.COMM_SELF)
    refuse_too_large(scene, MPI.COMM_SELF, {"pc_type": "jacobi"})


@pytest.mark.parametrize(
    ("tables", "subject"),
    [
        (strip(8, 28, {"output": {"frames": 100_000}}), "output.frames = 100000: "),
        (
            strip(8, 28, {"output": {"frames": 0, "fields_at": [1e-7 * n for n in range(100_000)]}}),
            "output.fields_at = [",
        ),
        (change(LAYER, {"output": {"profiles_at": [1e-7 * n for n in range(100_000)]}}), "output.profiles_at = ["),
    ],
    ids=["frames", "fields", "profiles"],
)
def test_figures_that_do_not_fit_are_refused_unless_they_are_not_drawn(
    tables: dict[str, Any], subject: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "memory_of_node", lambda: 0.7e9)
    with pytest.raises(SceneError, match=r"figures \d") as caught:
        refuse_too_large(parse_scene(tables), MPI.COMM_SELF)
    assert str(caught.value).startswith(subject)
    refuse_too_large(parse_scene(change(tables, {"output.figures": False})), MPI.COMM_SELF)


REFUSALS = """
import sys
from cosserat_fx import memory
from cosserat_fx._compat import MPI
from cosserat_fx.scene import SceneError, parse_scene
import json
import re
memory.memory_of_node = lambda: 610e6
comm = MPI.COMM_WORLD
try:
    memory.refuse_too_large(parse_scene(json.loads(sys.argv[1])), comm)
    said = ""
except SceneError as error:
    said = str(error)
told = comm.gather([said, memory.available_memory(comm)])
if comm.rank == 0:
    print(json.dumps(told))
"""


def test_ranks_share_the_memory_of_their_node_and_agree() -> None:
    """What fits for one rank does not for two, each of which needs the program."""
    scene = json.dumps(strip(32, 112, {"output": {"figures": False}}))
    one, two = (json.loads(on_ranks(ranks, REFUSALS, scene)) for ranks in (1, 2))
    assert one == [["", 610e6]]
    assert two[0] == two[1]
    assert two[0][1] == 610e6
    assert re.search(r"this machine, 610 MB, but this one would need about 6\d\d MB", two[0][0])


# -- the machine -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "file", "limit"),
    [
        ("0::/", "memory.max", 5000),
        ("0::/user/job", "user/job/memory.max", 5000),
        ("0::/user/job", "user/memory.max", 5000),
        ("0::/user/job", "user/memory.max", None),
        ("4:memory:/user/job", "memory/user/job/memory.limit_in_bytes", 5000),
        ("4:memory:/outside/the/container", "memory/memory.limit_in_bytes", 5000),
        ("4:cpu,cpuacct:/job", "job/memory.max", None),
    ],
)
def test_limits_of_control_groups_hold(line: str, file: str, limit: int | None, tmp_path: Path) -> None:
    groups = tmp_path / "groups"
    told = groups / file
    told.parent.mkdir(parents=True)
    told.write_text("max\n" if limit is None and "cpu" not in line else "5000\n")
    (tmp_path / "membership").write_text(f"9:name=systemd:/\n{line}\n")
    (tmp_path / "none").write_text("")
    whole = memory_of_node(groups, tmp_path / "none")
    assert whole > 1e8
    assert memory_of_node(groups, tmp_path / "membership") == (limit or whole)


def test_without_control_groups_it_is_the_physical_memory(tmp_path: Path) -> None:
    assert memory_of_node(tmp_path / "nowhere", tmp_path / "nowhere") >= memory_of_node()


def test_a_limit_on_the_process_holds() -> None:
    limits = resource.getrlimit(resource.RLIMIT_AS)
    free = limit_of_process()
    resource.setrlimit(resource.RLIMIT_AS, (50 * 10**9, limits[1]))
    try:
        assert 0 < limit_of_process() < 50 * 10**9
        assert available_memory(MPI.COMM_SELF) <= limit_of_process()
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)
    assert limit_of_process() == free


def test_sizes_are_told_with_their_unit() -> None:
    assert [in_words(size) for size in (1.234e6, 9.99e8, 1e9, 4.123e11)] == ["1.23 MB", "999 MB", "1 GB", "412 GB"]
