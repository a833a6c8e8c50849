"""The checkpoints of a run: from the newest good one it goes on as if it had never stopped.

Two files in the run's folder, the newest and the one before it. Each is written whole under another name before it
takes its place, so that a kill at any moment leaves at least one of them.
"""

from __future__ import annotations

import os
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from cosserat_fx.checkpoints import file as checkpoint_file
from cosserat_fx.checkpoints import identity, snapshot
from cosserat_fx.checkpoints.file import CheckpointError
from cosserat_fx.parallel import on_first_rank
from cosserat_fx.results import OutputError, RunFolder
from cosserat_fx.scene import Scene
from cosserat_fx.stepping import Stepper

__all__ = ["SHARE", "CheckpointError", "Checkpoints"]

SHARE = 0.01
"""Part of a run's time that checkpoints may take where nothing else is asked for."""


class ForeignCheckpointError(CheckpointError):
    """A checkpoint is of another scene."""


class Checkpoints:
    """Writes the checkpoints of one run, and finds the one to go on from. Every rank calls every method."""

    def __init__(self, folder: RunFolder, scene: Scene, stepper: Stepper) -> None:
        """Prepare.

        Args:
            folder: of the run.
            scene: of the run; its ``output.checkpoints`` says how often to write.
            stepper: the walk.

        Raises:
            OutputError: a file that the scene names has gone.
        """
        self._folder, self._stepper, self._interval = folder, stepper, scene.output.checkpoints
        self._comm = stepper.problem.comm
        self._identity: dict[str, Any] = on_first_rank(self._comm, lambda: _identity(scene))
        self._record = snapshot.cell_record(stepper.problem)
        self._start = self._last = perf_counter()
        self._spent = self._cost = 0.0

    @property
    def scene_digest(self) -> str:
        """A hash of all of the scene that may not change while a run goes on."""
        return identity.digest(self._identity)

    @property
    def wanted(self) -> bool:
        """Whether checkpoints are written at all."""
        return self._interval != "off"

    def due(self) -> bool:
        """Whether to write one now."""
        if isinstance(self._interval, str) and self._interval != "auto":
            return False
        now = perf_counter()
        if self._interval == "auto":
            due = self._spent + self._cost <= SHARE * (now - self._start)
        else:
            due = now - self._last >= self._interval
        return bool(self._comm.bcast(due))

    def save(self, notes: dict[str, Any]) -> None:
        """Write the walk as it stands between two steps, after its last step has been recorded.

        Args:
            notes: what else the run has to remember, of types that JSON knows.

        Raises:
            OutputError: the files cannot be written; those that were there still are.
        """
        begin = perf_counter()
        try:
            self._write(notes)
        finally:
            self._last = perf_counter()
            self._cost = self._last - begin
            self._spent += self._cost

    def _write(self, notes: dict[str, Any]) -> None:
        """Do what :meth:`save` does."""
        walk, records = snapshot.take(self._stepper)
        sizes = on_first_rank(self._comm, self._folder.settle)
        header = {"scene": self._identity, "walk": walk, "files": sizes, "notes": notes}
        part = self._folder.checkpoint.with_suffix(".part")
        numbers = snapshot.own_cells(self._stepper.problem).numbers
        checkpoint_file.write(part, header, records, numbers, self._comm)
        on_first_rank(self._comm, lambda: self._replace(part))

    def load(self) -> tuple[dict[str, Any], list[str]] | None:
        """Let the walk stand where the newest good checkpoint says, and cut the run's tables to the rows before it.

        Returns:
            The notes and what was wrong with a newer one, or None where there is no checkpoint at all.

        Raises:
            CheckpointError: there are checkpoints, but none is good, or they belong to another scene.
        """
        found = [it for it in (self._folder.checkpoint, self._folder.previous_checkpoint) if it.exists()]
        found = self._comm.bcast(found)
        complaints: list[str] = []
        for candidate in found:
            try:
                notes = self._load(candidate)
            except ForeignCheckpointError:
                raise
            except CheckpointError as error:
                complaints.append(str(error))
            else:
                return notes, complaints
        if complaints:
            raise CheckpointError("; ".join(complaints))
        return None

    def remove(self) -> None:
        """Remove the files: the run is done.

        Raises:
            OutputError: they cannot be removed.
        """
        on_first_rank(self._comm, self._remove)

    def _load(self, candidate: Path) -> dict[str, Any]:
        problem = self._stepper.problem

        def read() -> tuple[dict[str, Any], int]:
            header, begin = checkpoint_file.read_header(candidate)
            if reason := identity.difference(header["scene"], self._identity):
                raise ForeignCheckpointError(f"{candidate}: belongs to another scene: {reason}")
            if header["record_bytes"] != self._record.itemsize:
                raise CheckpointError(f"{candidate}: belongs to another discretisation of the scene")
            try:
                self._folder.check_tables(header["files"], header["walk"]["number"])
            except OutputError as error:
                raise CheckpointError(f"{candidate}: cannot be gone on from: {error}") from error
            return header, begin

        header, begin = on_first_rank(self._comm, read)
        cells = snapshot.cells_in_sight(problem)
        count = problem.geometry.mesh.topology.index_map(problem.geometry.mesh.topology.dim).size_global
        if header["records"] != count:
            raise CheckpointError(f"{candidate}: has {header['records']} cells, the mesh has {count}")
        records = checkpoint_file.read_records(candidate, begin, self._record, cells.numbers, self._comm)
        mine = np.isin(cells.numbers, snapshot.own_cells(problem).numbers)
        if checkpoint_file.checksum(records[mine], cells.numbers[mine], self._comm) != header["checksum"]:
            raise CheckpointError(f"{candidate}: damaged: the checksum of its records is wrong")
        if not snapshot.is_of_this_mesh(problem, records):
            raise CheckpointError(f"{candidate}: belongs to another mesh")
        snapshot.put_back(self._stepper, header["walk"], records)
        on_first_rank(self._comm, lambda: self._folder.cut_tables(header["files"]))
        notes: dict[str, Any] = header["notes"]
        return notes

    def _remove(self) -> None:
        try:
            self._folder.remove_checkpoints()
        except OSError as error:
            raise OutputError(f"{error.filename}: cannot be removed: {error.strerror or error}") from error

    def _replace(self, part: Path) -> None:
        """Make the newest checkpoint the one before, and a file just written the newest."""
        newest = self._folder.checkpoint
        try:
            if newest.exists():
                newest.replace(self._folder.previous_checkpoint)
            part.replace(newest)
            folder = os.open(newest.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        except OSError as error:
            raise OutputError(f"{newest}: cannot be written: {error.strerror or error}") from error


def _identity(scene: Scene) -> dict[str, Any]:
    try:
        return identity.identity(scene)
    except OSError as error:
        raise OutputError(f"{error.filename}: cannot be read: {error.strerror or error}") from error
