"""A run's folder: written row by row while the simulation goes on, read back afterwards.

``history.csv`` has one row per accepted step under the columns of its header, ``profiles.csv`` (of a layer) one block
of rows per requested displacement and ``run.json`` the summary. Whole lines are appended and the summary is replaced in
one move, so that a kill at any moment leaves a folder that :func:`read_run` reads. All numbers are in SI units, tension
positive. Under MPI only rank 0 calls this module, with data already gathered.
"""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from cosserat_fx.typing import Array

FORMAT = 1
"""Version of the folder's layout, the entry ``format`` of ``run.json``."""

HISTORY_COLUMNS = (
    "step",
    "top_displacement_m",
    "shear_stress_Pa",
    "normal_stress_Pa",
    "height_change_m",
    "newton_iterations",
    "void_ratio_max",
    "void_ratio_min",
    "bottom_displacement_m",
    "step_size_m",
    "cutbacks",
    "substeps_max",
    "mobilised_friction",
    "max_shear_strain",
)
"""Columns of a layer's ``history.csv``; columns may be added, not renamed."""

PLANE_COLUMNS = (
    "step",
    "travel_m",
    "step_size_m",
    "newton_iterations",
    "cutbacks",
    "branch_passages",
    "substeps_max",
    "void_ratio_max",
    "void_ratio_min",
    "max_shear_strain",
    "internal_work_J_per_m",
    "hourglass_energy_J_per_m",
)
"""First columns of a plane body's ``history.csv``, before those of its boundaries and those that the scene adds."""

BOUNDARY_COLUMNS = {
    "force1": "force1_N_per_m",
    "force2": "force2_N_per_m",
    "couple": "couple_N",
    "u1": "u1_m",
    "u2": "u2_m",
    "w": "w_rad",
}
"""How the history's columns of a boundary end, by what they hold."""

PROFILE_COLUMNS = (
    "top_displacement_m",
    "y_m",
    "u1_m",
    "u2_m",
    "omega_rad",
    "void_ratio",
    "s11_Pa",
    "s22_Pa",
    "s33_Pa",
    "s12_Pa",
    "s21_Pa",
    "m31_N_per_m",
    "m32_N_per_m",
    "shear_strain",
    "step",
)
"""Columns of ``profiles.csv``; ``y_m`` is the height in the reference configuration, ``s12`` acts on the walls."""

type Table = dict[str, Array]
"""Columns by name, each of shape ``(rows,)``."""


class OutputError(ValueError):
    """A run's folder cannot be created, written or read; the message names the path and the reason."""


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
        try:
            path.mkdir(parents=True, exist_ok=True)
            folder.write_summary({"format": FORMAT, "status": "running", "reason": None})
            for old in (folder.fields, folder.figures):
                if old.exists():
                    shutil.rmtree(old)
            for file, names in ((folder.history, columns), (folder.profiles, profile_columns)):
                file.unlink(missing_ok=True)
                if names:
                    _append(file, _header(names))
        except OSError as error:
            raise OutputError(f"output folder {path}: cannot be written: {error.strerror or error}") from error
        return folder

    def append_history(self, row: Mapping[str, float | np.integer[Any]]) -> None:
        """Append one accepted step.

        Args:
            row: a value for each of the history's columns.

        Raises:
            KeyError: a column is missing or unknown.
            OutputError: the file cannot be written.
        """
        _check_columns("history", row, self.columns)
        _append(self.history, _line([row[name] for name in self.columns]))

    def append_profile(self, block: Mapping[str, ArrayLike]) -> None:
        """Append the profiles at one displacement, in ascending order of height.

        Args:
            block: for each column of the profiles an array of shape ``(points,)``, or one value for all points.

        Raises:
            KeyError: a column is missing or unknown.
            ValueError: the columns differ in length.
            OutputError: the file cannot be written.
        """
        _check_columns("profile", block, self.profile_columns)
        columns = np.broadcast_arrays(*(np.atleast_1d(block[name]) for name in self.profile_columns))
        upwards = np.argsort(columns[self.profile_columns.index("y_m")], kind="stable")
        rows = zip(*(column[upwards] for column in columns), strict=True)
        _append(self.profiles, "".join(_line(row) for row in rows))

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
        part = self.path / "run.json.part"
        try:
            part.write_text(text, encoding="utf-8")
            part.replace(self.summary)
        except OSError as error:
            part.unlink(missing_ok=True)
            raise OutputError(f"{self.summary}: cannot be written: {error.strerror or error}") from error


@dataclass(frozen=True)
class Run:
    """What a run left behind.

    Attributes:
        path: its folder.
        history: the columns of ``history.csv``.
        profiles: the columns of ``profiles.csv``; without rows where there is no such file.
        summary: the contents of ``run.json``.
    """

    path: Path
    history: Table
    profiles: Table
    summary: dict[str, Any]

    @property
    def kind(self) -> str:
        """Kind of the body, ``geometry.kind`` of its scene."""
        return str(self.summary.get("scene", {}).get("geometry", {}).get("kind", "layer"))

    def profile_blocks(self) -> list[Table]:
        """The profiles split by requested displacement, in the order of the path.

        A last block that a kill left shorter than the first is dropped.
        """
        starts = np.flatnonzero(np.diff(self.profiles["step"])) + 1
        edges = [0, *starts.tolist(), self.profiles["step"].size]
        return [
            {name: column[first:last] for name, column in self.profiles.items()}
            for first, last in pairwise(edges)
            if last - first == edges[1] > 0
        ]


def read_run(path: Path) -> Run:
    """Read a run's folder, finished or not.

    A last line without its line end was cut off by a kill and is dropped, even where it could be read as numbers.

    Args:
        path: the folder.

    Raises:
        OutputError: the folder does not hold a run, or a file of it is damaged.
    """
    folder = RunFolder(path)
    try:
        summary = json.loads(folder.summary.read_text(encoding="utf-8"))
    except OSError as error:
        raise OutputError(f"{path}: not a run: run.json cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise OutputError(f"{folder.summary}: damaged: {error}") from error
    if not isinstance(summary, dict) or summary.get("format") != FORMAT:
        raise OutputError(f'{folder.summary}: not the summary of a run: "format": {FORMAT} is missing')
    return Run(
        path,
        history=_read_table(folder.history, HISTORY_COLUMNS, PLANE_COLUMNS),
        profiles=_read_table(folder.profiles, PROFILE_COLUMNS),
        summary=summary,
    )


def _check_free(folder: RunFolder, overwrite: bool) -> None:
    """Raise OutputError unless a run may be written to the folder."""
    path = folder.path
    if not path.is_dir():
        if path.exists():
            raise OutputError(f"output folder {path}: exists and is not a folder")
    elif any(path.iterdir()):
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
    try:
        summary = json.loads(folder.summary.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(summary, dict) and "format" in summary


def _check_columns(table: str, given: Mapping[str, object], columns: Sequence[str]) -> None:
    missing = [name for name in columns if name not in given]
    unknown = [name for name in given if name not in columns]
    if missing or unknown:
        raise KeyError(f"{table}: missing columns {missing}, unknown columns {unknown}")


def _line(values: Sequence[Any]) -> str:
    """One line of a table; the shortest decimals that read back to the same double, integers without a point."""
    return ",".join(str(int(v)) if isinstance(v, int | np.integer) else repr(float(v)) for v in values) + "\n"


def _append(file: Path, text: str) -> None:
    """Append whole lines in one write; where that fails, nothing of them stays."""
    try:
        with file.open("ab", buffering=0) as stream:
            before = stream.tell()
            rest = memoryview(text.encode())
            try:
                while rest:
                    rest = rest[stream.write(rest) :]
            except OSError:
                stream.truncate(before)
                raise
    except OSError as error:
        raise OutputError(f"{file}: cannot be written: {error.strerror or error}") from error


def _plain(value: object) -> object:
    """NumPy's scalars and arrays as what JSON knows."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"run.json cannot hold a {type(value).__name__}: {value!r}")


def _header(names: Sequence[str]) -> str:
    """The first line of a table; names that hold a comma or a quotation mark are quoted."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(names)
    return line.getvalue()


def _read_table(file: Path, *kinds: Sequence[str]) -> Table:
    """The whole lines of a table, which holds at least the columns of one of the kinds.

    A run killed before its first header has an empty table of the first kind.
    """
    try:
        text = file.read_text(encoding="utf-8") if file.exists() else ""
        header, *lines = text[: text.rfind("\n") + 1].splitlines() or [_header(kinds[0])]
        names = next(csv.reader([header]))
        rows = np.loadtxt(lines, delimiter=",", ndmin=2) if lines else np.empty((0, len(names)))
        table = dict(zip(names, rows.T.astype(np.float64), strict=True))
    except OSError as error:
        raise OutputError(f"{file}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise OutputError(f"{file}: damaged: {error}") from error
    missing = min(([name for name in columns if name not in table] for columns in kinds), key=len)
    if missing:
        raise OutputError(f"{file}: damaged: columns {missing} are missing")
    return table
