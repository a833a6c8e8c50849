"""A run's folder read back, finished or not."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cosserat_fx.output.folder import FORMAT, RunFolder
from cosserat_fx.output.tables import (
    HISTORY_COLUMNS,
    PLANE_COLUMNS,
    PROFILE_COLUMNS,
    OutputError,
    Table,
    read_table,
)


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
        history=read_table(folder.history, HISTORY_COLUMNS, PLANE_COLUMNS),
        profiles=read_table(folder.profiles, PROFILE_COLUMNS),
        summary=summary,
    )
