"""Files that others have written are read with no more memory and time than their size calls for, and in silence.

Readers believe what a file says of itself: how many nodes are coming, say, or how deep its tables are nested.
"""

from __future__ import annotations

import contextlib
import gc
import io
import resource
import signal
import threading
import warnings
from collections.abc import Iterator
from types import FrameType

from cosserat_fx.machine import address_space, memory_of_node

MEMORY, MEMORY_OF_BYTE = 512_000_000, 100
"""Memory in which a file is read: at least, and for each of its bytes."""
SECONDS, SECONDS_OF_BYTE = 10.0, 2e-6
"""Processor time in which a file is read: at least, and for each of its bytes (s)."""
_AGAIN = 0.1
"""Processor time after which a reader that goes on all the same is stopped again (s)."""


@contextlib.contextmanager
def bounded(size: int) -> Iterator[io.StringIO]:
    """Read a file of a given size in the body of a ``with`` statement, in silence.

    Args:
        size: of the file (bytes).

    Yields:
        What is printed meanwhile.

    Raises:
        MemoryError: the body takes far more memory than such a file calls for, or more than there is.
        TimeoutError: the same for processor time; watched in a program's main thread only.
        DeprecationWarning: NumPy finds something else where numbers should be.
    """
    with contextlib.ExitStack() as stack:
        said = io.StringIO()
        stack.enter_context(contextlib.redirect_stdout(said))
        stack.enter_context(contextlib.redirect_stderr(said))
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
        stack.enter_context(_bounded_memory(min(MEMORY + MEMORY_OF_BYTE * size, int(memory_of_node()))))
        stack.enter_context(_bounded_time(SECONDS + SECONDS_OF_BYTE * size))
        yield said


@contextlib.contextmanager
def _bounded_memory(size: int) -> Iterator[None]:
    """Let the address space grow by so many bytes."""
    limit, highest = resource.getrlimit(resource.RLIMIT_AS)
    wanted = address_space() + size
    if limit != resource.RLIM_INFINITY and limit < wanted:
        wanted = limit
    resource.setrlimit(resource.RLIMIT_AS, (wanted, highest))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (limit, highest))


@contextlib.contextmanager
def _bounded_time(seconds: float) -> Iterator[None]:
    """Let the processor work for so long."""
    if threading.current_thread() is not threading.main_thread():  # which alone gets signals
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError("reading it takes far longer than a file of its size should")

    before, collecting = signal.signal(signal.SIGPROF, stop), gc.isenabled()
    gc.disable()  # an exception out of what the collector calls would be lost
    signal.setitimer(signal.ITIMER_PROF, seconds, _AGAIN)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
        if collecting:
            gc.enable()
