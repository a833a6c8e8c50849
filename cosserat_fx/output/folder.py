"""A run's folder as its writer sees it.

Whole lines are appended to the tables and the summary is replaced in one move, so that a kill at any moment leaves a
folder that can be read, and gone on from where there is a checkpoint.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from cosserat_fx.output.lock import LOCK, is_locked
from cosserat_fx.output.tables import (
    HISTORY_COLUMNS,
    PROFILE_COLUMNS,
    OutputError,
    append,
    check_columns,
    discard,
    header,
    line,
)

FORMAT = 1
"""Version of the folder's layout, the entry ``format`` of ``run.json``."""
_SUMMARY_PART = "run.json.part"


@dataclass(frozen=True)
class RunFolder:
    """The folder of one run, as its writer sees it; :meth:`create` makes a new one.

    Attributes:
        path: the folder.
        columns: of ``history.csv``.
        profile_columns: of ``profiles.csv``; without any there is no such file.
    """

    path: Path
    columns: tuple[str, ...] = HISTORY_COLUMNS
    profile_columns: tuple[str, ...] = PROFILE_COLUMNS

    @property
    def history(self) -> Path:
        """The file with one row per accepted step."""
        return self.path / "history.csv"

    @property
    def profiles(self) -> Path:
        """The file with the profiles across the layer, in long form."""
        return self.path / "profiles.csv"

    @property
    def summary(self) -> Path:
        """The file with versions, scene, sizes, timings, metrics, warnings and how the run ended."""
        return self.path / "run.json"

    @property
    def checkpoint(self) -> Path:
        """The newest checkpoint of an unfinished run."""
        return self.path / "checkpoint.bin"

    @property
    def previous_checkpoint(self) -> Path:
        """The checkpoint before it."""
        return self.path / "checkpoint.previous.bin"

    @property
    def fields(self) -> Path:
        """The folder for ParaView's files; its writer makes it."""
        return self.path / "fields"

    @property
    def figures(self) -> Path:
        """The folder for figures; its writer makes it."""
        return self.path / "figures"

    @classmethod
    def check(cls, path: Path, overwrite: bool) -> Self:
        """Say whether a run may be written to a folder, without touching anything.

        Args:
            path: the folder; it need not exist.
            overwrite: whether an earlier run there may be replaced.

        Raises:
            OutputError: the path is no folder, holds something other than a run, holds a run that may not be
                replaced, or cannot be written.
        """
        folder = cls(path)
        try:
            _check_free(folder, overwrite)
            if is_locked(path):
                raise OutputError(f"output folder {path}: another run is writing to it")
        except OSError as error:
            raise OutputError(f"output folder {path}: cannot be written: {error.strerror or error}") from error
        return folder

    @classmethod
    def create(
        cls,
        path: Path,
        overwrite: bool,
        columns: tuple[str, ...] = HISTORY_COLUMNS,
        profile_columns: tuple[str, ...] = PROFILE_COLUMNS,
    ) -> Self:
        """Make the folder of a new run: headers only and a summary that says ``running``.

        Everything is checked before anything is touched. Missing parents are made and an existing empty folder is
        taken. Overwriting removes what a run writes and nothing else.

        Args:
            path: the folder.
            overwrite: whether an earlier run there may be replaced.
            columns: of the history.
            profile_columns: of the profiles; without any there is no such file.

        Raises:
            OutputError: as :meth:`check` says, or the folder cannot be written after all.
        """
        cls.check(path, overwrite)
        folder = cls(path, columns, profile_columns)
        folder.clear(overwrite)
        return folder

    def clear(self, overwrite: bool) -> None:
        """Do what :meth:`create` does in a folder that this process may write to, as nobody else is known to do.

        Args:
            overwrite: whether an earlier run there may be replaced.

        Raises:
            OutputError: as :meth:`check` says, or the folder cannot be written after all.
        """
        try:
            _check_free(self, overwrite)
            self.path.mkdir(parents=True, exist_ok=True)
            self.remove_checkpoints()
            self.write_summary({"format": FORMAT, "status": "running", "reason": None})
            for old in (self.fields, self.figures):
                if old.exists():
                    shutil.rmtree(old)
            for file, names in self.tables.items():
                file.unlink(missing_ok=True)
                if names:
                    append(file, header(names))
        except OSError as error:
            raise OutputError(f"output folder {self.path}: cannot be written: {error.strerror or error}") from error

    @property
    def tables(self) -> dict[Path, tuple[str, ...]]:
        """The columns of each table."""
        return {self.history: self.columns, self.profiles: self.profile_columns}

    def append_history(self, row: Mapping[str, float | np.integer[Any]]) -> None:
        """Append one accepted step.

        Args:
            row: a value for each of the history's columns.

        Raises:
            KeyError: a column is missing or unknown.
            OutputError: the file cannot be written.
        """
        check_columns("history", row, self.columns)
        append(self.history, line([row[name] for name in self.columns]))

    def append_profile(self, block: Mapping[str, ArrayLike]) -> None:
        """Append the profiles at one displacement, in ascending order of height.

        Args:
            block: for each column of the profiles an array of shape ``(points,)``, or one value for all points.

        Raises:
            KeyError: a column is missing or unknown.
            ValueError: the columns differ in length.
            OutputError: the file cannot be written.
        """
        check_columns("profile", block, self.profile_columns)
        columns = np.broadcast_arrays(*(np.atleast_1d(block[name]) for name in self.profile_columns))
        upwards = np.argsort(columns[self.profile_columns.index("y_m")], kind="stable")
        rows = zip(*(column[upwards] for column in columns), strict=True)
        append(self.profiles, "".join(line(row) for row in rows))

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Replace ``run.json`` in one move; a reader sees the old or the new one, never a part.

        Args:
            summary: what JSON can hold, and NumPy scalars and arrays.

        Raises:
            ValueError: a number is not finite.
            TypeError: a value has no form in JSON.
            OutputError: the file cannot be written.
        """
        text = json.dumps(summary, indent=2, allow_nan=False, default=_plain) + "\n"
        part = self.path / _SUMMARY_PART
        try:
            part.write_text(text, encoding="utf-8")
            part.replace(self.summary)
        except OSError as error:
            discard(part)
            raise OutputError(f"{self.summary}: cannot be written: {error.strerror or error}") from error

    def is_done(self, scene_digest: str) -> bool:
        """Whether the folder holds a run that has come to its end.

        Args:
            scene_digest: of the scene at hand.

        Raises:
            OutputError: it holds a run of another scene, and no checkpoint, which would say so itself.
        """
        if self.checkpoint.exists():
            return False
        summary = _summary(self) or {}
        if summary.get("scene_sha256", scene_digest) != scene_digest:
            raise OutputError(f"output folder {self.path}: holds a run of another scene; --overwrite replaces it")
        return summary.get("status") == "done"

    def settle(self) -> dict[str, int]:
        """Make sure that all rows are on the disk.

        Returns:
            The length of each table, by the name of its file (bytes).

        Raises:
            OutputError: they cannot be written.
        """
        lengths = {}
        for file in self._kept_tables():
            try:
                with file.open("rb") as stream:
                    os.fsync(stream.fileno())
                    lengths[file.name] = os.fstat(stream.fileno()).st_size
            except OSError as error:
                raise OutputError(f"{file}: cannot be written: {error.strerror or error}") from error
        return lengths

    def check_tables(self, lengths: Mapping[str, int], steps: int) -> None:
        """Look whether the tables hold what they did when they were settled, and perhaps more.

        Args:
            lengths: that :meth:`settle` gave.
            steps: accepted steps at that time.

        Raises:
            OutputError: rows are missing, or the columns are others.
        """
        for file in self._kept_tables():
            try:
                with file.open("rb") as stream:
                    rows = stream.read(lengths.get(file.name, 0))
            except OSError as error:
                raise OutputError(f"{file}: cannot be read: {error.strerror or error}") from error
            if not rows.startswith(header(self.tables[file]).encode()):
                raise OutputError(f"{file}: the columns are not those of the scene")
            if len(rows) < lengths[file.name] or not rows.endswith(b"\n"):
                raise OutputError(f"{file}: rows are missing at its end")
            if file == self.history and rows.count(b"\n") != steps + 1:
                raise OutputError(f"{file}: has other rows than those of {steps} steps")

    def cut_tables(self, lengths: Mapping[str, int]) -> None:
        """Take out the rows behind those that were there when the tables were settled.

        Args:
            lengths: that :meth:`settle` gave.

        Raises:
            OutputError: a file cannot be written.
        """
        for file in self._kept_tables():
            try:
                os.truncate(file, lengths[file.name])
            except OSError as error:
                raise OutputError(f"{file}: cannot be written: {error.strerror or error}") from error

    def remove_checkpoints(self) -> None:
        """Remove what only an unfinished run needs."""
        for file in (self.checkpoint.with_suffix(".part"), self.previous_checkpoint, self.checkpoint):
            file.unlink(missing_ok=True)

    def _kept_tables(self) -> list[Path]:
        return [file for file, names in self.tables.items() if names]


def _check_free(folder: RunFolder, overwrite: bool) -> None:
    """Raise OutputError unless a run may be written to the folder."""
    path = folder.path
    if not path.is_dir():
        if path.exists():
            raise OutputError(f"output folder {path}: exists and is not a folder")
    elif any(file.name not in (LOCK, _SUMMARY_PART) for file in path.iterdir()):
        if not _is_run(folder):
            raise OutputError(f"output folder {path}: holds something other than a run; choose another folder")
        if not overwrite:
            raise OutputError(f"output folder {path}: holds a run already; --overwrite replaces it")
    nearest = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not nearest.is_dir():
        raise OutputError(f"output folder {path}: {nearest} is not a folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise OutputError(f"output folder {path}: no permission to write in {nearest}")


def _is_run(folder: RunFolder) -> bool:
    return _summary(folder) is not None


def _summary(folder: RunFolder) -> dict[str, Any] | None:
    """The contents of run.json, or None where it is none."""
    try:
        summary = json.loads(folder.summary.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return summary if isinstance(summary, dict) and "format" in summary else None


def _plain(value: object) -> object:
    """NumPy's scalars and arrays as what JSON knows."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"run.json cannot hold a {type(value).__name__}: {value!r}")
