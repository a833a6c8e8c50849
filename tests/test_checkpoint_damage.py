"""Checkpoints that are damaged, of another format, scene or mesh, or without their rows."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from console import Call, assert_refused, listing
from halves import LAYER, first_half, scene_of
from meshes import square, write_msh
from scenes import change, to_toml

from cosserat_fx._compat import MPI
from cosserat_fx.checkpoint import CheckpointError
from cosserat_fx.checkpoints import file as checkpoint_file
from cosserat_fx.run import run
from cosserat_fx.scene import parse_scene


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
    monkeypatch.setattr(checkpoint_file, "FORMAT", 3)
    with pytest.raises(CheckpointError, match="of format 2, this version reads format 3"):
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
