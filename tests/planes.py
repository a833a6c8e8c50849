"""Plane bodies for tests: meshes of the unit square that no element likes, and scenes to change and walk through."""

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from body import Body
from meshes import Mesh, identity, square, write_msh
from scenes import change

from cosserat_fx import plane
from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.elements import Element
from cosserat_fx.geometry import distribute
from cosserat_fx.plane import Plane
from cosserat_fx.problem import Problem
from cosserat_fx.scene import PlaneScene, parse_scene
from cosserat_fx.typing import Array

Shape = Callable[[Array], Array]
PRESSURE, D50 = 100e3, 1e-3


def inside(points: Array) -> Array:
    """(n, 1), 1 for points inside the unit square and 0 for those on its sides."""
    return np.asarray(np.all((points > 1e-9) & (points < 1 - 1e-9), axis=1, keepdims=True).astype(float))


def even(n: int) -> Shape:
    """Cells that are all alike."""
    return identity


def scattered(n: int) -> Shape:
    """Corners inside moved at random by up to a fifth of the size of a cell, which no refinement makes milder."""
    return lambda at: at + inside(at) * np.random.default_rng(3).uniform(-0.2, 0.2, at.shape) / n


def zigzag(n: int) -> Shape:
    """Corners inside moved to and fro in the pattern of the hourglass mode."""

    def move(at: Array) -> Array:
        number = np.rint(n * at)
        signs = np.stack([(-1) ** number.sum(axis=1), (-1) ** number[:, 0]], axis=1)
        return np.asarray(at + inside(at) * 0.15 / n * signs)

    return move


def to_dolfinx(mesh: Mesh) -> dolfinx.mesh.Mesh:
    """A mesh on this rank alone."""
    triangles = mesh.kind == "triangle"
    cells = mesh.cells if triangles else mesh.cells[:, [0, 1, 3, 2]]
    return distribute(MPI.COMM_SELF, "triangle" if triangles else "quadrilateral", mesh.points, cells)


def kind(element: Element) -> str:
    """The cells of an element as the files' formats call them."""
    return "triangle" if element.cell == "triangle" else "quad"


def elastic_body(element: Element, n: int, shape: Callable[[int], Shape] = even, *, polar: bool = True) -> Body:
    """The unit square, n by n cells (or twice as many triangles), of small strains."""
    mesh = to_dolfinx(square(n, n, kind(element), shape(n), shuffled=False))
    return Body(mesh, "plane", polar=polar, finite=False, degree=element.degree, order=element.order)


# -- scenes ------------------------------------------------------------------------------------------------------------

BASE: dict[str, Any] = {
    "geometry": {"kind": "rectangle", "width": 0.02, "height": 0.02, "cells": [4, 4]},
    "material": {"d50": D50},
    "initial": {"stress": -PRESSURE, "void_ratio": 0.6},
    "effects": {"finite_strain": True},
}
"""Four by four elements of five grain diameters of sand under 100 kPa, of finite strain, without conditions."""

BIAXIAL: dict[str, Any] = {
    "boundaries": {
        "bottom": {"u2": 0.0},
        "top": {"u2": -0.001},
        "left": {"pressure": PRESSURE},
        "right": {"pressure": PRESSURE},
    },
    "points": {"pin": {"at": [0.0, 0.0], "u1": 0.0}},
}
"""Changes that compress it between smooth plates."""
DEMO: dict[str, Any] = tomllib.loads((Path(__file__).parents[1] / "demos" / "biaxial.toml").read_text())
"""The demo with a shear band."""


def on_file(file: Path, mesh: Mesh, scale: float = 0.02) -> dict[str, Any]:
    """Changes of a scene that put it on a mesh, which is written to a file."""
    return {"geometry": {"kind": "mesh", "file": str(write_msh(file, mesh)), "scale": scale}}


def build(changes: dict[str, Any], base: dict[str, Any] = BASE) -> Plane:
    """The body of a changed base on this rank."""
    scene = parse_scene(change(base, changes))
    assert isinstance(scene, PlaneScene)
    return plane.build(scene, MPI.COMM_SELF)


def run(changes: dict[str, Any]) -> Problem:
    """The problem of a scene at its end."""
    body = build(changes)
    for _ in body.stepper:
        pass
    return body.problem


def visits(body: Plane) -> Iterator[tuple[float, Problem]]:
    """Travel of the scene (m) and problem after each step, and at first before all of them."""
    body.problem.apply(body.path.corners[0])
    yield body.path.corners[0] - body.path.start, body.problem
    for step in body.stepper:
        yield step.travel - body.path.start, body.problem


def stress(problem: Problem, i: int, j: int) -> Array:
    """(m,) a stress at the points (Pa)."""
    return np.asarray(problem.state.forces_n[problem.state.points, problem.layout.stress_index(i, j)])
