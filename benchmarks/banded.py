"""A biaxial specimen with a shear band on any mesh: the demo's state past the peak, carried over to finer cells."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from cosserat_fx import plane
from cosserat_fx._compat import MPI
from cosserat_fx.plane import Plane
from cosserat_fx.problem import Problem
from cosserat_fx.scene import PlaneScene, parse_scene
from cosserat_fx.typing import Array

DEMO = Path(__file__).parents[1] / "demos" / "biaxial.toml"
CELLS = 16, 56


class Band(NamedTuple):
    """A state with a band on the demo's mesh.

    Attributes:
        travel: along the path (m).
        committed, increment: of u1, u2 and w at the nodes, (nodes, 3) with those along x1 first (m and rad).
        forces: (cells, n) stresses and couple stresses, likewise.
        void_ratio: (cells,) likewise.
    """

    travel: float
    committed: Array
    increment: Array
    forces: Array
    void_ratio: Array

    def save(self, file: Path) -> None:
        """Write it to a file of NumPy's (npz)."""
        np.savez(file, **self._asdict())

    @classmethod
    def load(cls, file: Path) -> Band:
        """Read what :meth:`save` wrote."""
        with np.load(file) as kept:
            return cls(**{name: kept[name] for name in cls._fields} | {"travel": float(kept["travel"])})


def scene(cells: tuple[int, int] = CELLS, element: str = "Q1R", **solver: Any) -> PlaneScene:
    """The demo with other cells and without output."""
    tables = tomllib.loads(DEMO.read_text())
    tables["geometry"]["cells"] = list(cells)
    tables["output"] = {"fields": False, "figures": False, "checkpoints": "off"}
    tables["solver"] = {"element": element, **solver}
    parsed = parse_scene(tables)
    assert isinstance(parsed, PlaneScene)
    return parsed


def band(travel: float = 0.008) -> Band:
    """Walk the demo, by default past its peak.

    Args:
        travel: of the platen, beyond which the walk ends (m).
    """
    body = plane.build(scene(), MPI.COMM_SELF)
    last = None
    for step in body.stepper:
        last = body.stepper.last
        if step.travel - body.path.start >= travel:
            break
    assert last is not None
    problem, state = body.problem, body.problem.state
    by_cell = _by_place(state.coordinates)
    fields = problem.fields.values()
    by_node = [_by_place(f.coordinates) for f in fields]
    committed, increment = (
        np.stack([values[f.dofs[rows]] for f, rows in zip(fields, by_node, strict=True)], axis=1)
        for values in (problem.committed.x.array, last.unknown)
    )
    rows = state.points[by_cell]
    return Band(body.stepper.position.travel, committed, increment, state.forces_n[rows], state.e_n[rows])


def put_on(band: Band, body: Plane, share: float = 0.5) -> None:
    """Give a finer body the state, and a part of the band's last increment as its unknown. One rank.

    Args:
        band: the state.
        body: as :func:`scene` describes it.
        share: of the increment.
    """
    problem, state = body.problem, body.problem.state
    size = problem.geometry.extent()[1]
    cells = np.clip((state.coordinates / size * CELLS).astype(int), 0, np.array(CELLS) - 1)
    rows = cells[:, 0] + CELLS[0] * cells[:, 1]
    state.forces_n[state.points] = band.forces[rows]
    state.e_n[state.points] = band.void_ratio[rows]
    state.roll_back()
    _interpolate(problem, band.committed, problem.committed.x.array, size)
    move = np.zeros_like(problem.committed.x.array)
    _interpolate(problem, band.increment, move, size)
    problem.apply(band.travel)
    problem.unknown.x.array[:] = problem.committed.x.array + share * move
    problem.unknown.x.scatter_forward()
    held = problem.prescribed
    held.values[:] = problem.unknown.x.array[held.dofs]


def _by_place(coordinates: Array) -> Array:
    """Order of places on a grid, along x1 first."""
    return np.lexsort(np.round(coordinates.T / 1e-9))


def _interpolate(problem: Problem, nodal: Array, into: Array, size: Array) -> None:
    """Write bilinear interpolants of the demo's nodal values into an array of the problem's unknowns."""
    axes = tuple(np.linspace(0, length, n + 1) for length, n in zip(size, CELLS, strict=True))
    for column, part in enumerate(problem.fields.values()):
        grid = nodal[:, column].reshape(CELLS[1] + 1, CELLS[0] + 1).T
        into[part.dofs] = RegularGridInterpolator(axes, grid)(np.clip(part.coordinates, 0, size))
