"""Plane meshes and the Gmsh files that hold them, for tests."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cosserat_fx.typing import Array

Indices = npt.NDArray[np.int64]

GMSH_TYPES = {"line": 1, "triangle": 2, "quad": 3}


@dataclass
class Mesh:
    """Points (n, 2 or 3), cells of one kind with corners around, and named lines and cells."""

    points: Array
    cells: Indices
    lines: dict[str, Indices] = field(default_factory=dict)
    regions: dict[str, Indices] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        return "triangle" if self.cells.shape[1] == 3 else "quad"


def identity(points: Array) -> Array:
    return points


def skewed(points: Array) -> Array:
    """Moves points of the unit square a little, edges along themselves only, corners not at all."""
    x, y = points.T
    return np.stack(
        [x + 0.06 * np.sin(np.pi * x) * np.cos(5 * y), y + 0.06 * np.sin(np.pi * y) * np.cos(4 * x)], axis=1
    )


def quarter_ring(points: Array) -> Array:
    """The unit square bent into a ring between the radii 1 (left) and 2 (right), from x1 (bottom) to x2 (top)."""
    radius, angle = 1 + points[:, 0], np.pi / 2 * points[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def square(
    nx: int, ny: int, kind: str = "quad", shape: Callable[[Array], Array] = identity, *, shuffled: bool = True
) -> Mesh:
    """The unit square, mapped, with its four sides and the regions "lower" and "upper" (from x2 = 1/2 on)."""
    x, y = np.meshgrid(np.linspace(0, 1, nx + 1), np.linspace(0, 1, ny + 1))
    number = np.arange(x.size).reshape(x.shape)
    cells = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    if kind == "triangle":
        cells = np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])
    ends = {"bottom": number[0], "top": number[-1], "left": number[:, 0], "right": number[:, -1]}
    lines = {name: np.stack([nodes[:-1], nodes[1:]], axis=1) for name, nodes in ends.items()}
    points = np.stack([x, y], axis=-1).reshape(-1, 2)
    upper = points[cells].mean(axis=1)[:, 1] > 0.5
    new = np.random.default_rng(1).permutation(len(points)) if shuffled else np.arange(len(points))
    moved = np.empty_like(points)
    moved[new] = shape(points)
    return Mesh(
        moved,
        new[cells],
        {name: new[pairs] for name, pairs in lines.items()},
        {"lower": np.flatnonzero(~upper), "upper": np.flatnonzero(upper)},
    )


def write_msh(file: Path, mesh: Mesh, version: str = "4.1", *, names: bool = True) -> Path:
    """Writes an ASCII file of Gmsh 2.2 or 4.1 whose physical groups are the mesh's lines and regions."""
    groups = [(1, "line", name, pairs) for name, pairs in mesh.lines.items()]
    groups += [(2, mesh.kind, name, mesh.cells[members]) for name, members in mesh.regions.items()]
    points = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1])))
    text = [f"$MeshFormat\n{version} 0 8\n$EndMeshFormat"]
    if names:
        text += [f"$PhysicalNames\n{len(groups)}"]
        text += [f'{dim} {tag} "{name}"' for tag, (dim, _, name, _) in enumerate(groups, start=1)]
        text += ["$EndPhysicalNames"]
    text += _version_2(points, groups) if version == "2.2" else _version_4(points, groups)
    file.write_text("\n".join(text) + "\n")
    return file


Groups = list[tuple[int, str, str, Indices]]


def _version_2(points: Array, groups: Groups) -> list[str]:
    text = [
        f"$Nodes\n{len(points)}",
        *(f"{n} {x!r} {y!r} {z!r}" for n, (x, y, z) in enumerate(points.tolist(), start=1)),
    ]
    text += [f"$EndNodes\n$Elements\n{sum(len(members) for *_, members in groups)}"]
    element = 0
    for tag, (_, kind, _, members) in enumerate(groups, start=1):
        for nodes in members:
            element += 1
            text.append(f"{element} {GMSH_TYPES[kind]} 2 {tag} {tag} {' '.join(str(n + 1) for n in nodes)}")
    return [*text, "$EndElements"]


def _version_4(points: Array, groups: Groups) -> list[str]:
    count: Mapping[int, int] = {dim: sum(d == dim for d, *_ in groups) for dim in (1, 2)}
    text = [f"$Entities\n0 {count[1]} {count[2]} 0"]
    text += [f"{tag} 0 0 0 0 0 0 1 {tag} 0" for tag, _ in enumerate(groups, start=1)]
    text += [f"$EndEntities\n$Nodes\n1 {len(points)} 1 {len(points)}\n2 {len(groups)} 0 {len(points)}"]
    text += [str(n + 1) for n in range(len(points))]
    text += [f"{x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    total = sum(len(members) for *_, members in groups)
    text += [f"$EndNodes\n$Elements\n{len(groups)} {total} 1 {total}"]
    element = 0
    for tag, (dim, kind, _, members) in enumerate(groups, start=1):
        text.append(f"{dim} {tag} {GMSH_TYPES[kind]} {len(members)}")
        for nodes in members:
            element += 1
            text.append(f"{element} {' '.join(str(n + 1) for n in nodes)}")
    return [*text, "$EndElements"]
