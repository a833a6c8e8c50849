"""Runs in two halves: asked to stop after so many evaluations of the law, and gone on with."""

import json
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import sleep
from typing import Any
from unittest.mock import patch

import numpy as np
from layers import difference
from meshes import square, write_msh
from planes import BASE, BIAXIAL
from scenes import change

from cosserat_fx._compat import MPI
from cosserat_fx.interruption import InterruptedRunError, Interruption
from cosserat_fx.recorder import Ledger
from cosserat_fx.results import read_run
from cosserat_fx.run import run
from cosserat_fx.scene import Scene, parse_scene

AFTER = 20
"""Evaluations of the law, which fall within a step."""
LAYER: dict[str, Any] = {
    "geometry": {"height": 0.01, "cells": 12},
    "initial": {"stress": -100e3, "void_ratio": 0.6},
    "walls": {
        "top": {"rolling": 0.0125, "normal_stress": -120e3, "shear_displacement": [0.001, 0.0006]},
    },
    "output": {"profiles_at": [0.0005, 0.001], "figures": False},
}
"""A normal stress that is brought up first, shear, and a reversal."""
COMPRESSION = change(
    BASE,
    BIAXIAL
    | {
        "initial.zones": [{"x": [0.0, 0.01], "y": [0.0, 0.01], "void_ratio": 0.65}],
        "boundaries.top.u2": -0.0006,
        "output": {"figures": False, "animation": False, "fields_at": [0.0003, 0.0006]},
    },
)
"""A body that is not alike everywhere: where it were, rounding would decide where it gives way."""
ELEMENTS = {"Q1R": "quad", "Q1": "quad", "Q2Q1": "quad", "P1": "triangle", "P2P1": "triangle"}


@contextmanager
def asked_to_stop(after: int) -> Iterator[None]:
    """A signal comes, on every rank, before an evaluation of the law."""
    left = after

    def check(self: Interruption) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise InterruptedRunError("interrupted by a test")

    with patch.object(Interruption, "check", check):
        yield


def first_half(scene: Scene, folder: Path, comm: MPI.Intracomm = MPI.COMM_SELF, after: int = AFTER) -> Ledger:
    """The run up to the signal."""
    with asked_to_stop(after):
        ledger = run(scene, folder, comm=comm)
    assert ledger.reason == "interrupted by a test"
    assert ledger.steps
    return ledger


def differences(folder: Path, other: Path) -> float:
    """Largest difference of two histories, relative to the largest magnitude of all columns of the same unit."""
    one, two = (read_run(it).history for it in (folder, other))
    kinds: dict[str, list[str]] = {}
    for name in one:
        unit = re.search("_(N_per_m|N|m|rad|Pa|J_per_m)$", name)
        kinds.setdefault(unit[1] if unit else name, []).append(name)
    tables = [[np.stack([it[name] for name in names]) for names in kinds.values()] for it in (one, two)]
    return max(map(difference, *tables))


def wait_for_all(comm: MPI.Intracomm) -> None:
    """A barrier at which ranks sleep: those that have nothing to do shall not take the time of those that have."""
    request = comm.Ibarrier()
    while not request.Test():
        sleep(0.01)


def all_pairs(tables: dict[str, Any], folder: Path) -> list[tuple[int, int, float, bool]]:
    """Every pair of numbers of ranks up to those at hand, the first half of a run on the one, the second on the other.

    Returns:
        Both numbers, how much the history differs from that of a run on the second number of ranks, and whether the
        files are the same; on rank 0.
    """
    world, scene = MPI.COMM_WORLD, parse_scene(tables)
    numbers = range(1, world.size + 1)
    found = []
    for ranks in numbers:
        some = world.Split(int(world.rank < ranks))
        if world.rank < ranks:
            run(scene, folder / f"whole_{ranks}", comm=some)
            first_half(scene, folder / f"half_{ranks}", some)
        wait_for_all(world)
        some.Free()
    for first in numbers:
        for second in numbers:
            whole, halves = folder / f"whole_{second}", folder / f"{first}_{second}"
            if world.rank == 0:
                shutil.copytree(folder / f"half_{first}", halves)
            some = world.Split(int(world.rank < second))
            if world.rank < second:
                assert run(scene, halves, resume=True, comm=some).reason is None
            if world.rank == 0:
                same = (whole / "history.csv").read_bytes() == (halves / "history.csv").read_bytes()
                found.append((first, second, differences(whole, halves), same))
            wait_for_all(world)
            some.Free()
    return found


if __name__ == "__main__":
    pairs = all_pairs(json.loads(sys.argv[1]), Path(sys.argv[2]))
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(np.array(pairs).tolist()))


def scene_of(kind: str, tmp_path: Path) -> dict[str, Any]:
    """Tables of a scene by its kind or element."""
    if kind == "layer":
        return LAYER
    if kind == "classical":
        return change(COMPRESSION, {"effects.polar": False})
    file = write_msh(tmp_path / f"{kind}.msh", square(3, 4, ELEMENTS[kind]))
    mesh = {"geometry": {"kind": "mesh", "file": str(file), "scale": 0.02}, "solver": {"element": kind}}
    return change(COMPRESSION, mesh)
