"""Helpers of the performance benchmarks: alternating measurements, medians with quartiles, ratios, tables.

A machine that others use is noisy, and its clock wanders. What is compared is therefore measured in turn, again and
again, within one process. Every round gives one ratio, and what is told is their median with the quartiles.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np

from cosserat_fx.versions import versions


class Spread(NamedTuple):
    """Median and quartiles of a sample."""

    median: float
    lower: float
    upper: float

    def __str__(self) -> str:
        """The median with the quartiles."""
        return f"{self.median:.3g} ({self.lower:.3g} to {self.upper:.3g})"


def spread(values: Sequence[float]) -> Spread:
    """Median and quartiles."""
    lower, median, upper = np.percentile(np.asarray(values, dtype=float), [25, 50, 75])
    return Spread(float(median), float(lower), float(upper))


def ratio(above: Sequence[float], below: Sequence[float]) -> Spread:
    """Median and quartiles of the ratios of values that were measured next to each other."""
    return spread([a / b for a, b in zip(above, below, strict=True)])


def seconds(call: Callable[[], object]) -> float:
    """Wall time of one call (s)."""
    start = perf_counter()
    call()
    return perf_counter() - start


def processor_seconds(call: Callable[[], object]) -> float:
    """Processor time of one call (s): on one thread, what it takes by the clock on an idle machine."""
    start = process_time()
    call()
    return process_time() - start


def alternately(cases: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, list[float]]:
    """What each case gives in every round; the cases take turns, in every other round from the last to the first.

    One round more, which is dropped, goes first.

    Args:
        cases: what returns its own measurement, by name.
        rounds: how often.
    """
    measured: dict[str, list[float]] = {name: [] for name in cases}
    for number in range(rounds + 1):
        for name in list(cases)[:: -1 if number % 2 else 1]:
            value = cases[name]()
            if number:
                measured[name].append(value)
    return measured


def peak_memory() -> int:
    """Largest resident memory of this process so far (bytes)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    [peak] = [int(line.split()[1]) for line in lines if line.startswith("VmHWM")]
    return 1024 * peak


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    names = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    name = names[0].partition(":")[2].strip() if names else platform.processor()
    return {"processor": name, "cores": len(names), "versions": versions()}


def table(headings: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table in Markdown; the first column is text, the others are figures."""
    rule = ["---", *["---:"] * (len(headings) - 1)]
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in (headings, rule, *rows)) + "\n"


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """The power of the size with which values grow: slope of the straight line through the logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def write(out: Path, name: str, figures: Mapping[str, Any], text: str) -> None:
    """Write figures and text of a benchmark.

    Args:
        out: folder, made where it is missing.
        name: of the benchmark.
        figures: for ``<name>.json``, to which the machine is added.
        text: for ``<name>.md``.
    """
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.json").write_text(json.dumps({"machine": machine(), **figures}, indent=2) + "\n")
    (out / f"{name}.md").write_text(text)
