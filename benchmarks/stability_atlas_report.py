"""Tables of the stability atlas."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from statistics import median

import numpy as np
from stability_atlas_runs import ENDINGS, Entry
from stability_atlas_scenes import AXES, WALKS

_QUANTITIES = ("steps", "iterations", "cutbacks", "passages", "jumps", "substeps", "seconds")


class Report:
    """Tables of the scenes walked.

    Attributes:
        entries: scenes with their outcomes.
    """

    def __init__(self, entries: Sequence[Entry]) -> None:
        """Keep what is to be shown."""
        self.entries = list(entries)

    def tables(self) -> str:
        """All tables, in Markdown."""
        sections = {
            "Endings": self._endings(),
            "What a scene takes": self._costs(),
            "By pressure": self._by_pressure(),
            "Scenes that did not reach the end": self._failures(),
        }
        return "".join(f"\n### {title}\n\n{table}\n" for title, table in sections.items())

    def _endings(self) -> str:
        groups: dict[str, Callable[[Entry], bool]] = {
            "samples": lambda entry: entry.scene.kind == "sample",
            "corners": lambda entry: entry.scene.kind == "corner",
            **{walk: lambda entry, walk=walk: entry.scene.walk == walk for walk in WALKS},  # type: ignore[misc]
            "all": lambda entry: True,
        }
        rows = []
        for name, belongs in groups.items():
            found = [entry.outcome for entry in self.entries if belongs(entry)]
            if found:
                counts = [sum(outcome.ending == ending for outcome in found) for ending in ENDINGS]
                unfinite = sum(not outcome.finite for outcome in found)
                share = f"{100 * counts[0] / len(found):.1f} %"
                rows.append([name, str(len(found)), *map(str, counts), str(unfinite), share])
        return _table(["scenes", "number", *ENDINGS, "with NaN", "done"], rows)

    def _costs(self) -> str:
        outcomes = [entry.outcome for entry in self.entries if entry.outcome.ending == "done"]
        rows = []
        for quantity in _QUANTITIES:
            values = [float(getattr(outcome, quantity)) for outcome in outcomes]
            row = [median(values), float(np.quantile(values, 0.9)), max(values), sum(values)]
            rows.append([quantity, *(f"{value:.4g}" for value in row)])
        return _table(["of a scene that is done", "median", "90 % have less than", "largest", "sum"], rows)

    def _by_pressure(self) -> str:
        rows = []
        for exponent in range(1, 7):
            found = [e.outcome for e in self.entries if min(int(math.log10(e.scene.pressure)), 6) == exponent]
            if found:
                done = [outcome for outcome in found if outcome.ending == "done"]
                medians = [f"{median(getattr(o, name) for o in done):.4g}" if done else "" for name in _QUANTITIES]
                rows.append(
                    [f"{10**exponent:.0e} to {10 ** (exponent + 1):.0e}", str(len(found)), str(len(done)), *medians]
                )
        return _table(["pressure (Pa)", "scenes", "done", *(f"median {name}" for name in _QUANTITIES)], rows)

    def _failures(self) -> str:
        failed = [entry for entry in self.entries if entry.outcome.ending != "done"]
        if not failed:
            return "None."
        rows = []
        for entry in failed:
            values = [f"{getattr(entry.scene, axis.key):.3g}" for axis in AXES]
            outcome = entry.outcome
            part = f"{100 * outcome.travelled:.0f} %"
            rows.append([str(entry.scene.number), entry.scene.walk, *values, outcome.ending, part, outcome.reason])
        return _table(["scene", "walk", *(axis.label for axis in AXES), "ending", "way gone", "reason"], rows)


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
