"""The error of a run at its end: in numbers for ``run.json``, in one line, in warnings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cosserat_fx.accuracy.estimate import Estimate, estimate
from cosserat_fx.accuracy.plan import Plan, percent
from cosserat_fx.accuracy.trace import Trace
from cosserat_fx.bodies import Body
from cosserat_fx.layer import Layer
from cosserat_fx.stepping import Step
from cosserat_fx.typing import Array

_QUANTITIES = ("peak", "residual")


class AccuracyReport:
    """Watches a run that has an accuracy to keep; of any other it says nothing."""

    def __init__(self, body: Body) -> None:
        """Begin before the first step.

        Args:
            body: what is run.
        """
        self._body = body if isinstance(body, Layer) else None
        self._plan: Plan | None = self._body.plan if self._body else None
        self._travelled = self._rate_error = 0.0
        self._found: Estimate | None = None

    @property
    def wanted(self) -> bool:
        """Whether an accuracy was asked for."""
        return self._plan is not None

    def observe(self, step: Step) -> None:
        """Add up the error of the strain rate in a step just committed."""
        self._travelled += step.size
        self._rate_error += step.size * step.rate_error

    def memento(self) -> dict[str, float]:
        """What has to be remembered to go on after the last step."""
        return {"travelled": self._travelled, "rate_error": self._rate_error}

    def restore(self, memento: Mapping[str, float]) -> None:
        """Go on from a checkpoint."""
        self._travelled, self._rate_error = memento["travelled"], memento["rate_error"]

    def finish(self, history: Mapping[str, Array]) -> None:
        """Estimate the error of a run that has reached the end of its path.

        Args:
            history: its rows, by the columns of ``history.csv``.
        """
        if self._body is None or self._plan is None or self._plan.choice is None:
            return
        run = Trace.of(
            np.cumsum(history["step_size_m"]),
            history["shear_stress_Pa"],
            self._body.path.corners,
            self._body.scene.legs,
            rate_error=self._rate_error / self._travelled,
        )
        self._found = estimate(self._plan.choice, run)

    def entries(self) -> dict[str, Any]:
        """What goes into ``run.json``: asked, chosen and given, and the estimated errors where there are some."""
        plan = self._plan
        if plan is None:
            return {}
        entry = {"asked": plan.asked, "chosen": plan.chosen(), "given": list(plan.given), "trial_runs": plan.trials}
        return {"accuracy": entry | {"estimated_error": None if self._found is None else _by_quantity(self._found)}}

    def line(self) -> str:
        """The estimated errors in words; empty where there are none."""
        if self._found is None or self._plan is None:
            return ""
        totals = [f"{name} {percent(part)}" for name, part in zip(_QUANTITIES, self._found.total, strict=True)]
        return f"estimated error: {', '.join(totals)} (asked: {percent(self._plan.asked)})"

    def warnings(self) -> list[str]:
        """One, where the accuracy is not kept or there is no telling."""
        plan, found = self._plan, self._found
        if plan is None:
            return []
        if plan.failure:
            return [f"accuracy: the error of this run is not known, as a trial run failed: {plan.failure}"]
        if found is None or found.total.max() <= plan.asked:
            return []
        worst = int(np.argmax(found.total))
        sources = [f"{percent(part)} {name}" for name, part in _by_source(found, worst).items() if name != "total"]
        return [
            f"accuracy: the error of the {_QUANTITIES[worst]} shear stress is estimated at "
            f"{percent(found.total[worst])}, more than the {percent(plan.asked)} asked for "
            f"({', '.join(sources).replace('_', ' ')})"
        ]


def _by_quantity(found: Estimate) -> dict[str, dict[str, float]]:
    return {name: _by_source(found, index) for index, name in enumerate(_QUANTITIES)}


def _by_source(found: Estimate, index: int) -> dict[str, float]:
    """Errors of one quantity by their source, and the total."""
    sources = {"mesh": found.mesh, "steps": found.steps, "local_tolerance": found.local_tolerance, "total": found.total}
    return {name: float(errors[index]) for name, errors in sources.items()}
