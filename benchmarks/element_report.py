"""Tables of the elements' accuracy and cost."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from element_meshes import Pattern
from element_runs import CASES, ElementRun

from cosserat_fx.elements import DEFAULT
from cosserat_fx.studies.convergence import limit
from cosserat_fx.typing import Array

type Quantity = Literal["stress", "thickness"]

MM = 1e3
WORDS: dict[Pattern, str] = {"squares": "", "rising": "/", "falling": "\\", "alternating": "/\\", "crossed": "x"}


@dataclass(frozen=True)
class Reference:
    """What the default element on ever finer squares tends to.

    Attributes:
        value: extrapolated where the last three meshes show a rate, otherwise that of the finest.
        error: its bound.
        rate: observed order, nan where there is no clean one.
    """

    value: float
    error: float
    rate: float


class Report:
    """Tables of the runs made.

    Attributes:
        runs: all of them.
        side: of the meshes on which everything is compared, over d50.
        cases: those in which all elements were compared.
    """

    def __init__(self, runs: Sequence[ElementRun], *, side: float) -> None:
        """Keep what is to be shown."""
        self.runs, self.side = runs, side
        self.cases = list(dict.fromkeys(run.case for run in runs if run.study == "elements"))

    def of(self, study: str, case: str) -> list[ElementRun]:
        """The runs of one study in one case."""
        return [run for run in self.runs if (run.study, run.case) == (study, case)]

    def one(self, case: str, element: str, pattern: Pattern = "squares") -> ElementRun:
        """The run of an element on a pattern, with squares of the side of all comparisons where there is one."""
        runs = [run for run in self.of("elements", case) if (run.element, run.pattern) == (element, pattern)]
        return next((run for run in runs if run.side == self.side), runs[0])

    def finest(self, case: str) -> ElementRun:
        """The run of the default element on its finest squares."""
        return [run for run in self.of("elements", case) if run.element == DEFAULT["quadrilateral"]][-1]

    def reference(self, case: str, quantity: Quantity) -> Reference:
        """Converged value of a case."""
        default = DEFAULT["quadrilateral"]
        values = [getattr(run, quantity) for run in self.of("elements", case) if run.element == default]
        return Reference(*limit(values[-3:]))

    def error(self, run: ElementRun, quantity: Quantity) -> float:
        """Error in %, nan where the run has no such value."""
        return 100 * (float(getattr(run, quantity)) / self.reference(run.case, quantity).value - 1)

    def relative_time(self, run: ElementRun) -> float:
        """Processor time over that of the default element where everything is compared."""
        return run.seconds / self.one(run.case, DEFAULT["quadrilateral"]).seconds

    def tables(self) -> str:
        """All tables, in Markdown."""
        others = [case for case in self.cases if self.of("distortion", case)]
        sections = {
            "Converged values": self._reference_table(),
            **{f"Elements, {case}": self._element_table(self.of("elements", case)) for case in self.cases},
            "Distorted meshes": self._distortion_table(others),
            **{f"Hourglass resistance, {case}": self._hourglass_table(case) for case in others},
            "Other elements": self._trial_table(others),
            "Hard cases": self._hard_table(),
        }
        return "\n\n".join(f"### {title}\n\n{table}" for title, table in sections.items() if table) + "\n"

    def _reference_table(self) -> str:
        heads = ["case", "quantity", "value", "error", "error (%)", "rate", "seconds of Q1R"]
        rows = []
        for case in self.cases:
            time = f"{self.one(case, DEFAULT['quadrilateral']).seconds:.1f}"
            quantities: tuple[Quantity, ...] = ("stress", "thickness") if CASES[case].band else ("stress",)
            for quantity in quantities:
                found = self.reference(case, quantity)
                unit, scale, digits = ("kPa", 1e-3, 2) if quantity == "stress" else ("mm", MM, 3)
                rate = "" if math.isnan(found.rate) else f"{found.rate:.2f}"
                value, error = f"{scale * found.value:.{digits}f}", f"{scale * found.error:.{digits}f}"
                share = f"{100 * found.error / found.value:.2f}"
                rows.append([case, f"{quantity} ({unit})", value, error, share, rate, time])
        return _table(heads, rows)

    def _element_table(self, runs: list[ElementRun]) -> str:
        band = any(CASES[run.case].band for run in runs)
        heads = ["element", "mesh", "side (d50)", "points", "unknowns", *_results(band=band), *_EFFORT]
        rows = [
            [
                *(run.element, WORDS[run.pattern], f"{run.side:g}", str(run.points), str(run.unknowns)),
                *self._result(run, band=band),
                *self._effort(run),
            ]
            for run in runs
        ]
        return _table(heads, rows)

    def _distortion_table(self, cases: list[str]) -> str:
        heads = ["case", "element", "mesh", "corners moved by, seed", "stress moved by (%)", *_results(band=True)]
        rows = []
        for run in (run for case in cases for run in self.of("distortion", case)):
            even = self.one(run.case, run.element, run.pattern).stress
            moved = f"{100 * (run.stress / even - 1):+.3f}"
            result, effort = self._result(run, band=True), self._effort(run)
            rows.append([run.case, run.element, WORDS[run.pattern], run.distortion, moved, *result, *effort])
        return _table([*heads, *_EFFORT], rows)

    def _hourglass_table(self, case: str) -> str:
        band = CASES[case].band
        sawtooth = ["largest rotation (deg)", "sawtooth (deg)", "energy (% of work)"]
        rows = [
            [
                f"{run.hourglass:g}",
                *self._result(run, band=band),
                f"{np.abs(rotation(run)).max():.3g}",
                f"{run.sawtooth:.2g}",
                f"{run.hourglass_share:.2g}",
                *self._effort(run),
            ]
            for run in self.of("hourglass", case)
        ]
        return _table(["factor", *_results(band=band), *sawtooth, *_EFFORT], rows)

    def _trial_table(self, cases: list[str]) -> str:
        heads = ["case", "element", "mesh", "side (d50)", *_results(band=True), *_EFFORT]
        rows = []
        for run in (run for case in cases for run in self.of("trials", case)):
            outcome = self._result(run, band=True)
            rows.append([run.case, run.element, WORDS[run.pattern], f"{run.side:g}", *outcome, *self._effort(run)])
        return _table(heads, rows)

    def _hard_table(self) -> str:
        heads = ["case", "element", "mesh", "outcome", "stress (kPa)", "steps", "iterations", "cutbacks"]
        rows = []
        for run in (run for run in self.runs if run.study == "hard case"):
            outcome = f"fails at {MM * run.end:.2f} mm" if run.failure else "done"
            stress = "" if run.failure else f"{1e-3 * run.stress:.1f}"
            counts = [str(n) for n in (run.steps, run.iterations, run.cutbacks)]
            rows.append([run.case, run.element, WORDS[run.pattern], outcome, stress, *counts])
        return _table(heads, rows) if rows else ""

    def _result(self, run: ElementRun, *, band: bool) -> list[str]:
        """Stress and, if asked for, band, each with its error."""
        stress = [f"{1e-3 * run.stress:.2f}", f"{self.error(run, 'stress'):+.2f}"]
        if run.failure:
            stress = [f"fails at {MM * run.end:.2f} mm", ""]
        if not band:
            return stress
        if math.isnan(run.thickness):
            return [*stress, "not measurable" if CASES[run.case].band and not run.failure else "", "", ""]
        thickness = [f"{MM * run.thickness:.2f}", f"{self.error(run, 'thickness'):+.1f}", f"{run.inclination:.1f}"]
        return [*stress, *thickness]

    def _effort(self, run: ElementRun) -> list[str]:
        counts = [str(run.steps), str(run.iterations), str(run.cutbacks)]
        return [*counts, f"{self.relative_time(run):.1f}"]


def rotation(run: ElementRun) -> Array:
    """Rotation of the nodes at the end (degrees)."""
    assert run.state.rotation is not None
    return np.asarray(np.degrees(run.state.rotation))


_EFFORT = ["steps", "iterations", "cutbacks", "relative time"]


def _results(*, band: bool) -> list[str]:
    of_band = ["band (mm)", "error (%)", "inclination (deg)"] if band else []
    return ["stress (kPa)", "error (%)", *of_band]


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
