"""How accurate the elements of a plane body are for what they cost, in several scenes and on several meshes.

Writes `runs.csv`, `tables.md` and three figures. Runs serially; docs/elements.md shows and discusses the result.

    python benchmarks/element_study.py --out runs/element_study
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import typer
from element_figures import draw_bands, draw_costs, draw_sawtooth
from element_meshes import Pattern
from element_report import Report
from element_runs import CASES, TRIALS, ElementRun, measure
from rich.console import Console

from cosserat_fx.elements import DEFAULT

type Meshes = tuple[str, Pattern, tuple[float, ...]]
"""An element, the pattern of its meshes and the sides of their squares over d50, from coarse to fine."""

EACH: tuple[tuple[str, Pattern], ...] = (
    ("Q1R", "squares"),
    ("Q1", "squares"),
    ("Q2Q1", "squares"),
    ("P1", "rising"),
    ("P2P1", "rising"),
)
"""Every element, triangles with one diagonal."""


@dataclass(frozen=True)
class Studies:
    """Sizes of the measurements.

    Attributes:
        meshes: of each case on which the elements are compared.
        side: of the meshes of the other comparisons, where not said otherwise.
        trial_sides: of the meshes of elements that the program does not offer, for each case in which they are tried.
        repeats: of cheap runs, for the time.
        factors: of the resistance to hourglass modes.
        seeds: of the distorted meshes of the default element.
        hard_cases: names of those to try.
    """

    meshes: Mapping[str, tuple[Meshes, ...]]
    side: float
    trial_sides: Mapping[str, float]
    repeats: int
    factors: tuple[float, ...]
    seeds: tuple[int, ...]
    hard_cases: tuple[str, ...]


FULL = Studies(
    meshes={
        "biaxial": (
            ("Q1R", "squares", (5.0, 2.5, 1.25)),
            ("Q1", "squares", (5.0, 2.5)),
            ("Q2Q1", "squares", (5.0, 2.5)),
            ("P1", "rising", (2.5,)),
            ("P2P1", "rising", (5.0, 2.5)),
            ("P2P1", "falling", (5.0,)),
            ("P2P1", "crossed", (5.0,)),
        ),
        "platens": (
            *((element, pattern, (5.0, 2.5, 1.25, 0.625)) for element, pattern in EACH),
            ("P1", "crossed", (2.5,)),
            ("P2P1", "crossed", (2.5,)),
        ),
        "core": (
            ("Q1R", "squares", (5.0, 2.5, 1.25, 0.625)),
            *((element, pattern, (5.0, 2.5, 1.25)) for element, pattern in EACH[1:]),
            ("P1", "crossed", (2.5,)),
            ("P2P1", "crossed", (2.5,)),
        ),
    },
    side=2.5,
    trial_sides={"biaxial": 5.0, "platens": 2.5, "core": 2.5},
    repeats=3,
    factors=(0.0, 0.0005, 0.005, 0.05, 0.5),
    seeds=(0, 1, 2),
    hard_cases=("platens, 15 %", "shear"),
)
QUICK = Studies(
    meshes={
        "biaxial": (("Q1R", "squares", (10.0, 5.0, 2.5)), ("P2P1", "falling", (5.0,))),
        "platens": (
            ("Q1R", "squares", (10.0, 5.0, 2.5)),
            *((element, pattern, (5.0,)) for element, pattern in EACH[1:]),
        ),
    },
    side=5.0,
    trial_sides={"platens": 5.0},
    repeats=1,
    factors=(0.0, 0.005, 0.5),
    seeds=(0,),
    hard_cases=(),
)


class Bench:
    """Makes runs and remembers them."""

    def __init__(self, studies: Studies, console: Console) -> None:
        """Start with no runs."""
        self.studies, self._console = studies, console
        self.runs: list[ElementRun] = []

    def run(self, study: str, case: str, element: str, pattern: Pattern = "squares", **settings: Any) -> None:
        """Make one run; cheap ones as often as the time asks for.

        Args:
            study, case, element, pattern, settings: as for :func:`measure`.
        """
        cheap = element in ("Q1R", "P1") and settings.get("side", 0.0) >= 2.5
        repeats = self.studies.repeats if cheap and study == "elements" else 1
        run = measure(study, case, element, pattern=pattern, repeats=repeats, **settings)
        self.runs.append(run)
        self._console.print(str(run), highlight=False)

    def compare_elements(self, case: str) -> None:
        """Every element on ever finer meshes, and triangles cut in other ways."""
        for element, pattern, sides in self.studies.meshes[case]:
            for side in sides:
                self.run("elements", case, element, pattern, side=side)

    def try_others(self, case: str) -> None:
        """Elements that the program does not offer."""
        for name, element in TRIALS.items() if case in self.studies.trial_sides else ():
            pattern: Pattern = "rising" if element.cell == "triangle" else "squares"
            self.run("trials", case, name, pattern, side=self.studies.trial_sides[case])

    def distort(self, case: str) -> None:
        """Elements on a mesh whose inner corners were moved: all of them, or the default one of the large case."""
        default = DEFAULT["quadrilateral"]
        for element, pattern in EACH:
            for seed in self.studies.seeds if element == default else self.studies.seeds[:1]:
                if element == default or not CASES[case].band:
                    self.run("distortion", case, element, pattern, side=self.studies.side, distortion=0.25, seed=seed)

    def turn_hourglass_knob(self, case: str) -> None:
        """The resistance to hourglass modes."""
        for factor in self.studies.factors:
            self.run("hourglass", case, "Q1R", side=self.studies.side, hourglass=factor)

    def try_hard_cases(self) -> None:
        """Every element where convergence is not a matter of course."""
        for case in self.studies.hard_cases:
            for element, pattern in EACH:
                self.run("hard case", case, element, pattern, side=self.studies.side)


def _write_csv(file: Path, runs: list[ElementRun]) -> None:
    names = [field.name for field in fields(ElementRun) if field.repr]
    with file.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(asdict(run) for run in runs)


def main(
    out: Annotated[Path, typer.Option(help="Folder for tables and figures.")] = Path("runs/element_study"),
    quick: Annotated[bool, typer.Option("--quick", help="Few and coarse runs, to see that it works.")] = False,
) -> None:
    """Measures the accuracy of the elements against their cost."""
    console = Console(soft_wrap=True)
    bench = Bench(QUICK if quick else FULL, console)
    out.mkdir(parents=True, exist_ok=True)
    for element, pattern in EACH:
        measure("warm-up", "platens", element, pattern=pattern, side=5.0)
    for case in bench.studies.meshes:
        bench.compare_elements(case)
    for case in bench.studies.meshes:
        bench.try_others(case)
        bench.distort(case)
        bench.turn_hourglass_knob(case)
    bench.try_hard_cases()
    report = Report(bench.runs, side=bench.studies.side)
    _write_csv(out / "runs.csv", bench.runs)
    mode = "`--quick`: coarse meshes, references far from converged" if quick else "the full study"
    (out / "tables.md").write_text(f"Made by {mode}.\n\n{report.tables()}", encoding="utf-8")
    draw_costs(report, out / "elements_cost.png")
    draw_bands(report, out / "elements_bands.png")
    draw_sawtooth(report, out / "elements_sawtooth.png")
    console.print(report.tables(), highlight=False)


if __name__ == "__main__":
    typer.run(main)
