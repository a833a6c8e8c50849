"""The folder of a study."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosserat_fx.output.lock import LOCK, is_locked
from cosserat_fx.output.tables import OutputError

FORMAT = 1
"""Version of the layout, the entry ``study_format`` of ``study.json``."""


@dataclass(frozen=True)
class StudyFolder:
    """The folder of a study, whose runs are in folders of their own below it.

    Attributes:
        path: the folder.
    """

    path: Path

    @property
    def summary(self) -> Path:
        """Everything the study found."""
        return self.path / "study.json"

    @property
    def report(self) -> Path:
        """The same as tables."""
        return self.path / "study.md"

    @property
    def runs(self) -> Path:
        """The folders of the runs."""
        return self.path / "runs"

    @property
    def figures(self) -> Path:
        """The folder of the figures."""
        return self.path / "figures"

    def check(self, scene: Mapping[str, Any]) -> None:
        """Say whether a study of a scene may be made, or gone on with, in the folder, without touching anything.

        Args:
            scene: with its defaults filled in, of types that JSON knows.

        Raises:
            OutputError: it is no folder, holds something other than a study, or holds one of another scene.
        """
        where = f"output folder {self.path}"
        try:
            if not self.path.is_dir():
                if self.path.exists():
                    raise OutputError(f"{where}: exists and is not a folder")
                return
            if is_locked(self.path):
                raise OutputError(f"{where}: another study is writing to it")
            found = [file.name for file in self.path.iterdir() if file.name not in (LOCK, self._part.name)]
        except OSError as error:
            raise OutputError(f"{where}: cannot be read: {error.strerror or error}") from error
        if not found:
            return
        summary = self._read()
        if summary is None:
            raise OutputError(f"{where}: holds something other than a study; choose another folder")
        if summary.get("scene") != scene:
            raise OutputError(f"{where}: holds a study of another scene; choose another folder")

    def write(self, summary: Mapping[str, Any]) -> None:
        """Replace ``study.json`` in one move.

        Args:
            summary: of types that JSON knows; numbers are finite.

        Raises:
            OutputError: it cannot be written.
        """
        text = json.dumps({"study_format": FORMAT, **summary}, indent=2, allow_nan=False) + "\n"
        try:
            self._part.write_text(text, encoding="utf-8")
            self._part.replace(self.summary)
        except OSError as error:
            raise OutputError(f"{self.summary}: cannot be written: {error.strerror or error}") from error

    @property
    def _part(self) -> Path:
        return self.path / "study.json.part"

    def _read(self) -> dict[str, Any] | None:
        try:
            summary = json.loads(self.summary.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return summary if isinstance(summary, dict) and summary.get("study_format") == FORMAT else None
