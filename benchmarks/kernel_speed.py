"""The constitutive update with tangent against the same scheme in C, on the increments of real runs.

Walks the medium rough layer and the biaxial test, keeps what some evenly spread evaluations asked of the update, and
lets the compiled kernel and `reference_update.c` (gcc -O3 -march=native) answer in turn. Their answers are compared,
too: the C program is a second implementation of the scheme. Writes `kernel_speed.json`, `.md` and `.png`.

    python benchmarks/kernel_speed.py --out runs/kernel_speed
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Annotated, Any

import numpy as np
import typer
from timing_pairs import Spread, alternately, ratio, spread, table, write

from cosserat_fx._compat import MPI
from cosserat_fx.bodies import build
from cosserat_fx.layout import Layout
from cosserat_fx.material import KernelConstants
from cosserat_fx.output.page import GUIDE, figure
from cosserat_fx.scene import load_scene
from cosserat_fx.state import MAX_SUBSTEPS, QuadratureState
from cosserat_fx.tables import tables
from cosserat_fx.typing import Array
from cosserat_fx.update import build_update

HERE = Path(__file__).resolve().parent
DEMOS = HERE.parent / "demos"
EVALUATIONS = 40
COLOURS = ("tab:blue", "tab:orange")
BATCHES = (16, 64, 256, 1024, 4096)
"""Sizes of batches, in points, over which the time of a point is shown."""


@dataclass(frozen=True)
class Points:
    """What evaluations of a run asked of the update."""

    name: str
    layout: Layout
    constants: KernelConstants
    tolerance: float
    increments: Array
    forces_n: Array
    e_n: Array

    def __len__(self) -> int:
        """Number of points."""
        return len(self.e_n)

    def repeated(self, number: int) -> Points:
        """So many of them, evenly spread and again from the first where there are not enough."""
        step = max(1, len(self) // number)
        chosen = (np.arange(number) * step) % len(self)
        return Points(
            self.name,
            self.layout,
            self.constants,
            self.tolerance,
            *(np.ascontiguousarray(values[chosen]) for values in (self.increments, self.forces_n, self.e_n)),
        )


class Answer:
    """Arrays for one answer to some points."""

    def __init__(self, points: Points) -> None:
        """Room for it."""
        m, driven = len(points), len(points.layout.strain_slots)
        self.forces = np.zeros_like(points.forces_n)
        self.e = np.zeros(m)
        self.tangent = np.zeros((m, driven, points.layout.n_inputs))
        self.substeps = np.ones(m, np.int32)
        self.status = np.zeros(m, np.uint8)
        self.error = np.zeros(m)


def walked(name: str, overrides: list[str]) -> Points:
    """What a demo's run asks of the update."""
    body = build(load_scene(DEMOS / f"{name}.toml", overrides), MPI.COMM_SELF)
    state, kept = body.problem.state, []
    update = QuadratureState.update

    def keeping(self: QuadratureState, increments: Array, **how: Any) -> Any:
        kept.append((increments.copy(), self.forces_n[self.points].copy(), self.e_n[self.points].copy()))
        return update(self, increments, **how)

    QuadratureState.update = keeping  # type: ignore[method-assign]
    try:
        for _ in body.stepper:
            pass
    finally:
        QuadratureState.update = update  # type: ignore[method-assign]
    chosen = [kept[k] for k in np.unique(np.linspace(0, len(kept) - 1, EVALUATIONS).astype(int))]
    arrays = (np.concatenate(values) for values in zip(*chosen, strict=True))
    return Points(name, state.layout, body.problem.material.kernel_parameters(), state.tolerance, *arrays)


class _Tables(ctypes.Structure):
    """Tables of reference_update.c, whose sizes come with the layout."""


def compile_reference(layout: Layout, folder: Path) -> tuple[ctypes.CDLL, ctypes.Structure]:
    """Compile the C program for a layout; its library and tables.

    Raises:
        CalledProcessError: gcc could not.
    """
    t = tables(layout, spin=bool(layout.spin))
    n, driven, turns = len(layout.forces), len(layout.strain_slots), len(t.spin_row)
    sizes = {"N": n, "STRESSES": t.n_stress, "DRIVEN": driven, "SPINS": t.n_spin, "TURNS": turns}
    library = folder / f"{layout.dimension}.so"
    command = ["gcc", "-O3", "-march=native", "-shared", "-fPIC", *(f"-D{key}={size}" for key, size in sizes.items())]
    subprocess.run([*command, "-o", library, HERE / "reference_update.c", "-lm"], check=True)
    vectors = dict.fromkeys(("weight", "normal", "share"), ctypes.c_double * n)
    integers = {"symmetric": n, "slots": driven, "row": turns + 1, "column": turns + 1, "spin": turns + 1}

    class Filled(_Tables):
        _fields_ = (
            *vectors.items(),
            *((key, ctypes.c_int * size) for key, size in integers.items()),
            ("sign", ctypes.c_double * (turns + 1)),
        )

    values = {**t._asdict(), "row": t.spin_row, "column": t.spin_column, "spin": t.spin_of, "sign": t.spin_sign}
    filled = Filled()
    for key, kind in Filled._fields_:
        setattr(filled, key, kind(*values[key]))
    return ctypes.CDLL(str(library)), filled


def in_numba(points: Points, answer: Answer, *, adapt: bool) -> Callable[[], object]:
    """One answer by the kernel."""
    update = build_update(points.layout, spin=bool(points.layout.spin))
    rows = np.arange(len(points), dtype=np.int32)
    state = (answer.forces, answer.e, answer.tangent, answer.substeps, answer.status, answer.error)

    def call() -> None:
        answer.substeps[:] = 1
        update(
            points.increments,
            rows,
            points.forces_n,
            points.e_n,
            *state,
            points.constants,
            points.tolerance,
            MAX_SUBSTEPS,
            adapt,
            True,
        )

    return call


def in_c(
    points: Points, answer: Answer, reference: tuple[ctypes.CDLL, ctypes.Structure], *, adapt: bool
) -> Callable[[], object]:
    """One answer by the C program."""
    library, filled = reference
    constants = (ctypes.c_double * len(points.constants))(*points.constants)
    arrays = (points.increments, points.forces_n, points.e_n)
    written = (answer.forces, answer.e, answer.tangent, answer.substeps, answer.status, answer.error)
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in (*arrays, *written)]

    def call() -> None:
        answer.substeps[:] = 1
        library.update(
            ctypes.c_long(len(points)),
            ctypes.byref(filled),
            *pointers,
            constants,
            ctypes.c_double(points.tolerance),
            MAX_SUBSTEPS,
            int(adapt),
            1,
        )

    return call


def nanoseconds(call: Callable[[], object], points: int, repeats: int) -> Callable[[], float]:
    """Processor time of a call for one point (ns)."""

    def measure() -> float:
        start = process_time()
        for _ in range(repeats):
            call()
        return 1e9 * (process_time() - start) / points / repeats

    return measure


def difference(points: Points, one: Answer, other: Answer) -> dict[str, float]:
    """Largest differences of two answers, relative to the largest entry of each point."""

    def relative(a: Array, b: Array) -> float:
        a, b = a.reshape(len(points), -1), b.reshape(len(points), -1)
        return float((np.abs(a - b).max(axis=1) / np.abs(b).max(axis=1)).max())

    assert np.array_equal(one.substeps, other.substeps)
    assert np.array_equal(one.status, other.status)
    return {"forces": relative(one.forces, other.forces), "tangent": relative(one.tangent, other.tangent)}


def compare(points: Points, folder: Path, rounds: int) -> dict[str, Any]:
    """Both programs on all points with adapted substeps, and with one substep on batches of several sizes."""
    reference = compile_reference(points.layout, folder)
    ours, theirs = Answer(points), Answer(points)
    calls = {"numba": in_numba(points, ours, adapt=True), "C": in_c(points, theirs, reference, adapt=True)}
    times = alternately({name: nanoseconds(call, len(points), 1) for name, call in calls.items()}, rounds)
    entry: dict[str, Any] = {
        "points": len(points),
        "substeps": float(ours.substeps.mean()),
        "difference": difference(points, ours, theirs),
        "adapted": {**{name: spread(t) for name, t in times.items()}, "ratio": ratio(times["numba"], times["C"])},
        "one substep": {},
    }
    for size in BATCHES:
        some = points.repeated(size)
        repeats = max(1, BATCHES[-1] // size)
        one, other = Answer(some), Answer(some)
        calls = {"numba": in_numba(some, one, adapt=False), "C": in_c(some, other, reference, adapt=False)}
        times = alternately({name: nanoseconds(call, size, repeats) for name, call in calls.items()}, rounds)
        entry["one substep"][size] = {
            **{name: spread(t) for name, t in times.items()},
            "ratio": ratio(times["numba"], times["C"]),
        }
    return entry


def draw(entries: dict[str, Any], out: Path) -> None:
    """Time of a point over the size of a batch."""
    with figure(out / "kernel_speed.png", 8.5) as page:
        axes = page.subplots()
        for (name, entry), colour in zip(entries.items(), COLOURS, strict=False):
            for program, style in (("numba", "o-"), ("C", "s--")):
                rows = entry["one substep"]
                medians = [rows[size][program].median / 1e3 for size in rows]
                axes.plot(list(rows), medians, style, color=colour, label=f"{name.replace('_', ' ')}, {program}")
        axes.set(xscale="log", xlabel="points at once", ylabel="time of a point (µs)", ylim=(0, None))
        axes.axhline(2.0, **GUIDE)
        axes.legend(frameon=False)


def report(entries: dict[str, Any]) -> str:
    """The table of the documentation."""
    rows = []
    for name, entry in entries.items():
        cases = {
            f"as in the run ({entry['substeps']:.2f} substeps on average)": entry["adapted"],
            **{f"one substep, {size} at once": row for size, row in entry["one substep"].items()},
        }
        for what, row in cases.items():
            times = [f"{row[program].median / 1e3:.2f}" for program in ("numba", "C")]
            rows.append([f"{name.replace('_', ' ')}: {what}", *times, str(row["ratio"])])
    worst = {key: max(entry["difference"][key] for entry in entries.values()) for key in ("forces", "tangent")}
    return (
        table(["update with tangent", "numba (µs a point)", "C (µs a point)", "ratio (quartiles)"], rows)
        + f"\nThe two programs' stresses agree to {worst['forces']:.0e}, their tangents to {worst['tangent']:.0e}.\n"
    )


def main(
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    quick: Annotated[bool, typer.Option(help="A coarse look.")] = False,
) -> None:
    """Measure and report."""
    if not shutil.which("gcc"):
        sys.exit("kernel_speed.py compares with a C program and found no gcc to compile it: try apt install gcc.")
    scenes = {"layer_medium_rough": ["walls.top.shear_displacement=0.002", "output.profiles_at=[]"] if quick else []}
    if not quick:
        scenes["biaxial"] = []
    with tempfile.TemporaryDirectory() as folder:
        entries = {
            name: compare(walked(name, overrides), Path(folder), rounds=3 if quick else 15)
            for name, overrides in scenes.items()
        }
    text = report(entries)
    plain = {name: _plain(entry) for name, entry in entries.items()}
    write(out, "kernel_speed", {"runs": plain}, text)
    draw(entries, out)
    print(text)


def _plain(value: Any) -> Any:
    """Named tuples as tables, for JSON."""
    if isinstance(value, Spread):
        return value._asdict()
    return {str(key): _plain(part) for key, part in value.items()} if isinstance(value, dict) else value


if __name__ == "__main__":
    typer.run(main)
