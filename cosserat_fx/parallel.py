"""Work of one rank on behalf of all, where what fails fails everywhere, and how a rank learns that it failed alone."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic, sleep
from types import TracebackType
from typing import Self

from mpi4py import MPI

PATIENCE = 5.0
"""How long a rank that failed waits for the others to do so too (s)."""


class FailedAloneError(RuntimeError):
    """A rank failed while the others did not, which would wait for it for ever; it has to end them."""


class RollCall:
    """Tells a rank whether all others have come to where it is; a context manager, which every rank enters."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        """Name the ranks.

        Args:
            comm: the ranks.
        """
        self._comm = comm

    def __enter__(self) -> Self:
        """Get a line of its own, as the others may be in the middle of something on theirs. Collective."""
        self._line = self._comm.Dup()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give it back, unless others may still be waiting elsewhere."""
        if error is None:
            self._line.Free()

    def is_complete(self) -> bool:
        """Whether all ranks call this within :data:`PATIENCE`; where they do not, this rank has to end them."""
        arrival, end = self._line.Ibarrier(), monotonic() + PATIENCE
        while not arrival.Test():
            if monotonic() > end:
                return False
            sleep(0.01)
        return True


def on_first_rank[Result](comm: MPI.Intracomm, work: Callable[[], Result]) -> Result:
    """Do something on rank 0 and share its result, or raise its exception, on every rank.

    Args:
        comm: the ranks; all of them call this.
        work: what to do; its result or exception has to be picklable.
    """
    result, error = None, None
    if comm.rank == 0:
        try:
            result = work()
        except Exception as caught:  # whatever it is, the other ranks must not wait for ever
            error = caught
    result, error = comm.bcast((result, error))
    if error is not None:
        raise error
    shared: Result = result
    return shared


def in_turn(comm: MPI.Intracomm, work: Callable[[], None]) -> None:
    """Compile something on the first rank, then load it on the others, so that they do not race for a cache on disk.

    Args:
        comm: the ranks; all of them call this.
        work: what to do.
    """
    if comm.rank == 0:
        work()
    comm.barrier()
    if comm.rank != 0:
        work()
