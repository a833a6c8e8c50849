"""What a study leaves in its folder."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from cosserat_fx.studies.assessment import SCOPES, TARGETS, Assessment, Point
from cosserat_fx.studies.choice import Choice, Spelling
from cosserat_fx.studies.folder import StudyFolder
from cosserat_fx.studies.quantities import Quantity
from cosserat_fx.studies.tables import REFINED, Tables, how


class Report:
    """Summary, tables and figures of one study."""

    def __init__(self, found: Assessment, spelling: Spelling, head: Mapping[str, Any]) -> None:
        """Keep what is to be written.

        Args:
            found: by the study.
            spelling: of its choices.
            head: what the summary begins with, the scene's title among it.
        """
        self._found, self._spelling, self._head = found, spelling, head

    def write(self, folder: StudyFolder) -> None:
        """Write all of it; matplotlib, slow to load, is loaded here.

        Args:
            folder: of the study.

        Raises:
            OSError: something cannot be written.
            OutputError: the summary cannot be written.
        """
        from cosserat_fx.studies.figures import draw

        folder.report.write_text(Tables(self._found, self._spelling).page(self._head["title"]), encoding="utf-8")
        folder.figures.mkdir(exist_ok=True)
        draw(self._found, self._spelling, folder.figures)
        folder.write({"status": "done", "reason": None, **self._head, **self._summary()})

    def _summary(self) -> dict[str, Any]:
        found = self._found
        return {
            "quantities": {it.name: self._quantity(it) for it in found.quantities},
            "skipped": found.plan.skipped,
            "not_compared": found.missing,
            "points": [self._point(point) for point in found.points],
            "reference_runs": [
                {**self._choice(choice), "status": record.status, "reason": record.reason}
                for choice, record in found.untold
            ],
            "rates": self._rates(),
            "front": {
                scope: [point.choice.name for point in found.front(found.names(*groups))]
                for scope, groups in SCOPES.items()
            },
            "cheapest": {scope: self._cheapest(found.names(*groups)) for scope, groups in SCOPES.items()},
        }

    def _quantity(self, quantity: Quantity) -> dict[str, Any]:
        """The reference of a quantity; errors are in its unit, but the whole one is in % too."""
        known = self._found.references[quantity.name]
        return {
            "unit": quantity.unit,
            "group": quantity.group,
            "reference": float(known.value) if quantity.is_number else None,
            "scale": quantity.scale(known.value),
            "error": known.error,
            "error_percent": self._found.doubts[quantity.name],
            "step_error": known.step_error,
            "cell_error": known.cell_error,
            "local_error": known.local_error,
            "mixed_error": known.mixed_error,
            "step_rate": _number(known.step_rate),
            "cell_rate": _number(known.cell_rate),
            "how": how(known, with_cells=self._found.with_cells),
        }

    def _choice(self, choice: Choice) -> dict[str, Any]:
        return {
            "name": choice.name,
            "words": self._spelling.words(choice),
            "settings": self._spelling.settings(choice),
        }

    def _point(self, point: Point) -> dict[str, Any]:
        record = point.record
        typical = record.typical
        return {
            **self._choice(point.choice),
            "turned": point.role,
            "status": record.status,
            "reason": record.reason,
            **record.counts,
            "loop_s": record.loop,
            "process_s": record.process,
            "processor_s": record.processor,
            "runs": [asdict(timing) | {"loop": timing.loop} for timing in record.timings],
            "phases_s": dict(typical.phases) if typical else {},
            "errors_percent": {
                name: {"error": error, "is_bound": abs(error) <= point.doubts[name]}
                for name, error in point.errors.items()
            },
        }

    def _rates(self) -> list[dict[str, Any]]:
        rates = []
        for knob in REFINED:
            for quantity in self._found.quantities:
                fit = self._found.fit(knob, quantity)
                if fit is None:
                    continue
                rates.append(
                    {
                        "knob": knob,
                        "quantity": quantity.name,
                        "order": fit.rate.order if fit.rate else None,
                        "standard_error": _number(fit.rate.standard_error) if fit.rate else None,
                        "resolutions": list(fit.resolutions),
                        "errors_percent": list(fit.errors),
                        "used": list(fit.certain),
                    }
                )
        return rates

    def _cheapest(self, names: list[str]) -> list[dict[str, Any]]:
        found = []
        for target in TARGETS:
            point = self._found.cheapest(target, names)
            entry: dict[str, Any] = {"error_at_most_percent": target, "name": None}
            if point is not None:
                fragment = self._spelling.fragment(point.choice)
                entry |= {"name": point.choice.name, "error_percent": point.error(names), "scene": fragment}
            found.append(entry)
        return found


def _number(value: float) -> float | None:
    """A number that JSON knows."""
    return None if math.isnan(value) else value
