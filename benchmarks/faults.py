"""Kills runs at random moments and lets them go on: what is lost? docs/reliability.md shows the result.

Runs the demos' layer and biaxial test on one and two ranks, sends SIGKILL at a moment drawn over the life of an
undisturbed run or over the rows to come, starts the run again with --resume, perhaps to be killed again, and compares
what it has left when it is done with what the undisturbed run has left. Writes `kills.csv` and `tables.md`.

    python benchmarks/faults.py --out runs/faults
"""

from __future__ import annotations

import csv
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from cosserat_fx.checkpoints.file import CheckpointError, read_header
from cosserat_fx.results import Run, RunFolder, read_run

DEMOS = Path(__file__).resolve().parents[1] / "demos"
ROUNDING = 1e-10
"""Difference allowed where undisturbed runs differ too."""
PHASES = ("start-up", "set-up", "steps", "checkpoint", "end")
"""Before the run has its folder, before its first row, between rows, while a checkpoint is written, after all rows."""


@dataclass(frozen=True)
class Case:
    """What is run.

    Attributes:
        scene: a demo.
        ranks: processes.
        keys: of the scene that are replaced.
        share: of all kills.
    """

    scene: str
    ranks: int
    keys: tuple[str, ...]
    share: float

    def command(self, folder: Path) -> list[str]:
        """The run's command line."""
        beside = Path(sys.executable).with_name("mpiexec")
        launcher = [str(beside) if beside.exists() else "mpiexec", "-n", str(self.ranks)] if self.ranks > 1 else []
        program = [sys.executable, "-c", "from cosserat_fx.cli import main; main()"]
        keys = [argument for key in self.keys for argument in ("--set", key)]
        scene = str(DEMOS / f"{self.scene}.toml")
        return [*launcher, *program, "run", scene, *keys, "--out", str(folder), "--resume"]


MANY_STEPS = ("geometry.cells=160", "stepping.max_step=1e-4", "output.checkpoints=0")
"""Three hundred steps, and a checkpoint after each of them."""
CASES = (
    Case("layer_medium_rough", 1, MANY_STEPS, 0.36),
    Case("layer_medium_rough", 2, MANY_STEPS, 0.24),
    Case("biaxial", 1, (), 0.2),
    Case("biaxial", 2, (), 0.2),
)


@dataclass(frozen=True)
class Kill:
    """One kill.

    Attributes:
        scene, ranks: of the case.
        whom: all processes, or one rank, after which the launcher ends the others.
        moment: after the start of the process (s).
        phase: that was hit.
        rows: in the history then.
        after: step after which the next process went on; 0 where it began again.
    """

    scene: str
    ranks: int
    whom: str
    moment: float
    phase: str
    rows: int
    after: int

    @property
    def again(self) -> int:
        """Steps that were computed once more."""
        return self.rows - self.after


@dataclass(frozen=True)
class Finding:
    """What a run has left that was killed and went on.

    Attributes:
        kills: that it went through.
        missing, doubled: rows of the history.
        difference: largest one of any column, relative to its largest value; 0 where all numbers are the same.
        complete: whether run.json says so, and fields and figures are there and nothing else.
    """

    kills: int
    missing: int
    doubled: int
    difference: float
    complete: bool


class Trial:
    """Kills runs of one case."""

    def __init__(self, case: Case, out: Path, dice: random.Random) -> None:
        """Make the undisturbed run, twice, as two runs on several ranks may differ by rounding.

        Args:
            case: what is run.
            out: folder for the runs.
            dice: draws moments.
        """
        self.case, self._dice, self._folder = case, dice, out / f"{case.scene}_{case.ranks}_killed"
        self._undisturbed = out / f"{case.scene}_{case.ranks}"
        for folder in (self._folder, self._undisturbed):
            shutil.rmtree(folder, ignore_errors=True)
        subprocess.run(case.command(self._folder), stdout=subprocess.DEVNULL, check=True)
        start = time.perf_counter()
        subprocess.run(case.command(self._undisturbed), stdout=subprocess.DEVNULL, check=True)
        self._life = time.perf_counter() - start
        self.spread = _difference(read_run(self._undisturbed), read_run(self._folder))
        shutil.rmtree(self._folder)
        self.kills: list[Kill] = []
        self.findings: list[Finding] = []

    def go(self, kills: int) -> None:
        """Kill so many times, beginning a new run whenever one is done, and let the last one come to its end."""
        for _ in range(kills):
            while not self._kill():
                self._look()
        subprocess.run(self.case.command(self._folder), stdout=subprocess.DEVNULL, check=True)
        self._look()

    @property
    def has_lost(self) -> bool:
        """Whether anything of any run was lost or changed."""
        allowed = ROUNDING if self.spread else 0.0
        return any(it.difference > allowed or it.missing or it.doubled or not it.complete for it in self.findings)

    def _kill(self) -> bool:
        """Start the run, or let it go on, and kill it; False where it was done before."""
        command, quiet, start = self.case.command(self._folder), subprocess.DEVNULL, time.perf_counter()
        alone = self.case.ranks > 1 and self._dice.random() < 0.5
        with subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True) as process:
            self._await_moment(process)
            if process.poll() is not None:
                return False
            moment = time.perf_counter() - start
            family = [process.pid, *_descendants(process.pid)]
            ranks = [one for one in family if one != process.pid and not _children(one)] or family
            for victim in [self._dice.choice(ranks)] if alone else family:
                with suppress(ProcessLookupError):
                    os.kill(victim, signal.SIGKILL)
            process.wait()
        while any(map(_lives, family)):
            time.sleep(0.01)
        rows, whom = _rows(self._folder), "one rank" if alone else "all"
        phase, after = self._phase(rows), _after(self._folder)
        self.kills.append(Kill(self.case.scene, self.case.ranks, whom, round(moment, 3), phase, rows, after))
        return True

    def _await_moment(self, process: subprocess.Popen[bytes]) -> None:
        """Wait for a random time, or for a random row and a little longer, or until the run is done."""
        there, all_rows = _rows(self._folder), _rows(self._undisturbed)
        wait = self._dice.uniform(0.0, self._life)
        if there < all_rows and self._dice.random() < 0.5:
            row, wait = self._dice.randint(there + 1, all_rows), self._dice.uniform(0.0, self._life / all_rows)
            while process.poll() is None and _rows(self._folder) < row:
                time.sleep(0.002)
        with suppress(subprocess.TimeoutExpired):
            process.wait(wait)

    def _phase(self, rows: int) -> str:
        """What a run was doing that left its folder like this."""
        if not self._folder.exists():
            return "start-up"
        if (self._folder / "checkpoint.part").exists():
            return "checkpoint"
        if not rows:
            return "set-up"
        return "end" if rows == _rows(self._undisturbed) else "steps"

    def _look(self) -> None:
        """Compare a run that is done with the undisturbed one, and remove it."""
        killed, undisturbed = read_run(self._folder), read_run(self._undisturbed)
        steps, counts = undisturbed.history["step"], Counter(killed.history["step"].tolist())
        before = sum(finding.kills for finding in self.findings)
        self.findings.append(
            Finding(
                kills=len(self.kills) - before,
                missing=int(np.setdiff1d(steps, killed.history["step"]).size),
                doubled=sum(count - 1 for count in counts.values()),
                difference=_difference(undisturbed, killed),
                complete=killed.summary["status"] == "done" and _names(killed) == _names(undisturbed),
            )
        )
        shutil.rmtree(self._folder)


def _difference(one: Run, other: Run) -> float:
    """The largest difference of any column of two runs' tables, relative to its largest value."""
    largest = 0.0
    for table, there in ((one.history, other.history), (one.profiles, other.profiles)):
        for name, column in table.items():
            if column.shape != there[name].shape:
                return float("inf")
            apart = np.max(np.abs(column - there[name]), initial=0.0)
            largest = max(largest, apart / np.max(np.abs(column)) if apart else 0.0)
    return float(largest)


def _names(run: Run) -> set[str]:
    """All files of a run, those with something in them."""
    return {str(file.relative_to(run.path)) for file in run.path.rglob("*") if file.stat().st_size}


def _rows(folder: Path) -> int:
    history = folder / "history.csv"
    return max(history.read_text().count("\n") - 1, 0) if history.exists() else 0


def _after(folder: Path) -> int:
    """The step after which a run would go on; 0 where it would begin again."""
    there = RunFolder(folder)
    if there.summary.exists() and (run := read_run(folder)).summary["status"] == "done":
        return run.history["step"].size
    for file in (there.checkpoint, there.previous_checkpoint):
        with suppress(CheckpointError):
            return int(read_header(file)[0]["walk"]["number"])
    return 0


def _children(process: int) -> list[int]:
    with suppress(OSError):
        return [int(it) for it in Path(f"/proc/{process}/task/{process}/children").read_text().split()]
    return []


def _descendants(process: int) -> Iterator[int]:
    for child in _children(process):
        yield child
        yield from _descendants(child)


def _lives(process: int) -> bool:
    """Whether a process is there and no zombie."""
    with suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(") ")[2][0] != "Z"
    return False


def tables(trials: Sequence[Trial]) -> str:
    """All kills and what became of the runs, as Markdown."""
    lines = [
        f"| scene | ranks | kills | {' | '.join(PHASES)} | steps computed again, mean (most) |",
        f"|---|--:|--:|{'--:|' * len(PHASES)}--:|",
    ]
    for trial in trials:
        hits, again = Counter(kill.phase for kill in trial.kills), [kill.again for kill in trial.kills]
        counts = " | ".join(str(hits[phase]) for phase in PHASES)
        redone = f"{np.mean(again):.1f} ({max(again)})"
        lines.append(f"| {trial.case.scene} | {trial.case.ranks} | {len(again)} | {counts} | {redone} |")
    headings = (
        "scene",
        "ranks",
        "runs",
        "rows lost",
        "rows doubled",
        "incomplete",
        "difference",
        "of undisturbed runs",
    )
    lines += ["", f"| {' | '.join(headings)} |", f"|---|{'--:|' * (len(headings) - 1)}"]
    for trial in trials:
        found = trial.findings
        missing, doubled = sum(it.missing for it in found), sum(it.doubled for it in found)
        incomplete, apart = sum(not it.complete for it in found), max(it.difference for it in found)
        differences = [f"{it:.0e}" if it else "0" for it in (apart, trial.spread)]
        cells = (trial.case.scene, trial.case.ranks, len(found), missing, doubled, incomplete, *differences)
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


def main(
    out: Annotated[Path, typer.Option(help="Folder for runs and tables.")] = Path("runs/faults"),
    kills: Annotated[int, typer.Option(min=len(CASES), help="How many in all.")] = 50,
    seed: Annotated[int, typer.Option(help="Of the moments.")] = 1,
) -> None:
    """Kills runs at random moments and looks at what is lost."""
    console, dice = Console(soft_wrap=True), random.Random(seed)
    out.mkdir(parents=True, exist_ok=True)
    trials = []
    for case in CASES:
        trials.append(Trial(case, out, dice))
        trials[-1].go(round(case.share * kills))
        console.print(tables(trials[-1:]), highlight=False)
    with (out / "kills.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, [it.name for it in fields(Kill)])
        writer.writeheader()
        writer.writerows(asdict(kill) for trial in trials for kill in trial.kills)
    (out / "tables.md").write_text(tables(trials), encoding="utf-8")
    console.print(tables(trials), highlight=False)
    raise typer.Exit(int(any(trial.has_lost for trial in trials)))


if __name__ == "__main__":
    typer.run(main)
