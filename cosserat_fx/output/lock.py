"""One run at a time in a folder: a lock that the system lets go of when its process ends, however it ends."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from cosserat_fx.output.tables import OutputError, discard

LOCK = "run.lock"
"""The file in a run's folder that is locked while the run writes there, and removed afterwards."""


def is_locked(folder: Path) -> bool:
    """Whether a run is writing to a folder.

    Args:
        folder: it need not exist.
    """
    try:
        handle = os.open(folder / LOCK, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    else:
        return False
    finally:
        os.close(handle)


class FolderLock:
    """The right to write to a run's folder."""

    def __init__(self, folder: Path) -> None:
        """Name the folder.

        Args:
            folder: of the run.
        """
        self._folder, self._file = folder, folder / LOCK
        self._handle: int | None = None

    def acquire(self) -> None:
        """Take the right, for as long as this process lives; the folder is made if it does not exist.

        Raises:
            OutputError: another run has it, or the folder cannot be written.
        """
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            while self._handle is None:
                handle = os.open(self._file, os.O_RDWR | os.O_CREAT, 0o666)
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    if self._is_in_place(handle):
                        self._handle = handle
                finally:
                    if self._handle is None:
                        os.close(handle)
        except BlockingIOError:
            raise OutputError(f"output folder {self._folder}: another run is writing to it") from None
        except OSError as error:
            raise OutputError(f"output folder {self._folder}: cannot be written: {error.strerror or error}") from error

    def release(self) -> None:
        """Let another run have it, and remove its trace."""
        if self._handle is not None:
            discard(self._file)
            os.close(self._handle)
            self._handle = None

    def _is_in_place(self, handle: int) -> bool:
        """Whether the file that was opened is still the one in the folder, which its last owner may have removed."""
        try:
            return os.path.samestat(os.fstat(handle), self._file.stat())
        except FileNotFoundError:
            return False
