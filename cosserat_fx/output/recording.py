"""What a kind of body shows in a run: the columns of its history, and what else it leaves in the folder."""

from __future__ import annotations

from typing import Any, Protocol

from cosserat_fx.output.layer_observation import Row
from cosserat_fx.results import RunFolder
from cosserat_fx.stepping import Step


class Recording(Protocol):
    """Reads a body and writes what is particular to its kind; every rank calls every method."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of ``history.csv``; ``max_shear_strain`` is one of them."""

    @property
    def profile_columns(self) -> tuple[str, ...]:
        """Columns of ``profiles.csv``; none where there is no such file."""

    def travel(self, step: Step) -> float:
        """Travel of a step as the scene counts it (m)."""

    def row(self, step: Step) -> Row:
        """The history's row of a step just accepted, the same on every rank."""

    def start(self, folder: RunFolder) -> None:
        """Write what is to be kept of the initial state into the run's folder, just created.

        Raises:
            OutputError: a file cannot be written.
        """

    def memento(self) -> dict[str, Any]:
        """What has to be remembered to go on after the last row, of types that JSON knows; read on rank 0."""

    def resume(self, folder: RunFolder, memento: dict[str, Any]) -> None:
        """Go on in a run's folder, instead of :meth:`start`.

        Args:
            folder: of the run.
            memento: what :meth:`memento` gave.
        """

    def record(self, step: Step) -> None:
        """Write what is to be kept of an accepted step beside its row.

        Raises:
            OutputError: a file cannot be written.
        """

    def finish(self) -> None:
        """Measure the state after the last step; there was at least one."""

    def entries(self) -> dict[str, Any]:
        """What the kind adds to ``run.json``, metrics after :meth:`finish` only; the same on every rank."""
