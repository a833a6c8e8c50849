"""Plane specimens with shear bands that are known exactly, as the means of cells on several kinds of meshes."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from cosserat_fx.output.plane_fields import PlaneState
from cosserat_fx.typing import Array

WIDTH, HEIGHT, D50 = 0.04, 0.14, 1e-3
MIDDLE = np.array([0.02, 0.072])
BACKGROUND, AMPLITUDE = 0.05, 1.45

type Field = Callable[[Array], Array]
type Kind = Literal["even", "graded", "distorted", "triangles"]


def frame(angle: float) -> tuple[Array, Array]:
    """Unit vectors along and across a band at an angle to x1 (degrees)."""
    cosine, sine = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.array([cosine, sine]), np.array([-sine, cosine])


def gauss(distance: Array) -> Array:
    """A profile of width 1 at half of its maximum 1."""
    return np.asarray(np.exp(-4 * np.log(2) * distance**2))


def sech2(distance: Array) -> Array:
    """The same with longer tails."""
    return np.asarray(np.cosh(2 * np.arccosh(np.sqrt(2)) * distance) ** -2.0)


def band(
    angle: float,
    width: float,
    *,
    profile: Field = gauss,
    middle: Array = MIDDLE,
    background: float = BACKGROUND,
    amplitude: float = AMPLITUDE,
) -> Field:
    """The shear strain of a straight band, of a width (m) at half of its amplitude above the background."""
    across = frame(angle)[1]
    return lambda points: background + amplitude * profile((points - middle) @ across / width)


def thickness(width: float, profile: Field) -> float:
    """Width at half of the maximum, background included (m)."""
    distance = np.linspace(0.0, 3.0, 300_001)
    value = BACKGROUND + AMPLITUDE * profile(distance)
    return float(2 * width * distance[np.argmax(value < value[0] / 2)])


def mesh(size: float, kind: Kind = "even") -> tuple[Array, np.ndarray[tuple[int, int], np.dtype[np.int64]]]:
    """Points and cells of a size (m): rows twice as high at the ends when graded, nodes moved when distorted."""
    nx, ny = round(WIDTH / size), round(HEIGHT / size)
    place = np.linspace(-1.0, 1.0, ny + 1)
    stretched = (place + place**3) / 2 if kind == "graded" else place
    x, y = np.linspace(0.0, WIDTH, nx + 1), HEIGHT / 2 * (1 + stretched)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    first = ((nx + 1) * np.arange(ny)[:, None] + np.arange(nx)).reshape(-1)
    quads = np.stack([first, first + 1, first + nx + 2, first + nx + 1], axis=1)
    if kind == "triangles":
        return points, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    if kind == "distorted":
        edge = np.any(np.isclose(points, 0.0) | np.isclose(points, [WIDTH, HEIGHT]), axis=1)
        points = points + ~edge[:, None] * np.random.default_rng(2).uniform(-0.25, 0.25, points.shape) * size
    return points, quads


def specimen(
    strain: Field,
    size: float = 0.0025,
    kind: Kind = "even",
    *,
    displacement: Field = np.zeros_like,
    travel: float = 0.0,
) -> PlaneState:
    """A specimen with the means of a shear strain over its cells, and the rotation of -strain/2 at its nodes."""
    points, cells = mesh(size, kind)
    a, b = (grid.reshape(-1) for grid in np.meshgrid(*2 * [(np.arange(6) + 0.5) / 6]))
    if cells.shape[1] == 4:
        shapes = np.stack([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b], axis=1)
    else:
        a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
        shapes = np.stack([1 - a - b, a, b], axis=1)
    means = strain(np.einsum("qk,mki->mqi", shapes, points[cells])).mean(axis=1)
    return PlaneState(
        travel=travel,
        points=points,
        cells=cells,
        displacement=displacement(points),
        rotation=-strain(points) / 2,
        means={"shear_strain": means, "void_ratio": 0.6 + 0.1 * means / (1 + means)},
    )


def boundaries() -> dict[str, Array]:
    """The specimen's sides, as facets of 2.5 mm."""
    corners = {"bottom": (0, 0, 1, 0), "right": (1, 0, 1, 1), "top": (0, 1, 1, 1), "left": (0, 0, 0, 1)}
    sides = {}
    for name, (x0, y0, x1, y1) in corners.items():
        count = 16 if y0 == y1 else 56
        ends = np.linspace([x0 * WIDTH, y0 * HEIGHT], [x1 * WIDTH, y1 * HEIGHT], count + 1)
        sides[name] = np.stack([ends[:-1], ends[1:]], axis=1)
    return sides
