"""What a study found, as tables in Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from cosserat_fx.studies.assessment import SCOPES, TARGETS, Assessment, Point, Role
from cosserat_fx.studies.choice import Spelling
from cosserat_fx.studies.plan import KNOBS, Knob
from cosserat_fx.studies.quantities import Quantity
from cosserat_fx.studies.reference import Reference

REFINED: tuple[Knob, ...] = ("cells", "steps", "local tolerance")
"""The knobs whose errors have a rate."""


def markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


class Tables:
    """The tables of one study."""

    def __init__(self, found: Assessment, spelling: Spelling) -> None:
        """Keep what is to be shown.

        Args:
            found: by the study.
            spelling: of its choices.
        """
        self._found, self._spelling = found, spelling

    def page(self, title: str) -> str:
        """All of them, with headings.

        Args:
            title: of the scene.
        """
        found = self._found
        sections = {
            "Reference": self._references(),
            "Cheapest for an error": self._cheapest(),
            **{f"Pareto front, {scope}": self._front(self._found.names(*groups)) for scope, groups in SCOPES.items()},
            "Rates": self._rates(),
            **{f"Turned alone: {knob}": self._points(knob) for knob in KNOBS if found.of(knob)},
            "Turned together": self._points("together"),
            "Runs of the reference": self._untimed(),
            "What is not compared": self._missing(),
        }
        body = "\n\n".join(f"## {heading}\n\n{text}" for heading, text in sections.items() if text)
        return f"# What accuracy costs: {title or 'a scene without a title'}\n\n{_EXPLANATION}\n\n{body}\n"

    def _references(self) -> str:
        heads = ["quantity", "value", "error (%)", "of it: steps", "cells", "local tolerance", "both", "how"]
        rows = []
        for quantity in self._found.quantities:
            known = self._found.references[quantity.name]
            scale = 100 / quantity.scale(known.value)
            parts = (known.error, known.step_error, known.cell_error, known.local_error, known.mixed_error)
            value = f"{float(known.value):.6g} {quantity.unit}".strip() if quantity.is_number else "profiles"
            rows.append(
                [
                    quantity.name,
                    value,
                    *(f"{scale * part:.4f}" for part in parts),
                    how(known, with_cells=self._found.with_cells),
                ]
            )
        return markdown(heads, rows)

    def _cheapest(self) -> str:
        heads = [
            "largest error of",
            "at most (%)",
            "cheapest",
            "its error (%)",
            "loop (s)",
            "process (s)",
            "processor (s)",
        ]
        rows: list[list[str]] = []
        pasted: dict[str, list[str]] = {}
        for scope, groups in SCOPES.items():
            names = self._found.names(*groups)
            for target in TARGETS:
                point = self._found.cheapest(target, names)
                if point is None:
                    rows.append([scope, f"{target:g}", "none of those tried", "", "", "", ""])
                    continue
                setting = self._spelling.words(point.choice)
                rows.append([scope, f"{target:g}", setting, error_in_words(point, names), *_times(point)])
                fragment = self._spelling.fragment(point.choice) or "# the scene as it is"
                pasted.setdefault(fragment, []).append(f"{scope} within {target:g} %")
        pieces = [f"To paste, for {', '.join(uses)}:\n\n```toml\n{it}\n```" for it, uses in pasted.items()]
        return "\n\n".join([markdown(heads, rows), *pieces])

    def _front(self, names: Sequence[str]) -> str:
        rows = [
            [self._spelling.words(point.choice), error_in_words(point, names), *_times(point)]
            for point in self._found.front(names)
        ]
        return markdown(["setting", "error (%)", "loop (s)", "process (s)", "processor (s)"], rows) if rows else ""

    def _rates(self) -> str:
        rows = []
        for knob in REFINED:
            for quantity in self._found.quantities:
                fit = self._found.fit(knob, quantity)
                if fit is not None:
                    rate = f"{fit.rate}" if fit.rate else "none: the limit is not known well enough"
                    rows.append([knob, quantity.name, rate, f"{sum(fit.certain)} of {len(fit.certain)}"])
        return markdown(["knob", "quantity", "error falls with the power", "points used"], rows) if rows else ""

    def _points(self, role: Role) -> str:
        points = [*self._found.of("start"), *self._found.of(role)]
        rows = [self._row(point) for point in sorted(points, key=rank)]
        errors = [f"{quantity.name} (%)" for quantity in self._found.quantities]
        effort = ["steps", "iterations", "cutbacks", "loop (s)", "process (s)", "processor (s)", "runs", "how it ended"]
        return markdown(["setting", *errors, *effort], rows)

    def _row(self, point: Point) -> list[str]:
        errors = [signed_error(point, quantity) for quantity in self._found.quantities]
        counts = [str(point.record.counts.get(name, "")) for name in ("steps", "newton_iterations", "cutbacks")]
        runs = str(len(point.record.timings) or "")
        return [self._spelling.words(point.choice), *errors, *counts, *_times(point), runs, _ending(point)]

    def _untimed(self) -> str:
        rows = [
            [self._spelling.words(choice), "done" if record.done else f"{record.status}: {record.reason}"]
            for choice, record in self._found.untold
        ]
        return markdown(["setting", "how it ended"], rows) if rows else ""

    def _missing(self) -> str:
        rows = [[name, reason] for name, reason in [*self._found.plan.skipped.items(), *self._found.missing.items()]]
        return markdown(["knob or quantity", "why"], rows) if rows else ""


_EXPLANATION = """\
Errors are against the reference of the first table. Numbers have a sign; of profiles it is the root mean square of the
difference over the range of the reference, of a column at several travels that over its largest value. An error with
`<` is less than what the reference itself may be wrong by. *Loop* is the time of the solver, *process* that of the
whole program from its start to its end, both by the clock on the wall, and *processor* what the program had of a
processor: on a machine that does nothing else the last two differ little. All are medians of the runs counted under
*runs*. The tables of single knobs have the scene as it is in its place."""


def rank(point: Point) -> tuple[float, ...]:
    """Where a point stands among others: coarse before fine, with everything before without something."""
    choice = point.choice
    return choice.without is not None, choice.cells, -choice.steps, -choice.local


def how(known: Reference, *, with_cells: bool) -> str:
    """How a reference was found.

    Args:
        known: the reference.
        with_cells: whether cells were refined for it.
    """
    rates = {"steps": known.step_rate} | ({"cells": known.cell_rate} if with_cells else {})
    return ", ".join(
        f"{knob}: {'finest run' if math.isnan(rate) else f'extrapolated with order {rate:.2f}'}"
        for knob, rate in rates.items()
    )


def signed_error(point: Point, quantity: Quantity) -> str:
    """One error of a point, empty where it has none."""
    if quantity.name not in point.errors:
        return ""
    error, doubt = point.errors[quantity.name], point.doubts[quantity.name]
    if abs(error) <= doubt:
        return f"< {doubt:.2g}"
    return f"{error:+.3g}" if quantity.is_number else f"{error:.3g}"


def error_in_words(point: Point, names: Sequence[str]) -> str:
    """The largest error of a point, which has it."""
    error = point.error(names)
    return f"{'< ' if point.is_bound(names) else ''}{error:.2g}"


def _times(point: Point) -> list[str]:
    record = point.record
    times = (record.loop, record.process, record.processor)
    return [f"{seconds:.3g}" if seconds is not None else "" for seconds in times]


def _ending(point: Point) -> str:
    return "done" if point.record.done else f"{point.record.status}: {point.record.reason}"
