"""A study from its scene to its tables and figures: the runs it takes, one after the other."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from cosserat_fx.output.lock import FolderLock
from cosserat_fx.results import OutputError, read_run
from cosserat_fx.scene import LayerScene, PlaneScene, Scene, SceneError, load_scene
from cosserat_fx.scenes.refusals import line
from cosserat_fx.studies.assessment import Assessment
from cosserat_fx.studies.choice import Choice, Effect, Spelling
from cosserat_fx.studies.folder import StudyFolder
from cosserat_fx.studies.plan import Plan, effects_of, element_of, plan, sizes_for
from cosserat_fx.studies.progress import Forecast, StudyProgress, Task
from cosserat_fx.studies.quantities import Measured, Quantity, left_out, measure, quantities
from cosserat_fx.studies.report import Report
from cosserat_fx.studies.runs import Record, Runs


class StudyError(RuntimeError):
    """A study that cannot say anything; the message gives the reason."""


@dataclass
class _Study:
    """A study while it goes on.

    Attributes:
        scene: as it is.
        runs: its runs.
        quantities: what may be compared.
        repeats: how often a run is timed.
        records: how runs ended.
        measured: what those came to that came to their end.
        warm: elements and effects left out for which everything is compiled.
    """

    scene: Scene
    runs: Runs
    quantities: list[Quantity]
    repeats: int
    records: dict[Choice, Record] = field(default_factory=dict)
    measured: dict[Choice, Measured] = field(default_factory=dict)
    warm: set[tuple[str, Effect | None]] = field(default_factory=set)

    def begin(self, element: str, progress: StudyProgress) -> tuple[Spelling, dict[str, Any]]:
        """Run the scene as it is.

        Returns:
            How choices relative to it are spelled, and its summary.

        Raises:
            StudyError: the run does not come to its end.
        """
        unspelled = Spelling(self.scene, element, first_step=0.0)
        words = unspelled.words(unspelled.start)
        progress.begin(words)
        record = self._make(unspelled, Task(unspelled.start, 1), patience=None)
        progress.end(words, record, made=self.runs.started > 0)
        if not record.done:
            raise StudyError(f"the scene as it is was {record.status}: {record.reason}")
        run = read_run(self.runs.path(unspelled.start.name))
        first_step = self.scene.stepping.first_step or float(run.history["step_size_m"][0])
        return Spelling(self.scene, element, first_step), run.summary

    def go_on(self, wanted: Plan, spelling: Spelling, progress: StudyProgress) -> None:
        """Run everything else, what is on record only where it is to be repeated.

        Repetitions go round all that is timed, so that a machine that is busy for a while is so for all alike.
        """
        dimension = 1 if isinstance(self.scene, LayerScene) else 2
        forecast = Forecast(wanted.start, self.records[wanted.start], dimension)
        rounds = [Task(choice, repeat) for repeat in range(1, self.repeats + 1) for choice in wanted.timed]
        left = [*rounds[1 : len(wanted.timed)], *(Task(it, 0) for it in wanted.untimed), *rounds[len(wanted.timed) :]]
        progress.plan(left, forecast)
        for task in left:
            words = spelling.words(task.choice)
            progress.begin(words)
            before = self.runs.started
            record = self._make(spelling, task, patience=forecast.patience(task.choice))
            forecast.learn(task, record)
            progress.end(words, record, made=self.runs.started > before or (not record.done and task.repeat < 2))

    def _make(self, spelling: Spelling, task: Task, *, patience: float | None) -> Record:
        """Make one run and measure it; what its kind has to compile is compiled before it is timed."""
        choice, timed = task.choice, task.repeat > 0
        kind = choice.element, choice.without
        if timed and kind not in self.warm and not self.runs.is_on_record(choice.name):
            self.runs.warm_up(spelling.settings(choice))
            self.warm.add(kind)
        settings = spelling.settings(choice)
        record = self.runs.run(choice.name, settings, repeats=max(1, task.repeat), timed=timed, patience=patience)
        self.records[choice] = record
        if record.done and choice not in self.measured:
            self.measured[choice] = measure(read_run(self.runs.path(choice.name)), self.scene)
        return record


def study(
    file: Path,
    out: Path,
    *,
    repeats: int,
    overrides: Sequence[str] = (),
    quick: bool = False,
    console: Console | None = None,
) -> Assessment:
    """Study a scene and write its folder: ``study.json``, ``study.md``, ``figures/`` and the runs.

    What is there of an earlier call is not made again. It runs in one process, with the runs as its children.

    Args:
        file: of the scene.
        out: the study's folder.
        repeats: how often a run is timed, unless it is a long one.
        overrides: keys of the scene, "key.path=value" each.
        quick: whether to try little, and coarsely.
        console: where progress goes; silence by default.

    Raises:
        SceneError: there is no such scene, or nothing of it can be compared.
        OutputError: the folder holds something else, or cannot be written.
        StudyError: the scene as it is does not run to its end.
    """
    console = console or Console(quiet=True)
    scene = load_scene(file, overrides)
    if isinstance(scene, LayerScene) and scene.accuracy is not None:
        allowed = "must be left out of a study, which varies what it would choose"
        raise SceneError(line("accuracy", scene.accuracy, allowed))
    element, compared = element_of(scene), quantities(scene)
    folder = StudyFolder(out)
    described = json.loads(json.dumps(scene.as_dict()))
    folder.check(described)
    lock = FolderLock(out)
    lock.acquire()
    head = {"title": scene.title, "scene": described, "quick": quick, "repeats": repeats}
    try:
        folder.write({"status": "running", "reason": None, **head})
        folder.runs.mkdir(exist_ok=True)
        runs = Runs(folder.runs, file, overrides, plane=isinstance(scene, PlaneScene))
        state = _Study(scene, runs, compared, repeats)
        with _ended_by_signals(), StudyProgress(console) as progress:
            spelling, summary = state.begin(element, progress)
            wanted = plan(scene, spelling.start, effects_of(summary), sizes_for(scene, quick=quick))
            state.go_on(wanted, spelling, progress)
        found = Assessment(wanted, compared, state.records, state.measured, left_out=left_out(scene))
        Report(found, spelling, head | {"versions": summary["versions"]}).write(folder)
    except (StudyError, KeyboardInterrupt) as error:
        folder.write({"status": "stopped", "reason": str(error) or "interrupted", **head})
        raise
    except OSError as error:
        raise OutputError(f"output folder {out}: cannot be written: {error.strerror or error}") from error
    finally:
        lock.release()
    return found


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Take a request to end like one from the keyboard, so that no run is left behind."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
