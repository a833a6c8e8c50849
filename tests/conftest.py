"""Runs that many tests look at. DOLFINx is imported by the fixtures that need it, not here."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path

    from console import Call

    from cosserat_fx.results import Run


@pytest.fixture(scope="session")
def default_runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    """The two scenes of the demos as they are, without figures and fields, by the kind of their top wall."""
    from layers import WALLS, walk

    folder = tmp_path_factory.mktemp("default")
    return {wall: walk(folder / wall, wall) for wall in WALLS}


@pytest.fixture(params=["very_rough", "medium_rough"])
def default_run(request: pytest.FixtureRequest, default_runs: dict[str, Run]) -> Run:
    """Each of them in turn."""
    run: Run = default_runs[request.param]
    return run


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the small layer that others run with faults, run without any."""
    from faults import PLAIN
    from layers import walk

    folder = tmp_path_factory.mktemp("undisturbed") / "run"
    walk(folder, "medium_rough", *PLAIN)
    return folder


@pytest.fixture(scope="session")
def undisturbed_on_two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same on two ranks."""
    from faults import launch

    folder = tmp_path_factory.mktemp("undisturbed") / "run"
    assert launch(folder, ranks=2).returncode == 0
    return folder


@pytest.fixture
def half(tmp_path: Path) -> Path:
    """Folder of a layer that was asked to stop."""
    from halves import LAYER, first_half

    from cosserat_fx.scene import parse_scene

    first_half(parse_scene(LAYER), tmp_path / "run")
    return tmp_path / "run"


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Call:
    """Calls the program in this process with arguments, and gives back its exit status and what it printed."""
    from console import call_in_this_process

    return partial(call_in_this_process, monkeypatch, capfd)
