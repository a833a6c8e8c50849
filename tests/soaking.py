"""Long runs of many small steps, watched: memory, open files, PETSc's objects and the time of every step."""

import gc
import os
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any
from unittest import mock

import numpy as np

from cosserat_fx._compat import MPI, PETSc
from cosserat_fx.recorder import Recorder
from cosserat_fx.run import run
from cosserat_fx.scene import Scene, load_scene
from cosserat_fx.stepping import Step

DEMOS = Path(__file__).parents[1] / "demos"
STEP = 1e-6
"""Of the walls and plates (m)."""


def to_and_fro(steps: int, cycles: int) -> list[float]:
    """Targets (m) of cycles of so many steps each, which begin and end in the middle."""
    amplitude = steps * STEP / 4
    return [amplitude * (-1) ** (leg) for leg in range(2 * cycles)] + [0.0]


def small_steps(targets: list[float]) -> list[str]:
    """Overrides for steps of one size along targets, without figures."""
    return [
        f"stepping.max_step={STEP}",
        f"stepping.first_step={STEP}",
        f"stepping.max_steps={10 * round(np.abs(np.diff([0.0, *targets])).sum() / STEP)}",
        "output.figures=false",
    ]


def layer(steps: int, cycles: int) -> Scene:
    """A layer of few cells sheared to and fro; profiles and fields at every turn."""
    targets = to_and_fro(steps, cycles)
    moves = [f"walls.top.shear_displacement={targets}", f"output.profiles_at={targets}"]
    return load_scene(
        DEMOS / "layer_medium_rough.toml",
        ["geometry.cells=20", "effects.finite_strain=true", *moves, *small_steps(targets)],
    )


def plane(steps: int, cycles: int) -> Scene:
    """A small specimen squeezed and stretched; fields four times."""
    targets = to_and_fro(steps, cycles)
    moves = [f"boundaries.top.u2={targets}", "output.fields_at=[]", "output.frames=4", "output.animation=false"]
    return load_scene(
        DEMOS / "biaxial.toml", ["geometry.cells=[4, 14]", "effects.finite_strain=true", *moves, *small_steps(targets)]
    )


@dataclass
class Soaked:
    """What was seen of a run on one rank.

    Attributes:
        step: of every sample.
        resident: memory at each (bytes).
        handles: open files at each.
        python: objects that Python's garbage collector knows at each.
        petsc: PETSc's objects that are alive at each, by kind.
        seconds: processor time of every step.
        reference: processor time of a fixed piece of work after every step, by which the machine is judged.
        iterations: of every step.
        answer: what the run says about its answer.
    """

    step: list[int] = field(default_factory=list)
    resident: list[int] = field(default_factory=list)
    handles: list[int] = field(default_factory=list)
    python: list[int] = field(default_factory=list)
    petsc: list[dict[str, int]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    reference: list[float] = field(default_factory=list)
    iterations: list[int] = field(default_factory=list)
    answer: str = ""

    def sample(self, step: int) -> None:
        """Look at the process."""
        gc.collect()
        self.step.append(step)
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.resident.append(pages * os.sysconf("SC_PAGE_SIZE"))
        self.handles.append(len(os.listdir("/proc/self/fd")))
        self.python.append(len(gc.get_objects()))
        self.petsc.append(petsc_objects())


def _work() -> float:
    """Something that takes as long every time, about 0.3 ms, in Python and in NumPy."""
    numbers, total = np.cos(np.arange(300.0)), 0.0
    for k in range(60):
        total += float(np.sort(numbers) @ numbers) + len({str(i): i for i in range(k)})
    return total


def petsc_objects() -> dict[str, int]:
    """Objects created and not destroyed since PETSc's log began, by kind."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "log"
        viewer = PETSc.Viewer().createASCII(str(file), "w", MPI.COMM_SELF)
        PETSc.Log.view(viewer)
        viewer.destroy()
        lines = file.read_text().splitlines()
    table = lines[next(i for i, line in enumerate(lines) if line.startswith("Object Type")) :]
    rows = [row for line in table if len(row := line.rsplit(None, 2)) == 3 and row[1].isdigit() and row[2].isdigit()]
    return {name.strip(): int(created) - int(destroyed) for name, created, destroyed in rows}


def soak(scene: Scene, out: Path, every: int) -> Soaked:
    """Run a scene on one rank and watch it.

    Args:
        scene: what to run.
        out: the run's folder.
        every: steps from one sample to the next.
    """
    seen = Soaked()

    class Watching(Recorder):
        """Looks at the process after every so many steps."""

        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self._begin = process_time()

        def record(self, step: Step) -> None:
            super().record(step)
            seen.seconds.append(process_time() - self._begin)
            seen.iterations.append(step.iterations)
            begin = process_time()
            _work()
            seen.reference.append(process_time() - begin)
            if step.number % every == 0:
                seen.sample(step.number)
            self._begin = process_time()

    PETSc.Log.begin()
    with mock.patch("cosserat_fx.run.Recorder", Watching):
        ledger = run(scene, out, overwrite=True)
    assert ledger.reason is None, ledger.reason
    seen.answer = ledger.answer
    return seen
