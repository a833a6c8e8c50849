"""Reading within bounds: what exceeds them ends, what is said is caught, and all is as before afterwards."""

import gc
import resource
import signal
import sys
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest

from cosserat_fx import guard
from cosserat_fx.guard import bounded
from cosserat_fx.machine import address_space
from cosserat_fx.text import printable


def state() -> tuple[object, ...]:
    """Whatever a reader's bounds touch."""
    return (
        resource.getrlimit(resource.RLIMIT_AS),
        signal.getsignal(signal.SIGPROF),
        signal.getitimer(signal.ITIMER_PROF),
        gc.isenabled(),
        sys.stdout,
        sys.stderr,
    )


def go_on_for_ever() -> None:
    while True:
        pass


def test_all_is_as_before_after_success_and_after_failure() -> None:
    before = state()
    with bounded(10):
        assert state() != before
    assert state() == before
    with pytest.raises(ZeroDivisionError), bounded(10):
        raise ZeroDivisionError
    assert state() == before


def test_memory_is_bounded_by_the_size_of_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "MEMORY", 50_000_000)
    with pytest.raises(MemoryError), bounded(1000):
        np.zeros(3_000_000_000, dtype=np.uint8)
    with bounded(50_000_000):
        assert len(np.zeros(3_000_000_000, dtype=np.uint8)) == 3_000_000_000


def test_a_lower_limit_of_the_process_stays() -> None:
    before = resource.getrlimit(resource.RLIMIT_AS)
    low = address_space() + 50_000_000
    resource.setrlimit(resource.RLIMIT_AS, (low, before[1]))
    try:
        with bounded(10):
            assert resource.getrlimit(resource.RLIMIT_AS) == (low, before[1])
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def test_time_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "SECONDS", 0.05)
    with pytest.raises(TimeoutError, match="takes far longer"), bounded(10):
        go_on_for_ever()


def test_a_reader_that_swallows_the_end_is_ended_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "SECONDS", 0.05)
    swallowed: list[TimeoutError] = []

    def read() -> None:
        try:
            go_on_for_ever()
        except TimeoutError as error:
            swallowed.append(error)
        go_on_for_ever()

    with pytest.raises(TimeoutError), bounded(10):
        read()
    assert len(swallowed) == 1


def test_other_threads_read_without_a_clock() -> None:
    found: list[float] = []

    def read() -> None:
        with bounded(10):
            found.append(signal.getitimer(signal.ITIMER_PROF)[0])

    thread = threading.Thread(target=read)
    thread.start()
    thread.join()
    assert found == [0.0]


def test_what_is_said_is_caught_and_half_read_numbers_are_an_error(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with bounded(10) as said:
        print("to the left")
        print("to the right", file=sys.stderr)
        warnings.warn("of the dog", stacklevel=1)
    assert said.getvalue() == "to the left\nto the right\n"
    assert capfd.readouterr() == ("", "")
    (tmp_path / "numbers").write_text("1 2 three")
    with pytest.raises((DeprecationWarning, ValueError)), bounded(10):  # the latter from NumPy 2.3 on
        np.fromfile(tmp_path / "numbers", sep=" ")


def test_what_cannot_be_printed_is_spelled() -> None:
    assert printable("a\x1b[2J\n\udcff\u202e é") == r"a\x1b[2J\n\udcff\u202e é"
    assert printable("a\nb", keep="\n") == "a\nb"
