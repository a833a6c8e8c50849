"""What a run writes down as it goes on: rows, summary and figures, with totals, warnings and audits of the whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from time import perf_counter
from typing import Any, Self

from cosserat_fx.accuracy.report import AccuracyReport
from cosserat_fx.answer.report import Answer
from cosserat_fx.audit import Audit
from cosserat_fx.bodies import Body
from cosserat_fx.effects import effects
from cosserat_fx.hypoplasticity import REASONS, Status
from cosserat_fx.kernel_time import kernel_shares
from cosserat_fx.output.layer_observation import looseness
from cosserat_fx.output.recording import Recording
from cosserat_fx.parallel import on_first_rank
from cosserat_fx.results import FORMAT, RunFolder, read_run
from cosserat_fx.stepping import Step
from cosserat_fx.timing import Stopwatch
from cosserat_fx.versions import versions


@dataclass
class Ledger:
    """What a run has come to so far.

    Attributes:
        steps, iterations, cutbacks, passages, jumps: totals.
        reason: why it stopped early, if it did.
        warnings: what the user should know.
        resumed: after which steps the run went on from a checkpoint.
        answer: the checks of the answer in one line; empty before the end.
        accuracy: the estimated error in one line; empty before the end and where no accuracy was asked for.
    """

    steps: int = 0
    iterations: int = 0
    cutbacks: int = 0
    passages: int = 0
    jumps: int = 0
    reason: str | None = None
    warnings: list[str] = field(default_factory=list)
    resumed: list[int] = field(default_factory=list)
    answer: str = ""
    accuracy: str = ""

    @classmethod
    def of(cls, summary: Mapping[str, Any]) -> Self:
        """What a run came to that is done.

        Args:
            summary: its ``run.json``.
        """
        return cls(
            steps=summary["steps"],
            iterations=summary["newton_iterations"],
            cutbacks=summary["cutbacks"],
            passages=summary["branch_passages"],
            jumps=summary["jumps"],
            warnings=summary["warnings"],
            resumed=summary["resumed_after_steps"],
        )


class Recorder:
    """Writes what a run's folder holds as the run goes on."""

    def __init__(self, body: Body, recording: Recording, folder: RunFolder, start: float, scene_digest: str) -> None:
        """Prepare to observe.

        Args:
            body: what is run.
            recording: what its kind shows.
            folder: the run's folder.
            start: when the run began, by ``perf_counter`` (s).
            scene_digest: of what may not change while the run goes on.
        """
        self.ledger = Ledger(warnings=list(body.warnings))
        self._start, self._digest = start, scene_digest
        self._body, self._problem, self._scene = body, body.problem, body.scene
        self._audit, self._answer, self._accuracy = Audit(body), Answer(body), AccuracyReport(body)
        self._recording, self._folder = recording, folder
        self._comm = body.problem.comm
        self._loose = False
        self.effects = kernel_shares(effects(body), body)

    def start(self) -> None:
        """Write the initial state."""
        self._recording.start(self._folder)

    def memento(self) -> dict[str, Any]:
        """What has to be remembered to go on after the last row, of types that JSON knows; read on rank 0."""
        stopwatch = self._problem.stopwatch
        return {
            "ledger": asdict(self.ledger),
            "loose": self._loose,
            "seconds": dict(stopwatch.seconds) | {"whole run": perf_counter() - self._start},
            "calls": dict(stopwatch.calls),
            "recording": self._recording.memento(),
            "audit": self._audit.memento(),
            "answer": self._answer.memento(),
            "accuracy": self._accuracy.memento(),
        }

    def resume(self, memento: dict[str, Any], complaints: list[str]) -> None:
        """Go on from a checkpoint, instead of :meth:`start`.

        Args:
            memento: what :meth:`memento` gave.
            complaints: what was wrong with a newer checkpoint.
        """
        self.ledger = Ledger(**memento["ledger"])
        self.ledger.reason = None
        self.ledger.resumed.append(self.ledger.steps)
        self.ledger.warnings += [f"{it}; the run went on from the checkpoint before" for it in complaints]
        self._loose = memento["loose"]
        self._start -= memento["seconds"].pop("whole run")
        self._problem.stopwatch.add(memento["seconds"], memento["calls"])
        self._audit.restore(memento["audit"])
        self._answer.restore(memento["answer"])
        self._accuracy.restore(memento["accuracy"])
        self._recording.resume(self._folder, memento["recording"])

    def record(self, step: Step) -> None:
        """Write an accepted step: its row, and what else its kind of body shows."""
        with self._problem.stopwatch("output"):
            row = self._recording.row(step)
            ledger = self.ledger
            ledger.steps, ledger.iterations = step.number, ledger.iterations + step.iterations
            ledger.cutbacks += step.cutbacks
            ledger.passages += step.passages
            ledger.jumps += step.jumps
            self._audit.observe(row)
            self._answer.observe(step)
            self._accuracy.observe(step)
            on_first_rank(self._comm, lambda: self._folder.append_history(row))
            self._watch_looseness(step)
            self._tell_passage(step)
            self._tell_first_jump(step)
            for note in self._body.stepper.solver.linear.notes:
                self.warn_once(note)
            self._recording.record(step)

    @property
    def stopwatch(self) -> Stopwatch:
        """That of the problem."""
        return self._problem.stopwatch

    def warn_once(self, warning: str) -> None:
        """Add a warning unless it was given before."""
        if warning not in self.ledger.warnings:
            self.ledger.warnings.append(warning)

    def finish(self) -> None:
        """Write the summary and draw the figures."""
        if self.ledger.steps:
            self._recording.finish()
            self._answer.check()
            self.ledger.answer = self._answer.line()
        if self._accuracy.wanted and self.ledger.reason is None:
            self._accuracy.finish(on_first_rank(self._comm, lambda: read_run(self._folder.path).history))
            self.ledger.accuracy = self._accuracy.line()
        self.ledger.warnings += [*self._audit.warnings(self._recording.entries()), *self._answer.warnings()]
        self.ledger.warnings += self._accuracy.warnings()
        if self._scene.output.figures and self.ledger.steps:
            self.summarise("running")
            with self._problem.stopwatch("figures"):
                on_first_rank(self._comm, self._draw)
        self.summarise("done" if self.ledger.reason is None else "stopped")

    def _draw(self) -> None:
        """Draw the figures; matplotlib, slow to load and large, is loaded where and when it is needed."""
        from cosserat_fx.plots import draw_all

        draw_all(self._folder.path)

    def summarise(self, status: str) -> None:
        """Write run.json, on rank 0, which needs no other rank for it."""
        on_first_rank(self._comm, lambda: self._folder.write_summary(self._summary(status)))

    def _summary(self, status: str) -> dict[str, Any]:
        problem, scene, ledger, sizes = self._problem, self._scene, self.ledger, self._body.element_sizes
        phases = problem.stopwatch.seconds | {"whole run": perf_counter() - self._start}
        return {
            "format": FORMAT,
            "status": status,
            "reason": ledger.reason,
            "title": scene.title,
            "versions": versions(),
            "ranks": self._comm.size,
            "scene": scene.as_dict(),
            "scene_sha256": self._digest,
            "resumed_after_steps": ledger.resumed,
            "effects": [asdict(effect) for effect in self.effects],
            "linear_solver": asdict(self._body.stepper.solver.linear.choice),
            "sizes": problem.sizes,
            "element_size_d50": {name: getattr(sizes, name) for name in ("smallest", "median", "largest")},
            "steps": ledger.steps,
            "newton_iterations": ledger.iterations,
            "cutbacks": ledger.cutbacks,
            "branch_passages": ledger.passages,
            "jumps": ledger.jumps,
            "seconds": {name: round(seconds, 6) for name, seconds in sorted(phases.items())},
            "calls": dict(sorted(problem.stopwatch.calls.items())),
            "warnings": ledger.warnings,
            "answer": self._answer.entries(),
            **self._accuracy.entries(),
            **self._recording.entries(),
        }

    def _watch_looseness(self, step: Step) -> None:
        """Warn once, where and from when the void ratio exceeds e_i."""
        loose = None if self._loose else looseness(self._problem)
        if loose is None:
            return
        self._loose = True
        self.ledger.warnings.append(
            f"{REASONS[Status.LOOSER_THAN_E_I]}, at {loose.count} point(s) from a travel of "
            f"{self._recording.travel(step):.6g} m on, first at {loose.place}"
        )

    def _tell_passage(self, step: Step) -> None:
        """Tell where a branch of equilibria became unstable, and what was done."""
        if step.passages:
            done = "followed on" if self._body.stepper.control.branch == "primary" else "left for a stable one"
            self.ledger.warnings.append(
                f"at a travel of {self._recording.travel(step):.6g} m the branch of equilibria had become unstable "
                f"and was {done}"
            )

    def _tell_first_jump(self, step: Step) -> None:
        """Tell where the body first moved to another equilibrium; there may be hundreds of such steps."""
        if step.jumps and self.ledger.jumps == step.jumps:
            self.ledger.warnings.append(
                f"at a travel of {self._recording.travel(step):.6g} m there was no equilibrium near the last one, and "
                "the body was let move to another; history.csv marks every such step under jumps"
            )
