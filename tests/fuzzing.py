"""Cases of bad input judged by what a user is promised.

The scene is valid, or it is refused with one clear message; in neither case is anything printed, written or executed.
"""

from __future__ import annotations

import contextlib
import faulthandler
import importlib.util
import io
import math
import os
import re
import resource
import sys
import tempfile
import types
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from unittest import mock

from console import BAD_INPUT, listing
from fuzz_bases import Case

from cosserat_fx import cli, layer, plane
from cosserat_fx._compat import MPI
from cosserat_fx.bodies import build
from cosserat_fx.cost import expected_cost
from cosserat_fx.effects import effects
from cosserat_fx.kernel_time import kernel_shares
from cosserat_fx.machine import address_space
from cosserat_fx.run import describe
from cosserat_fx.scene import SceneError, load_scene
from cosserat_fx.scenes.plane import RectangleGeometry

HANG = 120.0
"""Seconds after which a case is taken to hang for ever, and all ends with a traceback."""
ALLOWANCE = 3_000_000_000
"""Address space that a case may take (bytes)."""
SMALL = 20_000
"""Cells up to which the body of a valid scene is made."""
LONGEST_LINE, MOST_LINES = 2000, 21


class _Far(Exception):  # noqa: N818  # no error: all that can refuse a scene is behind
    """The forms of a body would be compiled next."""


def refusal(case: Case, *, compiling: bool = False) -> str | None:
    """What a case is refused with, None where it is valid; whatever else happens is raised.

    Args:
        case: the case.
        compiling: whether to do with a valid one all that the command check does, and not stop before anything is
            compiled.
    """
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), _watched():
        for name, content in case.files.items():
            Path(name).write_bytes(content)
        before = listing(Path())
        with _silent() as printed:
            message = _refusal(Path("scene.toml"), case.overrides, compiling=compiling)
        assert listing(Path()) == before, "files were written"
        assert printed() == "", f"printed: {printed()!r}"
    if message is not None:
        assert_clear(message)
    return message


def _refusal(file: Path, given: Sequence[str], *, compiling: bool) -> str | None:
    try:
        scene = load_scene(file, given)
        with contextlib.ExitStack() as stack:
            if not compiling:
                for module in (layer, plane):
                    stack.enter_context(mock.patch.object(module, "Problem", side_effect=_Far))
            if not _is_large(scene):
                body = build(scene, MPI.COMM_SELF)
                describe(body, kernel_shares(effects(body), body))
                assert str(expected_cost(body))
    except SceneError as error:
        return str(error)
    except _Far:
        pass
    return None


def _is_large(scene: object) -> bool:
    geometry = getattr(scene, "geometry", None)
    cells = math.prod(geometry.cells) if isinstance(geometry, RectangleGeometry) else getattr(geometry, "cells", 0)
    return cells > SMALL


def assert_clear(message: str) -> None:
    """One message of lines that each name a file or key, fit for a terminal and a log."""
    lines = message.split("\n")
    assert len(lines) <= MOST_LINES
    for line in lines:
        assert re.match(r".+: .+|.+ is missing: .+|\.\.\. and \d+ more", line), line
        assert len(line) <= LONGEST_LINE, line
        assert line.isprintable(), line
    assert not re.search(r"Traceback|pydantic|https?://|<class|\bobject at\b", message), message
    message.encode()


@contextlib.contextmanager
def _silent() -> Iterator[Callable[[], str]]:
    """Catch what is printed in Python and below it; gives a function that tells it afterwards."""
    with tempfile.TemporaryFile() as file, io.StringIO() as text:
        kept = [os.dup(number) for number in (1, 2)]
        sys.stdout.flush()
        sys.stderr.flush()
        try:
            for number in (1, 2):
                os.dup2(file.fileno(), number)
            with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
                yield lambda: said
        finally:
            for number, old in zip((1, 2), kept, strict=True):
                os.dup2(old, number)
                os.close(old)
            file.seek(0)
            said = text.getvalue() + file.read().decode("utf-8", "replace")


@contextlib.contextmanager
def _watched() -> Iterator[None]:
    """End the process where it hangs, bound its memory, and let XDMF files be read where h5py is not installed."""
    there = importlib.util.find_spec("h5py") is not None
    limit, highest = resource.getrlimit(resource.RLIMIT_AS)
    faulthandler.dump_traceback_later(HANG, exit=True)
    resource.setrlimit(resource.RLIMIT_AS, (address_space() + ALLOWANCE, highest))
    if not there:
        sys.modules["h5py"] = types.ModuleType("h5py")  # for XDMF with its numbers in the XML, an import does
    try:
        yield
    finally:
        if not there:
            del sys.modules["h5py"]
        resource.setrlimit(resource.RLIMIT_AS, (limit, highest))
        faulthandler.cancel_dump_traceback_later()


# -- the command line --------------------------------------------------------------------------------------------------


def assert_same_on_command_line(case: Case, message: str | None) -> None:
    """A case that is refused is so by ``check`` and ``run`` alike: status 2, the same message, nothing written.

    Args:
        case: the case.
        message: what it is refused with; None where it is valid, and not looked at here.
    """
    if message is None:
        return
    for command in (["check"], ["run", "--out", "run"]):
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), _watched():
            for name, content in case.files.items():
                Path(name).write_bytes(content)
            before = listing(Path())
            given = [argument for override in case.overrides for argument in ("--set", override)]
            with _silent() as printed, mock.patch.object(sys, "argv", ["cosserat-fx", *command, "scene.toml", *given]):
                try:
                    cli.main()
                except SystemExit as end:
                    status = end.code
            assert status == BAD_INPUT, status
            assert printed() == f"cosserat-fx: {message}\n"
            assert listing(Path()) == before, "files were written"
