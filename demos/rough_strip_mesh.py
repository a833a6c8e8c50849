"""Makes rough_strip.msh: sand beside a strip, in quadrilaterals that are narrow at the strip.

A mesh for a scene needs cells in the plane of x1 and x2, and groups with names: groups of lines become boundaries,
groups of cells become regions. Any mesh generator does; this script needs numpy and meshio alone.

    python demos/rough_strip_mesh.py [FILE]
"""

import sys
from pathlib import Path

import meshio
import numpy as np

WIDTH, HEIGHT = 40.0, 80.0  # mm, of the sand beside the strip
COLUMNS, ROWS = 23, 40
RATIO = 3.0  # of the widest column over the narrowest, which is at the strip
NEAR = 10.0  # mm, reach of the region near the strip
GROUPS = {"strip": 1, "far": 1, "bottom": 1, "top": 1, "near": 2, "beyond": 2}  # with their dimensions


def make() -> meshio.Mesh:
    widths = np.geomspace(1.0, RATIO, COLUMNS)
    x = WIDTH / widths.sum() * np.concatenate([[0.0], np.cumsum(widths)])
    y = np.linspace(0.0, HEIGHT, ROWS + 1)
    points = np.array([[a, b, 0.0] for b in y for a in x])

    node = np.arange(len(points)).reshape(ROWS + 1, COLUMNS + 1)
    quads = np.stack([node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]], axis=-1).reshape(-1, 4)
    near = points[quads, 0].mean(axis=1) < NEAR
    sides = {"strip": node[:, 0], "far": node[:, -1], "bottom": node[0], "top": node[-1]}

    blocks = [("line", np.stack([line[:-1], line[1:]], axis=1)) for line in sides.values()]
    blocks += [("quad", quads[near]), ("quad", quads[~near])]
    numbers = [np.full(len(cells), number, dtype=np.int32) for number, (_, cells) in enumerate(blocks, start=1)]
    return meshio.Mesh(
        points,
        blocks,
        cell_data={"gmsh:physical": numbers, "gmsh:geometrical": numbers},
        field_data={name: np.array([number, dim]) for number, (name, dim) in enumerate(GROUPS.items(), start=1)},
    )


if __name__ == "__main__":
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("rough_strip.msh")
    meshio.write(file, make(), file_format="gmsh22", binary=False, float_fmt=".4f")
