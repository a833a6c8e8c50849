"""Whether a long run stays as it is: memory, open files, PETSc's objects and speed over ten thousand small steps.

Shears a layer to and fro, a thousand steps a cycle, so that every thousand has the same work to do, and squeezes and
stretches a small specimen in the same way. Rows, profiles, fields and checkpoints are written as in any run. Writes
`soak.json`, `tables.md` and `soak.png`; docs/reliability.md shows them. Runs serially, in a few minutes, and ends with
status 1 where a bound is not kept.

    python benchmarks/soak.py --out runs/soak
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import soaking
from soaking import Soaked

from cosserat_fx.output.page import GUIDE, figure
from cosserat_fx.typing import Array

GROWTH = 0.01
"""Largest growth of the resident memory from the end of the first cycle on."""
SLOWING = 0.05
"""Largest growth of the processor time of a step, over that of a fixed piece of work, from first to last cycle."""

UNDISTURBED = 0.05
"""Share of the steps by which the time of all is judged."""


@dataclass(frozen=True)
class Verdict:
    """What a run came to.

    Attributes:
        steps: made.
        cycle: steps of the first one.
        iterations: of most steps.
        first, last: processor time of a step in the first and in the last cycle (s), of steps with so many iterations:
            the time that one step in twenty stays below, which other programs on the machine disturb least.
        first_work, last_work: the same of a fixed piece of work that was timed after every step (s).
        growth: of the resident memory from the end of the first cycle on, relative.
        resident: at the end (bytes).
        handles: least and most open files from there on.
        objects: least and most of PETSc's objects from there on.
    """

    steps: int
    cycle: int
    iterations: int
    first: float
    last: float
    first_work: float
    last_work: float
    growth: float
    resident: int
    handles: tuple[int, int]
    objects: tuple[int, int]

    @property
    def slowing(self) -> float:
        """Growth of the processor time of a step over that of the fixed piece of work, relative."""
        return self.last / self.first * self.first_work / self.last_work - 1

    @property
    def kept(self) -> bool:
        """Whether every bound is kept."""
        constant = self.handles[0] == self.handles[1] and self.objects[0] == self.objects[1]
        return constant and self.growth < GROWTH and self.slowing < SLOWING


def judge(seen: Soaked, cycle: int) -> Verdict:
    """The verdict on a run of cycles of so many steps."""
    settled = seen.step.index(cycle)
    objects = [sum(kinds.values()) for kinds in seen.petsc[settled:]]
    handles, resident = seen.handles[settled:], seen.resident[settled:]
    iterations, seconds = np.array(seen.iterations), np.array(seen.seconds)
    usual = int(np.bincount(iterations).argmax())

    def time(times: Array, part: slice) -> float:
        return float(np.quantile(times[part][iterations[part] == usual], UNDISTURBED))

    first, last, work = slice(0, cycle), slice(-cycle, None), np.array(seen.reference)

    return Verdict(
        steps=len(seconds),
        cycle=cycle,
        iterations=usual,
        first=time(seconds, first),
        last=time(seconds, last),
        first_work=time(work, first),
        last_work=time(work, last),
        growth=max(resident) / resident[0] - 1,
        resident=resident[-1],
        handles=(min(handles), max(handles)),
        objects=(min(objects), max(objects)),
    )


def table(verdicts: Mapping[str, Verdict]) -> str:
    """The verdicts in Markdown."""
    lines = [
        "| run | steps | resident memory | its growth | open files | PETSc's objects "
        "| iterations of most steps | ms for such a step in the first cycle | in the last cycle "
        "| change, over that of a fixed piece of work |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, it in verdicts.items():
        handles, objects = (" to ".join(dict.fromkeys(map(str, ends))) for ends in (it.handles, it.objects))
        lines.append(
            f"| {name} | {it.steps} | {it.resident / 1e6:.0f} MB | {100 * it.growth:+.2f} % | {handles} | {objects} "
            f"| {it.iterations} | {1e3 * it.first:.2f} | {1e3 * it.last:.2f} | {100 * it.slowing:+.1f} % |"
        )
    return "\n".join(lines) + "\n"


def draw(runs: Mapping[str, Soaked], verdicts: Mapping[str, Verdict], file: Path) -> None:
    """Memory over that at the end of the first cycle, and time of a step over that of a fixed piece of work."""
    with figure(file, 11.0) as sheet:
        memory, time = sheet.subplots(2, 1, sharex=True)
        for name, seen in runs.items():
            cycle = verdicts[name].cycle
            resident = np.array(seen.resident)
            memory.plot(seen.step, 100 * (resident / resident[seen.step.index(cycle)] - 1), label=name)
            size = cycle // 10
            count = len(seen.seconds) // size
            seconds = np.quantile(np.reshape(seen.seconds[: count * size], (count, size)), UNDISTURBED, axis=1)
            work = np.quantile(np.reshape(seen.reference[: count * size], (count, size)), UNDISTURBED, axis=1)
            time.plot(size * (np.arange(count) + 0.5), seconds / work, label=name)
        memory.axhline(100 * GROWTH, **GUIDE)
        memory.set(ylabel="growth of the memory (%)", ylim=(-1.5, 1.5))
        time.set(xlabel="step", ylabel="time of a step / of fixed work", ylim=(0, None))
        memory.legend()


def main(
    out: Annotated[Path, typer.Option(help="Where the results go.")] = Path("runs/soak"),
    cycle: Annotated[int, typer.Option(help="Steps of a cycle of the layer; the specimen's has half.")] = 1000,
    cycles: Annotated[int, typer.Option(help="How many of them.")] = 10,
) -> None:
    """Soak both bodies."""
    out.mkdir(parents=True, exist_ok=True)
    lengths = {"layer": cycle, "plane": cycle // 2}
    runs = {
        name: soaking.soak(getattr(soaking, name)(length, cycles), out / name, length // 10)
        for name, length in lengths.items()
    }
    verdicts = {name: judge(seen, lengths[name]) for name, seen in runs.items()}
    (out / "soak.json").write_text(json.dumps({name: asdict(it) for name, it in verdicts.items()}, indent=2) + "\n")
    (out / "tables.md").write_text(table(verdicts))
    draw(runs, verdicts, out / "soak.png")
    print(table(verdicts))
    for name, seen in runs.items():
        print(f"{name}: {seen.answer}")
    raise typer.Exit(0 if all(it.kept for it in verdicts.values()) else 1)


if __name__ == "__main__":
    typer.run(main)
