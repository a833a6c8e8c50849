"""Meshes of a rectangle to compare elements on: squares or triangles, even or distorted, as Gmsh files."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

import meshio
import numpy as np
import numpy.typing as npt

from cosserat_fx.typing import Array

Pattern = Literal["squares", "rising", "falling", "alternating", "crossed"]
"""Squares, or triangles: each square cut along its rising or falling diagonal, alternating ones or both of them."""
PATTERNS: tuple[Pattern, ...] = get_args(Pattern)

Indices = npt.NDArray[np.int64]


def write_rectangle(
    file: Path,
    size: tuple[float, float],
    cells: tuple[int, int],
    pattern: Pattern,
    *,
    distortion: float = 0.0,
    seed: int = 0,
) -> None:
    """Write a mesh with the boundaries "bottom", "top", "left" and "right".

    The squares' corners come first, row by row; where both diagonals cut, their crossings follow.

    Args:
        file: a name that ends in .msh.
        size: width and height (m).
        cells: numbers of squares along both.
        pattern: of the cells.
        distortion: by how much of a square's side every inner corner is moved at most along each axis.
        seed: of the moves; the same for all patterns.
    """
    number = np.arange((cells[0] + 1) * (cells[1] + 1), dtype=np.int64).reshape(cells[1] + 1, cells[0] + 1)
    x, y = np.meshgrid(*(np.linspace(0, length, n + 1) for length, n in zip(size, cells, strict=True)))
    corners = np.stack([x, y], axis=-1)
    moves = np.random.default_rng(seed).uniform(-1, 1, (cells[1] - 1, cells[0] - 1, 2))
    corners[1:-1, 1:-1] += distortion * np.array(size) / cells * moves
    points = corners.reshape(-1, 2)
    squares = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1)
    if pattern == "crossed":
        points = np.concatenate([points, points[squares].mean(axis=2).reshape(-1, 2)])
    elements = _cut(squares, pattern, first_centre=number.size)
    sides = {"bottom": number[0], "top": number[-1], "left": number[:, 0], "right": number[:, -1]}
    lines = np.concatenate([np.stack([nodes[:-1], nodes[1:]], axis=1) for nodes in sides.values()])
    tags = np.repeat(np.arange(1, 5), [len(nodes) - 1 for nodes in sides.values()])
    body = np.full(len(elements), 5)
    meshio.Mesh(
        np.pad(points, ((0, 0), (0, 1))),
        [("line", lines), ("triangle" if elements.shape[1] == 3 else "quad", elements)],
        cell_data={name: [tags, body] for name in ("gmsh:physical", "gmsh:geometrical")},
        field_data={name: np.array([tag, 1]) for tag, name in enumerate(sides, start=1)} | {"body": np.array([5, 2])},
    ).write(file, file_format="gmsh22", binary=False)


def _cut(squares: Indices, pattern: Pattern, *, first_centre: int) -> Indices:
    """The cells of a pattern, their corners going around.

    Args:
        squares: (rows, columns, 4) corners.
        pattern: how to cut them.
        first_centre: number of the first square's middle, where the pattern has it.
    """
    flat = squares.reshape(-1, 4)
    if pattern == "squares":
        return flat
    if pattern == "crossed":
        centre = first_centre + np.arange(len(flat))
        return np.concatenate([np.stack([flat[:, k], flat[:, (k + 1) % 4], centre], axis=1) for k in range(4)])
    rows, columns = np.indices(squares.shape[:2])
    odd = (rows + columns).reshape(-1) % 2 == 1
    falling = {"rising": np.zeros_like(odd), "falling": ~np.zeros_like(odd), "alternating": odd}[pattern]
    turned = np.where(falling[:, None], np.roll(flat, -1, axis=1), flat)
    return np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]])


def alternating_part(nodal: Array, cells: tuple[int, int]) -> Array:
    """The part of a nodal field that changes its sign from node to node along both axes, at the inner corners.

    It is the field weighted with (1, -2, 1)/4 along each axis: the amplitude a of a pure sawtooth of +a and -a, and
    h^4 f,xxyy/16 of a smooth field on squares of side h.

    Args:
        nodal: (n,) values at the nodes of :func:`write_rectangle`'s mesh, those beyond the squares' corners left out.
        cells: numbers of squares along both axes.
    """
    field = nodal[: (cells[0] + 1) * (cells[1] + 1)].reshape(cells[1] + 1, cells[0] + 1)
    along_x = (field[:, :-2] - 2 * field[:, 1:-1] + field[:, 2:]) / 4
    alternating: Array = (along_x[:-2] - 2 * along_x[1:-1] + along_x[2:]) / 4
    return alternating
