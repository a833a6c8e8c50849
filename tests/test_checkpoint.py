"""Checkpoints: a run in two halves is the run in one, and a checkpoint that is not good is never gone on from."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from console import BAD_INPUT, DONE, STOPPED, Call, assert_refused, listing, quick, settings
from halves import AFTER, all_pairs, first_half
from hypothesis import given
from hypothesis import strategies as st
from layers import demo
from meshes import square, write_msh
from planes import BASE, BIAXIAL
from ranks import on_ranks
from scenes import change, to_toml

import cosserat_fx.checkpoint
from cosserat_fx._compat import MPI
from cosserat_fx.bodies import build, recording_of
from cosserat_fx.checkpoint import SHARE, CheckpointError, Checkpoints
from cosserat_fx.checkpoints import file as checkpoint_file
from cosserat_fx.checkpoints import identity
from cosserat_fx.results import OutputError, RunFolder, read_run
from cosserat_fx.run import run
from cosserat_fx.scene import parse_scene

LAYER: dict[str, Any] = {
    "geometry": {"height": 0.01, "cells": 12},
    "initial": {"stress": -100e3, "void_ratio": 0.6},
    "walls": {
        "top": {"rolling": 0.0125, "normal_stress": -120e3, "shear_displacement": [0.001, 0.0006]},
    },
    "output": {"profiles_at": [0.0005, 0.001], "figures": False},
}
"""A normal stress that is brought up first, shear, and a reversal."""
COMPRESSION = change(
    BASE,
    BIAXIAL
    | {
        "initial.zones": [{"x": [0.0, 0.01], "y": [0.0, 0.01], "void_ratio": 0.65}],
        "boundaries.top.u2": -0.0006,
        "output": {"figures": False, "animation": False, "fields_at": [0.0003, 0.0006]},
    },
)
"""A body that is not alike everywhere: where it were, rounding would decide where it gives way."""
ELEMENTS = {"Q1R": "quad", "Q1": "quad", "Q2Q1": "quad", "P1": "triangle", "P2P1": "triangle"}


def scene_of(kind: str, tmp_path: Path) -> dict[str, Any]:
    """Tables of a scene by its kind or element."""
    if kind == "layer":
        return LAYER
    if kind == "classical":
        return change(COMPRESSION, {"effects.polar": False})
    file = write_msh(tmp_path / f"{kind}.msh", square(3, 4, ELEMENTS[kind]))
    mesh = {"geometry": {"kind": "mesh", "file": str(file), "scale": 0.02}, "solver": {"element": kind}}
    return change(COMPRESSION, mesh)


@pytest.fixture
def half(tmp_path: Path) -> Path:
    """A layer that was asked to stop."""
    first_half(parse_scene(LAYER), tmp_path / "run")
    return tmp_path / "run"


# -- two halves --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["layer", "classical", "Q1R", "Q2Q1", "P2P1"])
def test_a_run_in_two_halves_is_the_run_in_one(kind: str, tmp_path: Path) -> None:
    """Bit by bit, wherever it stopped; nothing is left behind that only an unfinished run needs."""
    scene = parse_scene(scene_of(kind, tmp_path))
    whole = run(scene, tmp_path / "whole", comm=MPI.COMM_SELF)
    halves = tmp_path / "halves"
    for after in (1, AFTER // 3, AFTER):
        shutil.rmtree(halves, ignore_errors=True)
        first = first_half(scene, halves, after=after) if after > 1 else run(scene, halves, comm=MPI.COMM_SELF)
        second = run(scene, halves, comm=MPI.COMM_SELF, resume=True)
        assert (second.steps, second.iterations, second.cutbacks) == (whole.steps, whole.iterations, whole.cutbacks)
        assert second.warnings == whole.warnings
        assert second.reason is None
        assert second.resumed == ([first.steps] if after > 1 else [])
    for name in ("history.csv", *(["profiles.csv"] if kind == "layer" else [])):
        assert (halves / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    files = {file.relative_to(tmp_path / "whole"): file for file in (tmp_path / "whole").rglob("*")}
    assert {file.relative_to(halves) for file in halves.rglob("*")} == files.keys()
    for place, file in files.items():
        if file.suffix in (".pvd", ".vtu"):
            assert (halves / place).read_bytes() == file.read_bytes(), place
    one, two = read_run(tmp_path / "whole").summary, read_run(halves).summary
    kept = ("status", "sizes", "steps", "newton_iterations", "answer", "warnings", "scene_sha256")
    assert {name: two[name] for name in kept} == {name: one[name] for name in kept}


ALONE = {"pc_type": "redundant", "redundant_pc_factor_mat_solver_type": "mumps"}
ON_RANKS: dict[str, dict[str, Any]] = {
    "layer": {"walls.top.shear_displacement": 0.0004, "output.profiles_at": [0.0004]},
    "P2P1": {"boundaries.top.u2": -0.0003, "output.fields_at": [0.0003]},
}


@pytest.mark.parametrize("kind", ON_RANKS)
def test_halves_on_any_numbers_of_ranks(kind: str, tmp_path: Path) -> None:
    """Written on one number of ranks, read on another: all nine pairs to rounding, and on the same number bit by bit.

    The latter as far as two runs are the same at all: several ranks add up what they get from each other in the order
    in which it comes, in MUMPS and, from three ranks on, in the assembly. Here each rank solves the whole system.
    """
    tables = json.dumps(change(scene_of(kind, tmp_path), ON_RANKS[kind] | {"solver.petsc": ALONE}))
    program = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import runpy; "
    program += "runpy.run_module('halves', run_name='__main__')"
    pairs = json.loads(on_ranks(3, program, tables, tmp_path).splitlines()[0])
    assert [pair[:2] for pair in pairs] == [[n, m] for n in (1, 2, 3) for m in (1, 2, 3)]
    for first, second, difference, same in pairs:
        assert difference < 1e-10
        assert same or first != second or first == 3


def test_the_pairs_of_one_rank_alone(tmp_path: Path) -> None:
    """What the program on several ranks does is done here under the eyes of the debugger."""
    [(_, _, difference, same)] = all_pairs(LAYER, tmp_path)
    assert (difference, same) == (0.0, True)


def test_a_run_goes_on_with_other_steps_tolerances_and_pictures(half: Path) -> None:
    """What was the reason for stopping can be changed; what fields and states mean cannot."""
    others = {"title": "again", "stepping.max_step": 1e-4, "solver.max_iterations": 40, "output.figures": True}
    before = read_run(half).history
    ledger = run(parse_scene(change(LAYER, others)), half, comm=MPI.COMM_SELF, resume=True)
    assert ledger.reason is None
    after = read_run(half).history
    kept = len(before["step"])
    assert all(np.array_equal(after[name][:kept], before[name]) for name in before)
    assert after["step_size_m"][kept:].max() <= 1e-4 * (1 + 1e-9)
    assert (half / "figures" / "history.png").exists()


def test_a_run_that_failed_goes_on_from_its_last_step(tmp_path: Path) -> None:
    """It fails there again unless something is changed, and no row is there twice."""
    few, out = change(LAYER, {"stepping.max_steps": 5}), tmp_path / "run"
    assert "limit of 5 steps" in (run(parse_scene(few), out, comm=MPI.COMM_SELF).reason or "")
    assert "limit of 5 steps" in (run(parse_scene(few), out, comm=MPI.COMM_SELF, resume=True).reason or "")
    run(parse_scene(LAYER), out, comm=MPI.COMM_SELF, resume=True)
    run(parse_scene(LAYER), tmp_path / "whole", comm=MPI.COMM_SELF)
    assert (out / "history.csv").read_bytes() == (tmp_path / "whole" / "history.csv").read_bytes()
    assert read_run(out).summary["resumed_after_steps"] == [5, 5]


# -- checkpoints that are not good -------------------------------------------------------------------------------------


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-1])


def cut_within_the_header(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:100])


def empty(file: Path) -> None:
    file.write_bytes(b"")


def flip_in_the_header(file: Path) -> None:
    flip(file, 200)


def flip_in_the_records(file: Path) -> None:
    flip(file, -9)


def flip(file: Path, place: int) -> None:
    content = bytearray(file.read_bytes())
    content[place] ^= 1
    file.write_bytes(content)


def replace_by_text(file: Path) -> None:
    file.write_text("This is not what you are looking for.")


DAMAGES = {
    cut: r"incomplete: it has \d+ bytes of \d+",
    cut_within_the_header: "incomplete: it ends within its header",
    empty: "not a checkpoint",
    flip_in_the_header: "damaged: the checksum of its header is wrong",
    flip_in_the_records: "damaged: the checksum of its records is wrong",
    replace_by_text: "not a checkpoint",
}


@pytest.mark.parametrize(("damage", "message"), DAMAGES.items())
def test_the_previous_checkpoint_serves_where_the_newest_is_damaged(
    damage: Callable[[Path], None], message: str, tmp_path: Path
) -> None:
    tables = change(LAYER, {"output.checkpoints": 0})
    out, whole = tmp_path / "run", tmp_path / "whole"
    run(parse_scene(tables), whole, comm=MPI.COMM_SELF)
    first = first_half(parse_scene(tables), out)
    damage(out / "checkpoint.bin")
    ledger = run(parse_scene(tables), out, comm=MPI.COMM_SELF, resume=True)
    assert ledger.resumed == [first.steps]  # the last step was written twice: as it was made, and when the signal came
    [warning] = ledger.warnings
    assert re.search(rf"run/checkpoint\.bin: {message}; the run went on from the checkpoint before", warning)
    assert (out / "history.csv").read_bytes() == (whole / "history.csv").read_bytes()


@pytest.mark.parametrize(("damage", "message"), DAMAGES.items())
def test_without_a_good_checkpoint_nothing_is_touched(
    damage: Callable[[Path], None], message: str, half: Path, call: Call, tmp_path: Path
) -> None:
    (tmp_path / "scene.toml").write_text(to_toml(LAYER))
    (half / "checkpoint.previous.bin").unlink(missing_ok=True)
    damage(half / "checkpoint.bin")
    before = listing(half)
    outcome = call("run", tmp_path / "scene.toml", "--out", half, "--resume")
    assert_refused(outcome, "")
    assert re.search(message, outcome.err)
    assert listing(half) == before


def test_another_format_is_refused(half: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint_file, "FORMAT", 2)
    with pytest.raises(CheckpointError, match="of format 1, this version reads format 2"):
        checkpoint_file.read_header(half / "checkpoint.bin")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"geometry.cells": 13}, "belongs to another scene: geometry.cells was 12 and is 13"),
        ({"initial.void_ratio": 0.61}, "belongs to another scene: initial.void_ratio was 0.6 and is 0.61"),
        (
            {"walls.top.shear_displacement": 0.003},
            r"walls.top.shear_displacement was \[0.001, 0.0006\] and is \[0.003\]",
        ),
        ({"solver.integration_points": 2}, "belongs to another scene: solver.integration_points was 1 and is 2"),
        ({"effects.spin": "none"}, "belongs to another scene: effects.spin was macro and is none"),
    ],
)
def test_another_scene_is_refused(changes: dict[str, Any], message: str, half: Path) -> None:
    before = listing(half)
    with pytest.raises(CheckpointError, match=message):
        run(parse_scene(change(LAYER, changes)), half, comm=MPI.COMM_SELF, resume=True)
    assert listing(half) == before


def test_a_mesh_that_was_changed_behind_its_name_is_another_scene(tmp_path: Path) -> None:
    scene = parse_scene(scene_of("Q1R", tmp_path))
    first_half(scene, tmp_path / "run")
    write_msh(tmp_path / "Q1R.msh", square(3, 4, "quad", lambda at: 1.01 * at))
    with pytest.raises(CheckpointError, match=r"geometry\.file was a file with the SHA-256 \w+ and is a file with"):
        run(scene, tmp_path / "run", comm=MPI.COMM_SELF, resume=True)


def test_rows_that_are_missing_are_not_made_up(half: Path) -> None:
    (half / "checkpoint.previous.bin").unlink(missing_ok=True)
    rows = (half / "history.csv").read_text().splitlines(keepends=True)
    (half / "history.csv").write_text("".join(rows[:-1]))
    with pytest.raises(CheckpointError, match=r"history\.csv: rows are missing at its end"):
        run(parse_scene(LAYER), half, comm=MPI.COMM_SELF, resume=True)
    (half / "history.csv").write_text("".join(["step\n", *rows[1:], "1\n" * 500]))
    with pytest.raises(CheckpointError, match=r"history\.csv: the columns are not those of the scene"):
        run(parse_scene(LAYER), half, comm=MPI.COMM_SELF, resume=True)


# -- what there is to go on from ---------------------------------------------------------------------------------------


def test_resume_from_the_command_line(tmp_path: Path, call: Call) -> None:
    """It begins where there is nothing, goes on where a run stopped, and leaves alone what is done."""
    out = tmp_path / "run"
    few = [*quick(), *settings("stepping.max_steps=1")]
    stopped = call("run", demo("medium_rough"), "--out", out, "--resume", *few)
    assert stopped.status == STOPPED
    assert f"What was computed is in {out}; --resume goes on from there." in stopped.err
    gone_on = call("run", demo("medium_rough"), "--out", out, "--resume", *quick())
    assert gone_on.status == DONE
    assert "going on after step 1" in gone_on.out
    before = listing(out)
    again = call("run", demo("medium_rough"), "--out", out, "--resume", *quick())
    assert again.status == DONE
    assert "done: " in again.out
    assert listing(out) == before
    other = call("run", demo("very_rough"), "--out", out, "--resume", *quick())
    assert_refused(other, f"output folder {out}: holds a run of another scene; --overwrite replaces it")
    both = call("run", demo("very_rough"), "--out", out, "--resume", "--overwrite", *quick())
    assert_refused(both, "--resume: cannot be given along with --overwrite, which begins anew")
    assert listing(out) == before


def test_without_checkpoints_a_run_begins_again(tmp_path: Path) -> None:
    tables = change(LAYER, {"output.checkpoints": "off"})
    first_half(parse_scene(tables), tmp_path / "run")
    assert not list((tmp_path / "run").glob("checkpoint*"))
    ledger = run(parse_scene(tables), tmp_path / "run", comm=MPI.COMM_SELF, resume=True)
    assert (ledger.reason, ledger.resumed) == (None, [])


@pytest.mark.parametrize("value", ["-1.0", "nan", "sometimes", "true"])
def test_an_interval_that_is_none_is_refused(value: str, tmp_path: Path, call: Call) -> None:
    outcome = call("run", demo("medium_rough"), "--out", tmp_path / "run", "--set", f"output.checkpoints={value}")
    assert outcome.status == BAD_INPUT
    assert "output.checkpoints" in outcome.err


def test_a_checkpoint_that_cannot_be_written_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: object) -> None:
        raise OutputError("no room")

    monkeypatch.setattr(checkpoint_file, "write", refuse)
    ledger = run(parse_scene(LAYER), tmp_path / "run", comm=MPI.COMM_SELF)
    assert (ledger.reason, ledger.warnings) == (None, ["no checkpoint could be written: no room"])


# -- how often ---------------------------------------------------------------------------------------------------------


class Clock:
    """A clock that a test sets."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(cosserat_fx.checkpoint, "perf_counter", clock)
    return clock


def checkpoints_of(tables: dict[str, Any], folder: Path) -> Checkpoints:
    scene = parse_scene(tables)
    body = build(scene, MPI.COMM_SELF)
    recording = recording_of(body)
    made = RunFolder.create(folder, overwrite=False, columns=recording.columns)
    return Checkpoints(made, scene, body.stepper)


def test_they_take_no_more_than_their_share_of_the_time(
    tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each takes two seconds here, each step three."""
    checkpoints = checkpoints_of(LAYER, tmp_path / "run")

    def write(*arguments: object) -> None:
        clock.now += 2.0
        (tmp_path / "run" / "checkpoint.part").touch()

    monkeypatch.setattr(checkpoint_file, "write", write)
    written = 0
    for _ in range(1000):
        clock.now += 3.0
        if checkpoints.due():
            checkpoints.save({})
            written += 1
            assert written == 1 or 2.0 * written <= SHARE * clock.now  # what the first one takes is not known before
    assert 2.0 * (written + 1) > SHARE * (clock.now - 3.0)


@pytest.mark.parametrize(("interval", "due"), [(0, [True] * 6), (2.5, [False, False, True] * 2), ("off", [False] * 6)])
def test_they_keep_to_the_interval(interval: float | str, due: list[bool], tmp_path: Path, clock: Clock) -> None:
    checkpoints = checkpoints_of(change(LAYER, {"output.checkpoints": interval}), tmp_path / "run")
    found = []
    for _ in due:
        clock.now += 1.0
        found.append(checkpoints.due())
        if found[-1]:
            checkpoints.save({})
    assert found == due


# -- the parts ---------------------------------------------------------------------------------------------------------


@given(st.data())
def test_the_checksum_sees_every_bit_and_no_partition(data: st.DataObject) -> None:
    cells, words = data.draw(st.integers(1, 20)), data.draw(st.integers(1, 5))
    numbers = np.arange(cells)
    records = np.zeros(cells, np.dtype([("values", "<f8", (words,))]))
    records["values"] = np.random.default_rng(data.draw(st.integers(0, 9))).integers(0, 2, (cells, words))
    whole = int(checkpoint_file.checksum(records, numbers, MPI.COMM_SELF), 16)
    mine = np.array(data.draw(st.lists(st.booleans(), min_size=cells, max_size=cells)))
    parts = [int(checkpoint_file.checksum(records[it], numbers[it], MPI.COMM_SELF), 16) for it in (mine, ~mine)]
    assert sum(parts) % 2**64 == whole
    changed = records.copy()
    changed.view(np.uint8).reshape(-1)[data.draw(st.integers(0, records.nbytes - 1))] ^= 1 << data.draw(
        st.integers(0, 7)
    )
    assert int(checkpoint_file.checksum(changed, numbers, MPI.COMM_SELF), 16) != whole


def test_the_identity_of_a_scene_leaves_out_what_may_change() -> None:
    scene = parse_scene(LAYER)
    same = {"title": "x", "stepping.max_step": 1e-4, "output.fields": False, "solver.petsc": {"snes_monitor": ""}}
    assert identity.identity(parse_scene(change(LAYER, same))) == identity.identity(scene)
    other = identity.identity(parse_scene(change(LAYER, {"material.phi_c": 31.0})))
    assert identity.difference(identity.identity(scene), other) == "material.phi_c was 30.0 and is 31.0"
    assert identity.digest(other) != identity.digest(identity.identity(scene))
