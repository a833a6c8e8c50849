"""Work of one rank on behalf of all: what fails there fails everywhere."""

from __future__ import annotations

from collections.abc import Callable

from cosserat_fx._compat import MPI


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
