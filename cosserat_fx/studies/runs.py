"""The runs of a study: each is a process of the command line, timed as a whole, and is not made twice."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from statistics import median
from time import perf_counter
from typing import Any

from cosserat_fx.checkpoints.identity import digest, identity
from cosserat_fx.results import OutputError, read_run
from cosserat_fx.scene import Scene, SceneError, load_scene

BAD_INPUT, STOPPED = 2, 3
"""Exit statuses of the command line."""
BROKEN = "broken"
"""Status of a run that ended in another way, such as by a signal; it is made again when the study goes on."""
WARM_UP = "warm-up"
"""Name of the run that is made to compile what others need."""
LONG = 60.0
"""A run that takes longer is timed once (s)."""
GRACE = 30.0
"""Time that a run has to end by itself when it is stopped (s)."""
OUTSIDE_THE_LOOP = ("set-up", "output", "checkpoints", "figures")
"""Phases of a run that are not the solver's loop."""
ONLY_TABLES = ("output.figures=false", "output.fields=false")
ONLY_TABLES_OF_PLANE_BODIES = ("output.frames=0", "output.animation=false")
COUNTS = ("steps", "newton_iterations", "cutbacks", "branch_passages")
_FOR_LAUNCHERS = ("OMPI_", "PMIX_", "PMI_", "HYDI_", "PRTE_")
"""Beginnings of variables by which a launcher, or an MPI alone in its process, would make a run part of its own job."""


@dataclass(frozen=True)
class Timing:
    """What one process took (s).

    Attributes:
        process: wall time from its start to its end.
        processor: processor time.
        phases: wall time by phase as ``run.json`` has it, with ``whole run``.
    """

    process: float
    processor: float
    phases: Mapping[str, float]

    @property
    def loop(self) -> float:
        """Wall time of the solver's loop: of the whole run without set-up and output (s)."""
        return self.phases["whole run"] - sum(self.phases.get(phase, 0.0) for phase in OUTSIDE_THE_LOOP)


@dataclass(frozen=True)
class Record:
    """How a run ended and what it took.

    Attributes:
        status: "done", "stopped" where it ended early, "refused" as bad input, or :data:`BROKEN`.
        reason: in words, unless it is done.
        timings: of its repetitions; those that did not begin have none.
        counts: what :data:`COUNTS` names, of its ``run.json``.
        scene: as its ``run.json`` has it.
        scene_sha256: as its ``run.json`` has it.
    """

    status: str
    reason: str | None
    timings: tuple[Timing, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    scene: Mapping[str, Any] = field(default_factory=dict)
    scene_sha256: str = ""

    @property
    def done(self) -> bool:
        """Whether the run came to its end."""
        return self.status == "done"

    @property
    def loop(self) -> float | None:
        """Median of the solver's loop (s); None where nothing was timed."""
        return median(timing.loop for timing in self.timings) if self.timings else None

    @property
    def process(self) -> float | None:
        """Median of the whole process (s); None where nothing was timed."""
        return median(timing.process for timing in self.timings) if self.timings else None

    @property
    def processor(self) -> float | None:
        """Median of the processor time of the whole process (s); None where nothing was timed."""
        return median(timing.processor for timing in self.timings) if self.timings else None

    @property
    def typical(self) -> Timing | None:
        """The repetition in the middle, by its loop."""
        return sorted(self.timings, key=lambda timing: timing.loop)[len(self.timings) // 2] if self.timings else None


class Runs:
    """The runs of a study, below one folder.

    Attributes:
        folder: where they are.
        started: how many processes were started for them.
    """

    def __init__(self, folder: Path, scene: Path, overrides: Sequence[str], *, plane: bool) -> None:
        """Name the folder.

        Args:
            folder: where the runs are.
            scene: the file of the scene.
            overrides: of its keys, for all runs.
            plane: whether it is of a plane body.
        """
        self.folder, self.started, self._scene = folder, 0, scene
        self._overrides = [*overrides, *ONLY_TABLES, *(ONLY_TABLES_OF_PLANE_BODIES if plane else ())]

    def run(
        self, name: str, settings: Mapping[str, str], *, repeats: int, timed: bool = True, patience: float | None = None
    ) -> Record:
        """Make a run unless it is there, as often as it is to be timed.

        Args:
            name: of its folder.
            settings: keys of the scene that it changes, with their values.
            repeats: how often; once where it takes longer than :data:`LONG` or does not come to its end.
            timed: whether its times matter; one whose do not is gone on with where it was interrupted.
            patience: seconds after which it is stopped; for ever by default.
        """
        keys = [*self._overrides, *(f"{key}={value}" for key, value in settings.items())]
        keys += ["output.checkpoints=off"] if timed else []
        try:
            scene = load_scene(self._scene, keys)
        except SceneError as error:
            return Record("refused", str(error))
        record = known = self.known(name, scene)
        if record is not None and record.status == BROKEN:
            record = None
        while record is None or _wants_more(record, repeats):
            self.started += 1
            again = _once(self._command(name, scene, keys, timed=timed), patience)
            before = record.timings if record else ()
            record = self._ended(name, scene, again, before)
        if record is not known:
            self._keep(name, record)
        return record

    def warm_up(self, settings: Mapping[str, str]) -> None:
        """Make one step with settings, so that what has to be compiled for them is compiled when runs are timed.

        Args:
            settings: as for :meth:`run`.
        """
        keys = [*self._overrides, *(f"{key}={value}" for key, value in settings.items()), "stepping.max_steps=1"]
        with suppress(SceneError):
            scene = load_scene(self._scene, keys)
            _once(self._command(WARM_UP, scene, keys, timed=True), None)

    def known(self, name: str, scene: Scene) -> Record | None:
        """What is on record of a run of a scene; None where there is nothing, or of another scene."""
        try:
            kept = json.loads(self._file(name).read_text(encoding="utf-8"))
            timings = tuple(Timing(**timing) for timing in kept.pop("timings"))
            record = Record(timings=timings, **kept)
        except (OSError, ValueError, TypeError, KeyError):
            return None
        if (record.scene, record.scene_sha256) != _identity(scene) or (record.done and not self._is_there(name, scene)):
            return None
        return record

    def is_on_record(self, name: str) -> bool:
        """Whether a run was made before, of whatever scene."""
        return self._file(name).exists()

    def path(self, name: str) -> Path:
        """The folder of a run."""
        return self.folder / name

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.json"

    def _keep(self, name: str, record: Record) -> None:
        """Write a record in one move."""
        part = self._file(name).with_suffix(".part")
        try:
            part.write_text(json.dumps(asdict(record), indent=1) + "\n", encoding="utf-8")
            part.replace(self._file(name))
        except OSError as error:
            raise OutputError(f"{self._file(name)}: cannot be written: {error.strerror or error}") from error

    def _command(self, name: str, scene: Scene, keys: Sequence[str], *, timed: bool) -> list[str]:
        """The command line of a run."""
        settings = [word for key in keys for word in ("--set", key)]
        how = "--resume" if not timed and self._is_there(name, scene) else "--overwrite"
        program = [sys.executable, "-P", "-m", "cosserat_fx", "run"]
        return [*program, str(self._scene), "--out", str(self.path(name)), how, *settings]

    def _is_there(self, name: str, scene: Scene) -> bool:
        """Whether a run's folder holds one of the very scene, finished or not."""
        try:
            summary = read_run(self.path(name)).summary
        except OutputError:
            return False
        return (summary.get("scene"), summary.get("scene_sha256")) == _identity(scene)

    def _ended(self, name: str, scene: Scene, outcome: _Outcome, before: tuple[Timing, ...]) -> Record:
        """The record of a run after one more process.

        Args:
            name: of its folder.
            scene: that it was to run.
            outcome: of the process.
            before: timings that there are.
        """
        described, sha256 = _identity(scene)
        summary: dict[str, Any] = {}
        if outcome.status in (0, STOPPED):
            try:
                summary = read_run(self.path(name)).summary
            except OutputError as error:
                return Record(BROKEN, str(error), before, {}, described, sha256)
        phases = summary.get("seconds", {})
        timings = (*before, Timing(outcome.process, outcome.processor, phases)) if phases else before
        status = {0: "done", STOPPED: "stopped", BAD_INPUT: "refused"}.get(outcome.status, BROKEN)
        reason = None if status == "done" else outcome.why or summary.get("reason") or outcome.last_words
        counts = {count: summary[count] for count in COUNTS if count in summary}
        return Record(status, reason, timings, counts, described, sha256)


@dataclass(frozen=True)
class _Outcome:
    """How a process ended.

    Attributes:
        status: its exit status, negative for a signal.
        process: wall time (s).
        processor: processor time (s).
        last_words: what it last said on standard error.
        why: it was stopped, if it was.
    """

    status: int
    process: float
    processor: float
    last_words: str
    why: str | None


def environment() -> dict[str, str]:
    """What runs are started with: one thread, the modules of this process, and no launcher's variables."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(_FOR_LAUNCHERS)}
    return kept | {"OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def _once(command: Sequence[str], patience: float | None) -> _Outcome:
    """Start a process and wait for its end; it ends with this one.

    Args:
        command: its arguments.
        patience: seconds after which it is stopped.
    """
    before, start, why = _processor_time(), perf_counter(), None
    with subprocess.Popen(
        command, env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace"
    ) as process:
        try:
            _, said = process.communicate(timeout=patience)
        except subprocess.TimeoutExpired:
            why = f"stopped after {patience:.0f} s, many times what was expected"
            said = _stop(process)
        except BaseException:
            _stop(process)
            raise
    lines = [line for line in said.splitlines() if line.strip()]
    words = lines[-1].removeprefix("cosserat-fx: ") if lines else ""
    status = process.returncode
    if status < 0 and not why:
        words = f"ended by {signal.Signals(-status).name}"
    return _Outcome(status, perf_counter() - start, _processor_time() - before, words or f"ended with {status}", why)


def _stop(process: subprocess.Popen[str]) -> str:
    """End a process, gently if it lets itself be; return what it said."""
    process.terminate()
    try:
        return process.communicate(timeout=GRACE)[1]
    except subprocess.TimeoutExpired:
        process.kill()
        return process.communicate()[1]


def _processor_time() -> float:
    """Of all processes that this one started and that have ended (s)."""
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _wants_more(record: Record, repeats: int) -> bool:
    """Whether a run is to be timed once more."""
    if not record.done or len(record.timings) >= repeats:
        return False
    return max((timing.process for timing in record.timings), default=0.0) < LONG


def _identity(scene: Scene) -> tuple[dict[str, Any], str]:
    """What tells a run's scene from others: all of it, and what the files hold that it names."""
    return json.loads(json.dumps(scene.as_dict())), digest(identity(scene))
