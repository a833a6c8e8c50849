"""One scene of the stability atlas, walked under a guard, and what became of it."""

from __future__ import annotations

import csv
import gc
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from time import process_time
from typing import Any, Literal, get_args, get_type_hints

import numpy as np
from stability_atlas_scenes import AtlasScene

from cosserat_fx._compat import MPI
from cosserat_fx.layer import Layer, build
from cosserat_fx.scene import LayerScene, parse_scene
from cosserat_fx.stepping import SteppingError

MAX_SECONDS = 300
MAX_STEPS = 20_000

Ending = Literal["done", "stopped", "hung", "crashed"]
ENDINGS: tuple[Ending, ...] = get_args(Ending)


class HungError(Exception):
    """A scene took longer than the guard allows."""


@dataclass(frozen=True)
class Outcome:
    """What became of a scene.

    Attributes:
        ending: "done" at the end of the path; "stopped" with a reason; "hung" where it was stopped by the guard;
            "crashed" with anything but a :class:`~cosserat_fx.stepping.SteppingError`.
        reason: what the program said, empty where it is done.
        travelled: part of the path that was gone.
        steps, iterations, cutbacks, passages, jumps: totals.
        substeps: largest number of local substeps of any point at the end of any step.
        seconds: of the processor.
        finite: whether every committed field holds numbers alone.
    """

    ending: Ending
    reason: str
    travelled: float
    steps: int
    iterations: int
    cutbacks: int
    passages: int
    jumps: int
    substeps: int
    seconds: float
    finite: bool


@dataclass(frozen=True)
class Entry:
    """A scene with its outcome: a row of the atlas."""

    scene: AtlasScene
    outcome: Outcome


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise :class:`HungError` where the body takes longer, also in the middle of a step."""

    def stop(signum: int, frame: object) -> None:
        raise HungError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def walk(scene: AtlasScene, *, max_seconds: float = MAX_SECONDS) -> Outcome:
    """Walk a scene to its end, or to where it stops.

    Args:
        scene: of the atlas.
        max_seconds: after which it counts as hung.
    """
    begin = process_time()
    parsed = parse_scene(scene.tables() | {"stepping": _stepping(scene)})
    assert isinstance(parsed, LayerScene)
    layer = build(parsed, MPI.COMM_SELF)
    ending: Ending = "done"
    reason, travel = "", 0.0
    steps = iterations = cutbacks = passages = jumps = substeps = 0
    try:
        with time_limit(max_seconds):
            for step in layer.stepper:
                steps, travel = step.number, step.travel
                iterations += step.iterations
                cutbacks += step.cutbacks
                passages += step.passages
                jumps += step.jumps
                substeps = max(substeps, int(layer.problem.state.substeps.max()))
    except SteppingError as error:
        ending, reason = "hung" if steps == MAX_STEPS else "stopped", str(error)
    except HungError:
        ending, reason = "hung", f"after {max_seconds:g} s"
    except Exception as error:
        ending, reason = "crashed", f"{type(error).__name__}: {error}"
    finite = _finite(layer)
    part = travel / layer.path.length
    layer.stepper.solver.snes.destroy()  # or its callbacks keep the problem and its MPI communicators, of which
    del layer  # a process has not many
    gc.collect()
    seconds = process_time() - begin
    return Outcome(ending, reason, part, steps, iterations, cutbacks, passages, jumps, substeps, seconds, finite)


def _stepping(scene: AtlasScene) -> dict[str, float]:
    """The scene's own step sizes under the guard's number of steps."""
    return {"max_steps": MAX_STEPS, **scene.tables().get("stepping", {})}


def _finite(layer: Layer) -> bool:
    state = layer.problem.state
    return all(np.isfinite(field).all() for field in (layer.problem.committed.x.array, state.forces_n, state.e_n))


class Log:
    """The rows of the atlas in a file, to which each is added as soon as it is known."""

    def __init__(self, file: Path) -> None:
        """Open the log.

        Args:
            file: CSV, made where there is none.
        """
        self._file = file
        self._names = [f.name for f in (*fields(AtlasScene), *fields(Outcome))]
        if not file.exists():
            with file.open("w", newline="") as stream:
                csv.DictWriter(stream, self._names).writeheader()

    def append(self, entry: Entry) -> None:
        """Add a row."""
        with self._file.open("a", newline="") as stream:
            csv.DictWriter(stream, self._names).writerow(asdict(entry.scene) | asdict(entry.outcome))

    def read(self) -> list[Entry]:
        """All rows, by the scenes' numbers."""
        with self._file.open(newline="") as stream:
            rows = list(csv.DictReader(stream))
        return sorted((_entry(row) for row in rows), key=lambda entry: entry.scene.number)


def _entry(row: dict[str, str]) -> Entry:
    """A row's cells as the types of their fields."""
    return Entry(AtlasScene(**_cells(AtlasScene, row)), Outcome(**_cells(Outcome, row)))


def _cells(kind: type, row: dict[str, str]) -> dict[str, Any]:
    return {name: _cell(row[name], hint) for name, hint in get_type_hints(kind).items()}


def _cell(text: str, hint: Any) -> Any:
    if hint is bool:
        return text == "True"
    return text if get_args(hint) else hint(text)
