"""The program as a user sees it: arguments in; exit status, text and files out."""

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from layers import NOTHING_TO_LOOK_AT

from cosserat_fx import cli

DONE, BAD_INPUT, STOPPED = 0, 2, 3
QUICK = [*NOTHING_TO_LOOK_AT, "walls.top.shear_displacement=2e-4", "output.profiles_at=[2e-4]"]
"""Three steps of a demo."""


class Outcome(NamedTuple):
    """Exit status and what was printed."""

    status: int
    out: str
    err: str


type Call = Callable[..., Outcome]


def call_in_this_process(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], *arguments: object
) -> Outcome:
    """Calls the program as the console script does; what PETSc prints counts too."""
    capfd.readouterr()
    monkeypatch.setattr(sys, "argv", ["cosserat-fx", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert isinstance(end.value.code, int | None)
    return Outcome(end.value.code or 0, *capfd.readouterr())


def settings(*overrides: str) -> list[str]:
    return [argument for override in overrides for argument in ("--set", override)]


def quick(*overrides: str) -> list[str]:
    """Arguments for a run of a few steps."""
    return settings(*QUICK, *overrides)


def listing(folder: Path) -> dict[Path, tuple[int, bytes]]:
    """Every file and folder below a folder with its time, and its contents."""
    return {path: (path.stat().st_mtime_ns, path.read_bytes() if path.is_file() else b"") for path in folder.rglob("*")}


def assert_refused(outcome: Outcome, message: str) -> None:
    """Exit status 2 and one line, without a traceback."""
    assert outcome.status == BAD_INPUT
    assert message in outcome.err
    assert re.fullmatch(r"cosserat-fx: .+\n", outcome.err)
    assert outcome.out == ""
