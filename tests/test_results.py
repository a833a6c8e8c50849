"""The run folder: what it refuses, what survives a kill, and that nothing is lost on the way through the files."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosserat_fx.results import FORMAT, HISTORY_COLUMNS, PROFILE_COLUMNS, OutputError, RunFolder, read_run

HISTORY = [{name: step + 0.1 * column for column, name in enumerate(HISTORY_COLUMNS)} for step in (1, 2, 3)]


def profile(step: int, points: int = 5) -> dict[str, Any]:
    values = {name: np.arange(points) / 3.0 + column for column, name in enumerate(PROFILE_COLUMNS)}
    return values | {"step": step, "top_displacement_m": 0.001 * step}


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    """A run with three steps and two blocks of profiles."""
    folder = RunFolder.create(tmp_path / "run", overwrite=False)
    for row in HISTORY:
        folder.append_history(row)
    folder.append_profile(profile(1))
    folder.append_profile(profile(3))
    return folder


def test_a_new_run_is_readable_before_its_first_step(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "not" / "yet" / "there", overwrite=False)
    run = read_run(folder.path)
    assert run.summary == {"format": FORMAT, "status": "running", "reason": None}
    assert tuple(run.history) == HISTORY_COLUMNS
    assert tuple(run.profiles) == PROFILE_COLUMNS
    assert all(column.shape == (0,) for column in (*run.history.values(), *run.profiles.values()))
    assert run.profile_blocks() == []


def test_the_first_columns_are_the_agreed_ones(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path, overwrite=False)
    assert folder.history.read_text().startswith(
        "step,top_displacement_m,shear_stress_Pa,normal_stress_Pa,height_change_m,newton_iterations,"
        "void_ratio_max,void_ratio_min,"
    )
    assert folder.profiles.read_text().startswith(
        "top_displacement_m,y_m,u1_m,u2_m,omega_rad,void_ratio,s11_Pa,s22_Pa,s33_Pa,s12_Pa,s21_Pa,"
        "m31_N_per_m,m32_N_per_m,"
    )


def test_every_bit_comes_back(folder: RunFolder) -> None:
    rng = np.random.default_rng(1)
    values = rng.standard_normal(len(HISTORY_COLUMNS)) * 10.0 ** rng.integers(-300, 300, len(HISTORY_COLUMNS))
    folder.append_history(dict(zip(HISTORY_COLUMNS, values, strict=True)))
    run = read_run(folder.path)
    assert [column[-1] for column in run.history.values()] == values.tolist()
    np.testing.assert_array_equal(run.history["step"], [1.0, 2.0, 3.0, values[0]])


def test_integers_are_written_without_a_point(folder: RunFolder) -> None:
    row: dict[str, float | np.integer[Any]] = dict.fromkeys(HISTORY_COLUMNS, 0.5)
    folder.append_history(row | {"step": 7, "cutbacks": np.int32(2)})
    last = dict(zip(HISTORY_COLUMNS, folder.history.read_text().splitlines()[-1].split(","), strict=True))
    assert (last["step"], last["cutbacks"], last["height_change_m"]) == ("7", "2", "0.5")


def test_profiles_come_back_in_blocks_sorted_by_height(folder: RunFolder) -> None:
    shuffled = profile(4)
    order = [3, 0, 4, 1, 2]
    folder.append_profile(shuffled | {"y_m": shuffled["y_m"][order], "u1_m": shuffled["u1_m"][order]})
    blocks = read_run(folder.path).profile_blocks()
    assert [block["step"].tolist() for block in blocks] == [[1.0] * 5, [3.0] * 5, [4.0] * 5]
    np.testing.assert_array_equal(blocks[2]["y_m"], shuffled["y_m"])
    np.testing.assert_array_equal(blocks[2]["u1_m"], shuffled["u1_m"])
    assert np.all(blocks[2]["top_displacement_m"] == 0.004)


def test_a_table_cut_at_any_byte_is_readable_and_keeps_its_whole_lines(folder: RunFolder) -> None:
    whole = folder.history.read_bytes()
    steps = read_run(folder.path).history["step"]
    for length in range(len(whole)):
        folder.history.write_bytes(whole[:length])
        rows = max(whole[:length].count(b"\n") - 1, 0)
        np.testing.assert_array_equal(read_run(folder.path).history["step"], steps[:rows])


def test_a_block_that_a_kill_left_short_is_dropped(folder: RunFolder) -> None:
    lines = folder.profiles.read_text().splitlines(keepends=True)
    folder.profiles.write_text("".join(lines[:-2]) + lines[-2][:9])
    assert [block["step"][0] for block in read_run(folder.path).profile_blocks()] == [1.0]


def test_missing_tables_read_as_empty(folder: RunFolder) -> None:
    folder.history.unlink()
    assert read_run(folder.path).history["step"].size == 0


def test_a_column_added_later_is_read_and_a_lost_one_is_told(folder: RunFolder) -> None:
    header, *rows = folder.history.read_text().splitlines()
    folder.history.write_text("\n".join([header + ",extra", *(row + ",4.5" for row in rows), ""]))
    assert read_run(folder.path).history["extra"].tolist() == [4.5, 4.5, 4.5]
    folder.history.write_text("\n".join([header.replace("cutbacks", "renamed"), *rows, ""]))
    with pytest.raises(OutputError, match=r"history\.csv.*'cutbacks'.*missing"):
        read_run(folder.path)


@pytest.mark.parametrize("damage", ["1,2,3\n", "x" + ",1" * (len(HISTORY_COLUMNS) - 1) + "\n"])
def test_a_damaged_line_is_an_error(folder: RunFolder, damage: str) -> None:
    with folder.history.open("a") as stream:
        stream.write(damage)
    with pytest.raises(OutputError, match=r"history\.csv: damaged"):
        read_run(folder.path)


def test_wrong_columns_are_told_and_nothing_is_written(folder: RunFolder) -> None:
    before = folder.history.read_text(), folder.profiles.read_text()
    with pytest.raises(KeyError, match=r"missing columns \['step'\], unknown columns \['steps'\]"):
        folder.append_history(dict.fromkeys(HISTORY_COLUMNS[1:], 0.0) | {"steps": 1})
    with pytest.raises(KeyError, match="missing columns"):
        folder.append_profile({"y_m": np.zeros(3)})
    with pytest.raises(ValueError, match="broadcast"):
        folder.append_profile(profile(4) | {"u1_m": np.zeros(3)})
    assert (folder.history.read_text(), folder.profiles.read_text()) == before


def test_a_full_disk_is_told_and_leaves_whole_lines(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first part of a block reaches the disk, the rest does not fit: the part is taken back."""
    real_open = Path.open
    before = folder.profiles.read_bytes()

    class FullDisk:
        def __init__(self, path: Path) -> None:
            self.stream = real_open(path, "ab", buffering=0)

        def __enter__(self) -> "FullDisk":
            return self

        def __exit__(self, *error: object) -> None:
            self.stream.close()

        def tell(self) -> int:
            return self.stream.tell()

        def truncate(self, size: int) -> int:
            return self.stream.truncate(size)

        def write(self, data: memoryview) -> int:
            if len(data) <= 100:
                raise OSError(28, "No space left on device")
            return self.stream.write(data[:100]) or 0

    monkeypatch.setattr(Path, "open", lambda path, *_, **__: FullDisk(path))
    with pytest.raises(OutputError, match=r"profiles\.csv: cannot be written: No space left on device"):
        folder.append_profile(profile(4))
    monkeypatch.undo()
    assert folder.profiles.read_bytes() == before


def test_an_output_folder_that_vanished_is_told(folder: RunFolder) -> None:
    gone = RunFolder(folder.path / "gone")
    with pytest.raises(OutputError, match=r"gone/history\.csv: cannot be written: No such file"):
        gone.append_history(HISTORY[0])
    with pytest.raises(OutputError, match=r"gone/run\.json: cannot be written: No such file"):
        gone.write_summary({})


def test_the_summary_takes_numpy_and_refuses_what_json_cannot_say(folder: RunFolder) -> None:
    folder.write_summary(
        {"format": FORMAT, "steps": np.int64(3), "ok": np.bool_(True), "e": np.float32(0.5), "y": np.arange(2)}
    )
    written = json.loads(folder.summary.read_text())
    assert written == {"format": FORMAT, "steps": 3, "ok": True, "e": 0.5, "y": [0, 1]}
    for bad, error in (
        ({"e": np.float64("nan")}, ValueError),
        ({"e": np.inf}, ValueError),
        ({"e": object()}, TypeError),
    ):
        with pytest.raises(error):
            folder.write_summary(bad)
    assert json.loads(folder.summary.read_text()) == written


def test_the_summary_is_replaced_in_one_move(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Until the move the old summary stands whole; a move that fails leaves it and no rubbish."""

    def fail(part: Path, target: Path) -> None:
        assert json.loads(part.read_text()) == {"format": FORMAT, "steps": 9}
        assert json.loads(target.read_text())["status"] == "running"
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(OutputError, match=r"run\.json: cannot be written: Input/output error"):
        folder.write_summary({"format": FORMAT, "steps": 9})
    monkeypatch.undo()
    assert read_run(folder.path).summary["status"] == "running"
    assert sorted(p.name for p in folder.path.iterdir()) == ["history.csv", "profiles.csv", "run.json"]


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    assert RunFolder.create(tmp_path, overwrite=False).summary.is_file()


def test_a_run_is_overwritten_on_request_only_and_alone(folder: RunFolder) -> None:
    for name in ("fields/a.vtu", "figures/history.png", "notes/mine.txt", "mine.txt"):
        file = folder.path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text("x")
    content = folder.history.read_bytes()
    with pytest.raises(OutputError, match=r"/run: holds a run already; --overwrite replaces it"):
        RunFolder.create(folder.path, overwrite=False)
    assert folder.history.read_bytes() == content
    RunFolder.create(folder.path, overwrite=True)
    run = read_run(folder.path)
    assert run.history["step"].size == run.profiles["step"].size == 0
    assert not folder.fields.exists()
    assert not folder.figures.exists()
    assert (folder.path / "notes" / "mine.txt").read_text() == (folder.path / "mine.txt").read_text() == "x"


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("stranger", ["thesis.tex", "run.json"])
def test_a_folder_with_something_else_is_refused(tmp_path: Path, stranger: str, overwrite: bool) -> None:
    (tmp_path / stranger).write_text('{"scripts": {"test": "jest"}}')
    with pytest.raises(OutputError, match=r"holds something other than a run") as caught:
        RunFolder.create(tmp_path, overwrite=overwrite)
    assert str(tmp_path) in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == [stranger]


def test_a_file_in_the_way_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("x")
    with pytest.raises(OutputError, match=r"/file: exists and is not a folder"):
        RunFolder.create(file, overwrite=True)
    with pytest.raises(OutputError, match=r"/file/run: .*/file is not a folder"):
        RunFolder.create(file / "run", overwrite=True)
    assert file.read_text() == "x"


def test_no_permission_is_refused_before_anything_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path)
    with pytest.raises(OutputError, match=r"/a/b: no permission to write in"):
        RunFolder.create(tmp_path / "a" / "b", overwrite=False)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(path: Path, **_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", fail)
    with pytest.raises(OutputError, match=r"/run: cannot be written: Permission denied"):
        RunFolder.create(tmp_path / "run", overwrite=False)


def test_only_a_run_is_read(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"nowhere: not a run: run\.json cannot be read"):
        read_run(tmp_path / "nowhere")
    for text, message in (("{", "damaged"), ("[]", "not the summary"), ('{"format": 0}', '"format": 1 is missing')):
        (tmp_path / "run.json").write_text(text)
        with pytest.raises(OutputError, match=message):
            read_run(tmp_path)
