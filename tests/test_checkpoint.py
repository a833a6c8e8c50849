"""Checkpoints: a run in two halves is the run in one, and a checkpoint that is not good is never gone on from."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from console import BAD_INPUT, DONE, STOPPED, Call, assert_refused, listing, quick, settings
from halves import AFTER, LAYER, all_pairs, first_half, scene_of
from hypothesis import given
from hypothesis import strategies as st
from layers import demo
from ranks import on_ranks
from scenes import change

import cosserat_fx.checkpoint
from cosserat_fx._compat import MPI
from cosserat_fx.bodies import build, recording_of
from cosserat_fx.checkpoint import SHARE, Checkpoints
from cosserat_fx.checkpoints import file as checkpoint_file
from cosserat_fx.checkpoints import identity
from cosserat_fx.results import OutputError, RunFolder, read_run
from cosserat_fx.run import run
from cosserat_fx.scene import parse_scene

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
