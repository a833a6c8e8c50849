"""What a run writes down as it goes on: rows, summary and figures, with the totals, warnings and audits of the whole."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from time import perf_counter
from typing import Any

from cosserat_fx.audit import Audit
from cosserat_fx.bodies import Body
from cosserat_fx.effects import effects
from cosserat_fx.hypoplasticity import REASONS, Status
from cosserat_fx.kernel_time import kernel_shares
from cosserat_fx.output.layer_observation import looseness
from cosserat_fx.output.recording import Recording
from cosserat_fx.parallel import on_first_rank
from cosserat_fx.plots import draw_all
from cosserat_fx.results import FORMAT, RunFolder
from cosserat_fx.stepping import Step
from cosserat_fx.versions import versions


@dataclass
class Ledger:
    """What a run has come to so far.

    Attributes:
        steps, iterations, cutbacks, passages: totals.
        reason: why it stopped early, if it did.
        warnings: what the user should know.
    """

    steps: int = 0
    iterations: int = 0
    cutbacks: int = 0
    passages: int = 0
    reason: str | None = None
    warnings: list[str] = field(default_factory=list)


class Recorder:
    """Writes what a run's folder holds as the run goes on."""

    def __init__(self, body: Body, recording: Recording, folder: RunFolder, start: float) -> None:
        """Prepare to observe.

        Args:
            body: what is run.
            recording: what its kind shows.
            folder: the run's folder, just created.
            start: when the run began, by ``perf_counter`` (s).
        """
        self.ledger = Ledger(warnings=list(body.warnings))
        self._start = start
        self._body, self._problem, self._scene = body, body.problem, body.scene
        self._audit = Audit(body)
        self._recording, self._folder = recording, folder
        self._comm = body.problem.comm
        self._loose = False
        self.effects = kernel_shares(effects(body), body, compiling=False)

    def start(self) -> None:
        """Write the initial state."""
        self._recording.start(self._folder)

    def record(self, step: Step) -> None:
        """Write an accepted step: its row, and what else its kind of body shows."""
        with self._problem.stopwatch("output"):
            row = self._recording.row(step)
            ledger = self.ledger
            ledger.steps, ledger.iterations = step.number, ledger.iterations + step.iterations
            ledger.cutbacks += step.cutbacks
            ledger.passages += step.passages
            self._audit.observe(row)
            on_first_rank(self._comm, lambda: self._folder.append_history(row))
            self._watch_looseness(step)
            self._tell_passage(step)
            self._recording.record(step)

    def finish(self) -> None:
        """Write the summary and draw the figures."""
        if self.ledger.steps:
            self._recording.finish()
        self.ledger.warnings += self._audit.warnings(self._recording.entries())
        status = "done" if self.ledger.reason is None else "stopped"
        self.summarise(status)
        if self._scene.output.figures and self.ledger.steps:
            with self._problem.stopwatch("figures"):
                on_first_rank(self._comm, lambda: draw_all(self._folder.path))
            self.summarise(status)

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
            "effects": [asdict(effect) for effect in self.effects],
            "sizes": problem.sizes,
            "element_size_d50": {name: getattr(sizes, name) for name in ("smallest", "median", "largest")},
            "steps": ledger.steps,
            "newton_iterations": ledger.iterations,
            "cutbacks": ledger.cutbacks,
            "branch_passages": ledger.passages,
            "seconds": {name: round(seconds, 6) for name, seconds in sorted(phases.items())},
            "calls": dict(sorted(problem.stopwatch.calls.items())),
            "warnings": ledger.warnings,
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
