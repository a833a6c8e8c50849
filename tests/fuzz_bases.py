"""Valid scenes, as tables and with mesh files of each format, for others to break."""

from __future__ import annotations

import contextlib
import json
import struct
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pyvista
from meshes import GMSH_TYPES, Mesh, square, write_msh
from scenes import RECTANGLE, change


@dataclass
class Case:
    """A scene with the files it names.

    Attributes:
        files: contents by name; the scene is "scene.toml".
        overrides: as on the command line.
    """

    files: dict[str, bytes]
    overrides: list[str] = field(default_factory=list)


def toml(value: object) -> str:
    """A value as TOML spells it; tables inline but for the outermost."""
    match value:
        case bool():
            return str(value).lower()
        case dict():
            return "{" + ", ".join(f"{quoted(key)} = {toml(inner)}" for key, inner in value.items()) + "}"
        case list() | tuple():
            return "[" + ", ".join(toml(inner) for inner in value) + "]"
        case str():
            return quoted(value)
        case float() | int():
            return repr(value) if abs(value) < 10**4000 else "9" * 5000
        case _:
            return str(value)


def quoted(text: str) -> str:
    """A text as TOML spells it."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def document(tables: Mapping[str, object]) -> bytes:
    """Tables as a TOML document."""
    return "".join(f"{quoted(key)} = {toml(value)}\n" for key, value in tables.items()).encode()


LAYER: dict[str, Any] = {
    "title": "a layer",
    "geometry": {"kind": "layer", "height": 0.04, "cells": 20},
    "material": {"constants": "paper-sand", "d50": 0.5e-3, "phi_c": 30.0},
    "initial": {
        "stress": -100e3,
        "void_ratio": 0.6,
        "zones": [{"y": [0.0, 0.01], "void_ratio": 0.7}],
        "random": {"standard_deviation": 0.01, "correlation_length_d50": 4.0, "seed": 1},
    },
    "weight": {"density": 1600.0, "gravity": 9.81},
    "walls": {
        "bottom": {"rolling": 0.0, "shear_displacement": 0.0},
        "top": {"f_u": 0.8, "f_r": 0.1, "f_s": 0.1, "normal_stress": -100e3, "shear_displacement": [0.01, 0.0, 0.02]},
    },
    "effects": {"polar": True, "finite_strain": "auto", "spin": "macro", "void_ratio": True},
    "stepping": {
        "min_step": 1e-6,
        "first_step": 1e-5,
        "max_step": 1e-3,
        "tolerance": 0.1,
        "strain": 0.3,
        "max_steps": 1000,
        "branch": "primary",
    },
    "solver": {
        "integration_points": 2,
        "newton_tolerance": 1e-9,
        "max_iterations": 25,
        "linear": "direct",
        "petsc": {"snes_rtol": 0.0},
    },
    "output": {"profiles_at": [0.005, 0.01], "fields": True, "figures": False},
}
PLANE: dict[str, Any] = change(
    RECTANGLE,
    {
        "title": "a rectangle",
        "geometry.grading": {"x": {"fine": "left", "ratio": 2.0}, "y": {"fine": "ends", "ratio": 3.0}},
        "material": {"d50": 2e-3, "a_c": 1.0},
        "initial.zones": [
            {"x": [0.0, 0.01], "void_ratio": 0.7},
            {"centre": [0.02, 0.07], "radius": 0.01, "void_ratio": 0.7},
        ],
        "initial.field": {"file": "field.csv"},
        "boundaries.top": {"wall": {"u1": [0.001, 0.002], "u2": [-0.001, -0.002], "rolling": 0.1}},
        "boundaries.left": {
            "t1": {"travel": [0.0, 0.001, 0.002], "value": [1e5, 2e5, 1e5]},
            "rotational_resistance": 1.0,
        },
        "boundaries.right": {"pressure": 100e3, "couple": [0.0, 1.0]},
        "solver": {"element": "Q1", "hourglass": 0.01, "local_tolerance": 1e-3},
        "output": {
            "fields_at": [0.001],
            "frames": 4,
            "animation": False,
            "columns": {"force": {"boundary": "top", "quantity": "force2", "factor": -1.0}},
        },
    },
)  # fmt: skip
FIELD = b"x_m,y_m,void_ratio\n0.0,0.0,0.6\n0.04,0.0,0.62\n0.0,0.14,0.64\n0.04,0.14,0.66\n0.02,0.07,0.61\n"


def mesh_scene(name: str, sides: Mapping[str, str]) -> dict[str, Any]:
    """A square of a mesh file, pressed; its boundaries go by other names in some formats."""
    conditions = {"bottom": {"u2": 0.0}, "top": {"u2": -0.01}, "left": {"pressure": 1e5}, "right": {"pressure": 1e5}}
    return {
        "geometry": {"kind": "mesh", "file": name},
        "material": {"d50": 0.05},
        "initial": {"stress": -1e5, "void_ratio": 0.6},
        "boundaries": {sides[side]: condition for side, condition in conditions.items()},
        "points": {"pin": {"at": [0.0, 0.0], "u1": 0.0}},
    }


def mesh_cases() -> dict[str, Case]:
    """A valid scene with a mesh file of each format, by the format's name."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(None), contextlib.redirect_stderr(None):
        files = _mesh_files(Path(folder))
        named = {side: side for side in ("bottom", "top", "left", "right")}
        numbered = {side: str(number) for number, side in enumerate(named, start=1)}
        return {
            kind: Case(
                {
                    "scene.toml": document(mesh_scene(file.name, named if file.suffix == ".msh" else numbered)),
                    file.name: file.read_bytes(),
                }
            )
            for kind, file in files.items()
        }


def _mesh_files(folder: Path) -> dict[str, Path]:
    """The same square in each format."""
    body = square(3, 3)
    files = {version: write_msh(folder / f"ascii{version}.msh", body, version) for version in ("2.2", "4.1")}
    raw = meshio.read(files["4.1"])
    raw.write(folder / "binary2.2.msh", file_format="gmsh22", binary=True)
    (folder / "binary4.1.msh").write_bytes(_binary_msh(body))
    raw.cell_sets = {}
    raw.point_data, groups = {}, {"gmsh:physical": raw.cell_data["gmsh:physical"]}
    raw.cell_data = groups
    raw.write(folder / "ascii.vtu", binary=False)
    raw.write(folder / "binary.vtu", compression=None)
    raw.write(folder / "compressed.vtu", compression="zlib")
    grid = pyvista.from_meshio(raw)
    grid.save(folder / "appended.vtu", binary=True)
    items = [np.insert(block.data, 0, 2 if block.type == "line" else 5, axis=1) for block in raw.cells]
    lines = [f"2 {row}" if row.startswith("2 ") else row for block in items for row in _rows(block)]
    (folder / "text.xdmf").write_text(_XDMF.format(
        cells=sum(len(block) for block in items), size=sum(len(line.split()) for line in lines),
        topology="\n".join(lines), nodes=len(raw.points), points="\n".join(_rows(raw.points)),
        groups="\n".join(_rows(np.concatenate(groups["gmsh:physical"])[:, None])),
    ))  # fmt: skip
    return files | {
        f"{file.stem} {file.suffix}": file for file in sorted(folder.iterdir()) if file not in files.values()
    }


def _binary_msh(mesh: Mesh) -> bytes:
    """A binary file of Gmsh 4.1."""
    groups = [(1, "line", name, pairs) for name, pairs in mesh.lines.items()]
    groups += [(2, mesh.kind, name, mesh.cells[members]) for name, members in mesh.regions.items()]
    tagged = list(enumerate(groups, start=1))
    names = "\n".join(f'{dim} {tag} "{name}"' for tag, (dim, _, name, _) in tagged)
    nodes, elements = len(mesh.points), sum(len(members) for *_, members in groups)
    content = b"$MeshFormat\n4.1 1 8\n" + struct.pack("<i", 1) + b"\n$EndMeshFormat\n"
    content += f"$PhysicalNames\n{len(groups)}\n{names}\n$EndPhysicalNames\n$Entities\n".encode()
    content += struct.pack("<4Q", 0, len(mesh.lines), len(mesh.regions), 0)
    content += b"".join(struct.pack("<i6dQiQ", tag, *[0.0] * 6, 1, tag, 0) for tag, _ in tagged)
    content += b"\n$EndEntities\n$Nodes\n" + struct.pack("<4Q3iQ", 1, nodes, 1, nodes, 2, len(groups), 0, nodes)
    content += np.arange(1, nodes + 1).tobytes() + np.pad(mesh.points, ((0, 0), (0, 1))).tobytes()
    content += b"\n$EndNodes\n$Elements\n" + struct.pack("<4Q", len(groups), elements, 1, elements)
    for tag, (dim, kind, _, members) in tagged:
        content += struct.pack("<3iQ", dim, tag, GMSH_TYPES[kind], len(members))
        content += np.insert(members + 1, 0, 1, axis=1).tobytes()
    return content + b"\n$EndElements\n"


def field_cases() -> dict[str, Case]:
    """A valid scene with a void ratio from a file of each kind."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(None), contextlib.redirect_stderr(None):
        body = square(2, 2, "triangle")
        points, data = np.pad(0.1 * body.points, ((0, 0), (0, 1))), "void_ratio"
        at_points = meshio.Mesh(points, [("triangle", body.cells)], {data: np.linspace(0.6, 0.7, len(points))})
        in_cells = meshio.Mesh(points, [("triangle", body.cells)], {}, {data: [np.linspace(0.6, 0.7, len(body.cells))]})
        files = {"points.vtu": at_points, "cells.vtu": in_cells}
        for name, mesh in files.items():
            mesh.write(Path(folder, name), compression=None)
        contents = {name: Path(folder, name).read_bytes() for name in files} | {"field.csv": FIELD}
    return {
        name: Case({"scene.toml": document(change(PLANE, {"initial.field.file": name})), name: content})
        for name, content in contents.items()
    }


def _rows(table: np.ndarray[Any, Any]) -> list[str]:
    return [" ".join(map(repr, row)) for row in table.tolist()]


_XDMF = """<?xml version="1.0"?>
<Xdmf Version="3.0"><Domain><Grid Name="Grid">
<Geometry GeometryType="XYZ"><DataItem DataType="Float" Dimensions="{nodes} 3" Format="XML" Precision="8">
{points}
</DataItem></Geometry>
<Topology TopologyType="Mixed" NumberOfElements="{cells}">
<DataItem DataType="Int" Dimensions="{size}" Format="XML" Precision="8">
{topology}
</DataItem></Topology>
<Attribute Name="gmsh:physical" AttributeType="Scalar" Center="Cell">
<DataItem DataType="Int" Dimensions="{cells}" Format="XML" Precision="4">
{groups}
</DataItem></Attribute>
</Grid></Domain></Xdmf>
"""
