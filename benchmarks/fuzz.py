"""Input that nobody should give, in numbers: what is refused, what is accepted, and what is lost (which must be none).

Cases are those of the tests (tests/fuzz_mutations.py), more of them and with another seed: 6,000 in a few minutes. One
that is lost is printed with its traceback, and its files are kept for a look.

    python benchmarks/fuzz.py
    python benchmarks/fuzz.py --cases 20000 --seed 1
"""

from __future__ import annotations

import collections
import resource
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import fuzzing
from fuzz_bases import Case, field_cases, mesh_cases
from fuzz_mutations import file_cases, scene_cases

COMMAND_LINE = 20
"""One case in so many, where it is refused, goes through the command line as well."""
COMPILED = 5
"""With one valid case in so many all is done that the command check does, its forms compiled."""


class Tally:
    """Counts of what became of the cases of one kind."""

    def __init__(self, name: str, keep: Path) -> None:
        """Start with none."""
        self.name, self.keep = name, keep
        self.counts: collections.Counter[str] = collections.Counter()
        self.lost: collections.Counter[str] = collections.Counter()
        self.slowest = 0.0

    def judge(self, case: Case) -> None:
        """Judge a case, and count it."""
        number = self.counts["cases"]
        self.counts["cases"] += 1
        start = time.perf_counter()
        try:
            message = fuzzing.refusal(case, compiling=self.counts["accepted"] % COMPILED == 0)
            if message and number % COMMAND_LINE == 0:
                self.counts["command line"] += 1
                fuzzing.assert_same_on_command_line(case, message)
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            self._report(case, error)
        else:
            self.counts["refused" if message else "accepted"] += 1
        self.slowest = max(self.slowest, time.perf_counter() - start)

    def _report(self, case: Case, error: BaseException) -> None:
        """Print what a case was lost by, once, and keep its files."""
        self.counts["lost"] += 1
        at = traceback.extract_tb(error.__traceback__)[-1]
        told = str(error)[:60] if isinstance(error, AssertionError) else ""
        label = f"{type(error).__name__} in {Path(at.filename).name}:{at.lineno} {told!r}"
        self.lost[label] += 1
        if self.lost[label] > 1:
            return
        folder = self.keep / f"{self.name}-{len(self.lost)}".replace(" ", "-")
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in case.files.items():
            (folder / name).write_bytes(content)
        print(f"lost: {label}, kept in {folder}, overrides {case.overrides!r:.300}", file=sys.stderr)
        traceback.print_exception(error, limit=-6, file=sys.stderr)


def campaign(name: str, cases: st.SearchStrategy[Case], count: int, start: int, keep: Path) -> Tally:
    """Judge so many cases of a kind."""
    tally = Tally(name, keep)

    @seed(start)
    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=cases)
    def walk(case: Case) -> None:
        tally.judge(case)

    run: Callable[[], None] = walk
    run()
    return tally


def main(
    cases: Annotated[int, typer.Option(help="How many to try.")] = 6000,
    start: Annotated[int, typer.Option("--seed", help="Another seed is other cases.")] = 0,
    out: Annotated[Path, typer.Option(help="Folder for the table, and for the files of lost cases.")] = Path(
        "runs/fuzz"
    ),
) -> None:
    """Runs the campaign, prints a table, and fails where anything is lost."""
    began = time.perf_counter()
    kinds = {
        "scenes": (scene_cases(), 5),
        "mesh files": (file_cases(mesh_cases()), 4),
        "void ratios": (file_cases(field_cases()), 1),
    }
    tallies = [
        campaign(name, kind, cases * tenths // 10, start, out / "lost") for name, (kind, tenths) in kinds.items()
    ]
    table = [
        "| input | cases | refused | accepted | also by command line | slowest (s) | lost |",
        "|---|---|---|---|---|---|---|",
    ]
    for tally in tallies:
        counts = [tally.counts[it] for it in ("cases", "refused", "accepted", "command line")]
        entries = [tally.name, *counts, f"{tally.slowest:.1f}", tally.counts["lost"] or "none"]
        table.append(f"| {' | '.join(map(str, entries))} |")
    print("\n".join(table))
    out.mkdir(parents=True, exist_ok=True)
    (out / "tables.md").write_text("\n".join([*table, ""]))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(f"{time.perf_counter() - began:.0f} s, at most {peak / 1e9:.2f} GB")
    raise typer.Exit(int(any(tally.counts["lost"] for tally in tallies)))


if __name__ == "__main__":
    typer.run(main)
