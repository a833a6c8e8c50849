"""Signals that ask a run to stop: it does so where nothing is lost, on all ranks alike."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from time import monotonic
from types import FrameType, TracebackType
from typing import Any, Self

from cosserat_fx._compat import MPI

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)
"""What schedulers, users and MPI launchers send; launchers pass on SIGUSR1 and leave it at that."""
GRACE = 1.0
"""A signal so soon after the first is the same one on another way: by scheduler and launcher, say (s)."""


class InterruptedRunError(Exception):
    """A run was asked to stop by a signal, which the message names."""


class Interruption:
    """Waits for signals while a run goes on; a context manager. A second one, after :data:`GRACE`, ends the process."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        """Prepare.

        Args:
            comm: the ranks of the run; the signal may reach any of them.
        """
        self._comm, self._received, self._when = comm, 0, 0.0
        self._before: dict[signal.Signals, Callable[..., Any] | int | None] = {}

    def __enter__(self) -> Self:
        """Begin to wait, where signals can be had: in the main thread."""
        if threading.current_thread() is threading.main_thread():
            self._before = {it: signal.signal(it, self._receive) for it in SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the signals to those who had them before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def check(self) -> None:
        """End the run if a signal has reached any rank. Collective.

        Raises:
            InterruptedRunError: one has, on every rank.
        """
        received = self._received
        if self._comm.size > 1:
            received = self._comm.allreduce(received, op=MPI.MAX)
        if received:
            raise InterruptedRunError(f"interrupted by {signal.Signals(received).name}")

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if not self._received:
            self._received, self._when = number, monotonic()
        elif monotonic() > self._when + GRACE:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
