"""Whether runs to a requested accuracy keep it: random layers against converged references.

Layers of the set `test` were not used to tune anything. Writes `accuracy_promise.json` as it goes, from which it goes
on if started again, then `accuracy_promise.md` and `accuracy_promise.png`. Runs serially, in about half an hour;
docs/accuracy.md shows and discusses the result.

    python benchmarks/accuracy_promise.py --out runs/accuracy_promise
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from accuracy_promise_reference import Reference, reference
from accuracy_promise_report import draw, tables
from accuracy_promise_scenes import Name, RandomLayer, layers
from rich.console import Console

from cosserat_fx.accuracy.trace import Trace, scale
from cosserat_fx.results import read_run
from cosserat_fx.run import run
from cosserat_fx.stepping import SteppingError

COUNTS = {0.01: 40, 0.03: 10, 0.003: 10}
"""Accuracies, and how many layers of a set are run to each: the first ones."""
QUICK = {0.01: 3}
CERTAIN = 1e-3
"""Relative uncertainty of a reference that is enough for the promise at the accuracy that most layers are run to."""

type Record = dict[str, Any]


class Log:
    """References and runs, in a file."""

    def __init__(self, file: Path) -> None:
        """Read what is there."""
        self._file = file
        self.records: dict[str, Record] = json.loads(file.read_text()) if file.exists() else {}

    def of(self, name: Name, number: int, layer: RandomLayer) -> Record:
        """The record of a layer, a new one with its reference unless it is known."""
        key = f"{name} {number}"
        if key not in self.records:
            self.records[key] = {"set": name, "number": number, "layer": vars(layer), "runs": {}}
            self.records[key]["reference"] = _as_record(layer)
            self.save()
        return self.records[key]

    def save(self) -> None:
        """Write all of it."""
        self._file.write_text(json.dumps(self.records, indent=1), encoding="utf-8")


def _as_record(layer: RandomLayer) -> Record:
    try:
        found: Reference = reference(layer, CERTAIN)
    except SteppingError as error:
        return {"failure": str(error)}
    return {"values": found.values.tolist(), "uncertainty": found.uncertainty, "cell_d50": found.cell}


def measure(layer: RandomLayer, accuracy: float, exact: list[list[float]] | None) -> Record:
    """Run a layer to an accuracy as a user would, and compare what it leaves with the reference.

    Args:
        layer: what is run.
        accuracy: what is asked for.
        exact: (2, legs) the converged peaks and residuals (Pa), where they are known.
    """
    with tempfile.TemporaryDirectory() as folder:
        scene, out = layer.scene(accuracy), Path(folder) / "run"
        ledger = run(scene, out)
        if ledger.reason:
            return {"failure": ledger.reason, "warnings": ledger.warnings}
        made = read_run(out)
    entry: Record = {
        **made.summary["accuracy"],
        "steps": ledger.steps,
        "seconds": made.summary["seconds"]["whole run"],
        "seconds_of_trials": made.summary["seconds"]["set-up"],
        "warnings": ledger.warnings,
    }
    if exact is None:
        return entry
    travel = np.cumsum(made.history["step_size_m"])
    ends = [0.0, *np.cumsum(np.abs(np.diff([0.0, *layer.targets])))]
    trace = Trace.of(travel, made.history["shear_stress_Pa"], ends, scene.legs, rate_error=0.0)
    converged = np.array(exact)
    true = np.abs(np.stack([trace.peaks, trace.ends]) - converged) / scale(converged)
    return entry | {"true_error": dict(zip(("peak", "residual"), true.max(axis=1).tolist(), strict=True))}


def main(
    out: Annotated[Path, typer.Option(help="Folder for records, tables and figure.")] = Path("runs/accuracy_promise"),
    name: Annotated[str, typer.Option("--set", help="test, or tuning.")] = "test",
    quick: Annotated[bool, typer.Option("--quick", help="Three layers, to see that it works.")] = False,
) -> None:
    """Runs random layers to requested accuracies."""
    out.mkdir(parents=True, exist_ok=True)
    console, log = Console(soft_wrap=True), Log(out / "accuracy_promise.json")
    chosen: Name = "tuning" if name == "tuning" else "test"
    counts = QUICK if quick else COUNTS
    for number, layer in enumerate(layers(chosen, max(counts.values()))):
        record = log.of(chosen, number, layer)
        for accuracy, count in counts.items():
            if number < count and str(accuracy) not in record["runs"]:
                record["runs"][str(accuracy)] = measure(layer, accuracy, record["reference"].get("values"))
                log.save()
        console.print(f"{chosen} {number}: {_line(record)}", highlight=False)
    report = tables(log.records, chosen)
    (out / "accuracy_promise.md").write_text(report, encoding="utf-8")
    draw(log.records, chosen, out / "accuracy_promise.png")
    console.print(report, highlight=False)


def _line(record: Record) -> str:
    """A layer in a line of the log."""
    told = [f"uncertainty {record['reference'].get('uncertainty', float('nan')):.2%}"]
    for asked, made in record["runs"].items():
        true, estimated = made.get("true_error"), made.get("estimated_error")
        if true and estimated:
            largest = max(it["total"] for it in estimated.values())
            told.append(f"asked {float(asked):.1%}, true {max(true.values()):.2%}, estimated {largest:.2%}")
        else:
            told.append(f"asked {float(asked):.1%}: {made.get('failure', 'no reference')}")
    return "; ".join(told)


if __name__ == "__main__":
    typer.run(main)
