"""What the runs of a study say: errors, rates, the Pareto front, the cheapest way to an accuracy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cosserat_fx.studies.choice import Choice
from cosserat_fx.studies.convergence import STEADY, Rate, fit_rate, limit, size
from cosserat_fx.studies.plan import KNOBS, Knob, Plan
from cosserat_fx.studies.quantities import Group, Measured, Quantity
from cosserat_fx.studies.reference import Levels, Reference, reference
from cosserat_fx.studies.runs import Record

TARGETS = (1.0, 0.3, 0.1)
"""Errors for which the cheapest way is named (%)."""

SCOPES: dict[str, tuple[Group, ...]] = {
    "stresses": ("stress",),
    "stresses and profiles": ("stress", "profiles"),
    "everything compared": ("stress", "profiles", "band"),
}
"""Groups of quantities that an accuracy may be asked of."""
type Role = Literal["start", "together"] | Knob


@dataclass(frozen=True)
class Point:
    """One setting with what it costs and how wrong it is.

    Attributes:
        choice: the setting.
        role: the knob that is turned alone, or what else it is.
        record: of its runs.
        errors: in % by quantity, of those that it has and that have a reference.
        doubts: bound of the reference's own error in % by quantity.
    """

    choice: Choice
    role: Role
    record: Record
    errors: Mapping[str, float]
    doubts: Mapping[str, float]

    def error(self, names: Iterable[str]) -> float | None:
        """The largest error of several quantities (%); no less than what the reference can tell.

        None where the run does not have them all.
        """
        wanted = list(names)
        if not self.record.done or not wanted or any(name not in self.errors for name in wanted):
            return None
        return max(max(abs(self.errors[name]), self.doubts[name]) for name in wanted)

    def is_bound(self, names: Iterable[str]) -> bool:
        """Whether the largest error is less than the reference can tell."""
        return all(abs(self.errors[name]) <= self.doubts[name] for name in names)


@dataclass(frozen=True)
class Fit:
    """How the error of a quantity falls with one knob, all others being fine.

    Attributes:
        resolutions: sizes relative to the scene's own; of the local tolerance its values.
        errors: in %.
        certain: whether each error exceeds what the limit of the sequence can tell; only such count for the rate.
        rate: the fit, where there are two certain points.
    """

    resolutions: tuple[float, ...]
    errors: tuple[float, ...]
    certain: tuple[bool, ...]
    rate: Rate | None


class Assessment:
    """What a study found.

    Attributes:
        plan: what was to be run.
        quantities: what is compared.
        references: by quantity, of those that have one.
        points: all settings but those that only the reference needs.
        missing: why a quantity is not compared, by its name.
    """

    def __init__(
        self,
        plan: Plan,
        quantities: Sequence[Quantity],
        records: Mapping[Choice, Record],
        measured: Mapping[Choice, Measured],
        *,
        left_out: Mapping[str, str] | None = None,
    ) -> None:
        """Compare everything that came to its end.

        Args:
            plan: what was to be run.
            quantities: what may be compared.
            records: how the runs ended.
            measured: what those came to that came to their end.
            left_out: what is not even tried to compare, with the reason.
        """
        self.plan, self._measured, self._records = plan, measured, records
        self.with_cells = "cells" not in plan.skipped
        self.references: dict[str, Reference] = {}
        self.missing: dict[str, str] = dict(left_out or {})
        self.quantities = []
        for quantity in quantities:
            found = reference(quantity, plan.refinement, measured, with_cells=self.with_cells)
            if found is None:
                self.missing[quantity.name] = (
                    "runs that its reference needs do not have it or did not come to their end"
                )
            elif not quantity.scale(found.value):
                self.missing[quantity.name] = "it is zero"
            else:
                self.references[quantity.name] = found
                self.quantities.append(quantity)
        self.doubts = {it.name: 100 * self._relative(it, self.references[it.name].error) for it in self.quantities}
        roles: dict[Choice, Role] = {plan.start: "start"}
        roles |= {choice: knob for knob in KNOBS for choice in plan.alone[knob]}
        roles |= dict.fromkeys(plan.together, "together")
        self.points = [self._point(choice, roles[choice]) for choice in plan.timed if choice in records]

    def names(self, *groups: Group) -> list[str]:
        """The quantities of some groups."""
        return [it.name for it in self.quantities if it.group in groups]

    def of(self, role: Role) -> list[Point]:
        """The points of a role."""
        return [point for point in self.points if point.role == role]

    @property
    def untold(self) -> list[tuple[Choice, Record]]:
        """What only the reference needs, in the order of the plan."""
        return [(choice, self._records[choice]) for choice in self.plan.untimed if choice in self._records]

    def front(self, names: Sequence[str]) -> list[Point]:
        """The points that no other one beats in both time and error, from cheap to exact.

        Those without an effect that the scene asks for are no part of it: their error is another one in every scene.

        Args:
            names: of the quantities.
        """
        found: list[Point] = []
        for point in sorted(self._rated(names), key=lambda it: (it.record.loop, it.error(names))):
            error, best = point.error(names), found[-1].error(names) if found else None
            if best is None or (error is not None and error < best):
                found.append(point)
        return found

    def cheapest(self, target: float, names: Sequence[str]) -> Point | None:
        """The point of the front with the shortest loop whose error is at most the target (%)."""
        return next((point for point in self.front(names) if (point.error(names) or 0.0) <= target), None)

    def fit(self, knob: Knob, quantity: Quantity) -> Fit | None:
        """How a quantity's error falls with cells, steps or local tolerance; None where too few runs ended."""
        choices, resolutions = self._sequence(knob)
        values = [self._measured[choice].get(quantity.name) for choice in choices]
        present = [value for value in values if value is not None]
        if len(present) < 3 or len(present) < len(values):
            return None
        if knob == "local tolerance":
            exact, bound = present[-1], size(present[-1] - present[-2])
            present, resolutions = present[:-1], resolutions[:-1]
        else:
            exact, bound, _ = limit(present, steady=STEADY)
        errors = [100 * self._relative(quantity, size(value - exact)) for value in present]
        certain = [size(value - exact) > bound for value in present]
        used = [(h, e) for h, e, good in zip(resolutions, errors, certain, strict=True) if good]
        rate = fit_rate([h for h, _ in used], [e for _, e in used])
        return Fit(tuple(resolutions), tuple(errors), tuple(certain), rate)

    def _sequence(self, knob: Knob) -> tuple[list[Choice], list[float]]:
        """The runs that show what a knob does, from coarse to fine, and their resolutions."""
        refinement = self.plan.refinement
        if knob == "local tolerance":
            alone = [self.plan.start, *self.plan.alone[knob]]
            chosen = sorted((it for it in alone if it in self._measured), key=lambda it: -it.local)
            return chosen, [it.local for it in chosen]
        planned = refinement.cells if knob == "cells" else refinement.steps
        if knob == "element" or knob == "effects" or refinement.corner not in self._measured:
            return [], []
        chosen = Levels(planned, refinement.corner, self._measured).choices
        return chosen, [1 / it.cells if knob == "cells" else it.steps for it in chosen]

    def _rated(self, names: Sequence[str]) -> list[Point]:
        """The points that have a time and an error."""
        return [
            it
            for it in self.points
            if it.choice.without is None and it.record.loop is not None and it.error(names) is not None
        ]

    def _relative(self, quantity: Quantity, amount: float) -> float:
        return amount / quantity.scale(self.references[quantity.name].value)

    def _point(self, choice: Choice, role: Role) -> Point:
        values = self._measured.get(choice, {})
        errors = {
            it.name: it.error(values[it.name], self.references[it.name].value)
            for it in self.quantities
            if it.name in values and np.all(np.isfinite(values[it.name]))
        }
        return Point(choice, role, self._records[choice], errors, self.doubts)
