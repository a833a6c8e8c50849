"""The tables of a run's folder: their columns, and lines that are appended whole, read back and cut."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from cosserat_fx.typing import Array

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
    "jumps",
)
"""Columns of a layer's ``history.csv``; columns may be added, not renamed."""

PLANE_COLUMNS = (
    "step",
    "travel_m",
    "step_size_m",
    "newton_iterations",
    "cutbacks",
    "branch_passages",
    "jumps",
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


def check_columns(table: str, given: Mapping[str, object], columns: Sequence[str]) -> None:
    """Raise KeyError unless a table is given all of its columns and no others."""
    missing = [name for name in columns if name not in given]
    unknown = [name for name in given if name not in columns]
    if missing or unknown:
        raise KeyError(f"{table}: missing columns {missing}, unknown columns {unknown}")


def line(values: Sequence[Any]) -> str:
    """One line of a table; the shortest decimals that read back to the same double, integers without a point."""
    return ",".join(str(int(v)) if isinstance(v, int | np.integer) else repr(float(v)) for v in values) + "\n"


def append(file: Path, text: str) -> None:
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


def discard(file: Path) -> None:
    """Remove a file that was not finished, unless that is not possible either."""
    with suppress(OSError):
        file.unlink()


def header(names: Sequence[str]) -> str:
    """The first line of a table; names that hold a comma or a quotation mark are quoted."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(names)
    return line.getvalue()


def read_table(file: Path, *kinds: Sequence[str]) -> Table:
    """The whole lines of a table, which holds at least the columns of one of the kinds.

    A run killed before its first header has an empty table of the first kind.
    """
    try:
        text = file.read_text(encoding="utf-8") if file.exists() else ""
        first, *lines = text[: text.rfind("\n") + 1].splitlines() or [header(kinds[0])]
        names = next(csv.reader([first]))
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
