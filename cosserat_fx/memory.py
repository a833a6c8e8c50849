"""Memory that a run is going to take, estimated from sizes alone, and the refusal of scenes that do not fit.

The figures were measured with MUMPS on one rank, on rectangles of 2,000 to 400,000 cells and layers of 1,000 to
400,000: the memory allocated for the factors (its INFOG(19)), and the largest resident memory of set-up and two linear
solutions. The factors of a plane body grow as n log2 m, as in nested dissection, with its n unknowns and the m of a
square whose sides are as long as its shorter one: 160 to 177 bytes for Q1R, Q1 and Q2Q1, 137 to 161 for P1 and P2P1,
and two thirds of that without rotations. Those of a layer take 464 bytes an unknown. The estimate of the whole was
between 1.0 and 1.2 times what was measured on every mesh, and 0.95 times on one of 57,000 cells with 2 and 3 ranks;
that of the figures 1.3 times for 135 frames of the biaxial demo.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import log2, sqrt
from typing import NamedTuple

import basix

from cosserat_fx._compat import MPI
from cosserat_fx.geometry import Geometry
from cosserat_fx.layout import Dimension, layout
from cosserat_fx.linear_solver import LinearSolver, PetscOption, choose
from cosserat_fx.machine import limit_of_process, memory_of_node
from cosserat_fx.numerics import numerics
from cosserat_fx.scene import LayerScene, PlaneScene, Scene
from cosserat_fx.scenes.plane import MeshGeometry, RectangleGeometry
from cosserat_fx.scenes.refusals import SceneError, line
from cosserat_fx.state import point_record
from cosserat_fx.weakform import Numerics

ROW = {("interval", 1): 9, ("quadrilateral", 1): 27, ("quadrilateral", 2): 40, ("triangle", 1): 21, ("triangle", 2): 30}
"""Non-zeros in a row of the matrix with rotations, in the mean, by cell and order of the displacement."""
NONZERO = 12
"""Bytes of a non-zero: its value and its column."""
FACTORS_OF_LAYER = 470
"""Bytes of the factors of an unknown of a layer."""
FACTORS_OF_FIELD = 58
"""Bytes of the factors of a plane body, per n log2 m and field (of which there are two without rotations)."""
FACTORS_OF_RANKS = 0.4
"""Growth of the factors with each doubling of the ranks that share them."""
NODE, POINT = 1000, 300
"""Bytes of mesh, degrees of freedom and vectors per node, and of what is evaluated per quadrature point."""
COPY = 100
"""Bytes per node of the mesh that every rank holds a copy of while the mesh is shared out."""
PROCESS = 300e6
"""Bytes of a rank that has loaded all libraries and done nothing yet."""
SNAPSHOT, PICTURE, PROFILE = 200, 1.4e6, 300
"""Bytes of a plane body's snapshot per cell and of its picture in an animation, and of a layer's profile per cell, all
of which are held together while figures are drawn."""
MULTIGRID = 1000
"""Bytes of an unknown that the iterative solver takes: 500 for the matrix' blocks and coarser ones (measured with
25,000 to 270,000 unknowns), the rest for some sixty vectors, which hard systems need."""
_FACTORS_ALONE = LinearSolver("direct", "")
_FACTORS_BESIDE = LinearSolver("iterative", "", beside=True)


class Sizes(NamedTuple):
    """What a mesh amounts to."""

    dimension: Dimension
    cell: str
    """Name of its cells."""
    nodes: int
    """Number of corners of cells."""
    cells: int
    """Number of cells."""
    across: float
    """Number of nodes along its shorter side, about."""


@dataclass(frozen=True)
class Footprint:
    """Memory that a run takes on all ranks together (bytes).

    Attributes:
        state: at the quadrature points.
        matrix: the Jacobian.
        factors: of the Jacobian; 0 where none are made.
        multigrid: and vectors of the iterative solver; 0 where there is none.
        figures: what is read again to be drawn at the end.
        rest: mesh, fields, and the program itself.
    """

    state: float
    matrix: float
    factors: float
    multigrid: float
    figures: float
    rest: float

    @property
    def total(self) -> float:
        """All of it (bytes)."""
        return float(sum(asdict(self).values()))

    def __str__(self) -> str:
        """The total and its parts."""
        parts = {name.replace("rest", "mesh and program"): in_words(size) for name, size in asdict(self).items()}
        return f"{in_words(self.total)} ({', '.join(f'{name} {size}' for name, size in parts.items())})"


def in_words(size: float) -> str:
    """A size in bytes with its unit."""
    scale, unit = (1e9, "GB") if size >= 1e9 else (1e6, "MB")
    return f"{size / scale:.3g} {unit}"


def footprint(
    scene: Scene, chosen: Numerics, sizes: Sizes, *, ranks: int, linear: LinearSolver = _FACTORS_ALONE
) -> Footprint:
    """Estimate the memory of a run.

    Args:
        scene: what it writes and draws.
        chosen: effects, element and quadrature.
        sizes: of the mesh.
        ranks: MPI processes.
        linear: the linear solver.
    """
    dimension, cell, nodes, cells, across = sizes
    components = layout(dimension, polar=chosen.polar, spin=chosen.spin != "none")
    points = cells * len(basix.make_quadrature(basix.CellType[cell], chosen.degree)[1])
    unknowns, fields = _unknowns(chosen, sizes), 2 + chosen.polar
    iterative = linear.kind == "iterative"
    factorised = linear.kind == "direct" or linear.beside
    shared = 1 + FACTORS_OF_RANKS * log2(ranks)
    growth = FACTORS_OF_LAYER / 3 if dimension == "layer" else FACTORS_OF_FIELD * log2(unknowns / nodes * across**2)
    return Footprint(
        state=points * point_record(components, void_ratio=chosen.void_ratio).itemsize,
        matrix=NONZERO * unknowns * ROW[cell, chosen.order] * fields / 3,
        factors=shared * growth * fields * unknowns if factorised else 0.0,
        multigrid=MULTIGRID * unknowns if iterative else 0.0,
        figures=_drawn(scene, cells),
        rest=NODE * nodes + POINT * points + ranks * (COPY * nodes + PROCESS),
    )


def _unknowns(chosen: Numerics, sizes: Sizes) -> int:
    """Number of unknowns on a mesh.

    By Euler's formula a plane body without holes has nodes + cells - 1 sides. Displacements of order 2 have a node on
    each side and, in quadrilaterals, one in the middle.
    """
    _, cell, nodes, cells, _ = sizes
    inner = nodes + cells * (2 if cell == "quadrilateral" else 1) - 1 if chosen.order > 1 else 0
    return 2 * (nodes + inner) + nodes * chosen.polar


def _drawn(scene: Scene, cells: int) -> float:
    """What is held while figures are drawn (bytes)."""
    if not scene.output.figures:
        return 0.0
    if isinstance(scene, LayerScene):
        return PROFILE * cells * len(scene.output.profiles_at or ())
    assert isinstance(scene, PlaneScene)
    snapshots = min(scene.output.frames, scene.stepping.max_steps) + len(scene.output.fields_at or ())
    return scene.output.fields * snapshots * (SNAPSHOT * cells + PICTURE * scene.output.animation)


def available_memory(comm: MPI.Intracomm) -> float:
    """Memory that all ranks together may take (bytes), the same on every rank. Collective.

    Ranks on one node share what it has. A limit on the address space of a process bounds what each rank may add.

    Args:
        comm: the ranks.
    """
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    share = memory_of_node() / node.size
    node.Free()
    return float(comm.allreduce(min(share, limit_of_process())))


def refuse_too_large(
    scene: Scene,
    comm: MPI.Intracomm,
    options: Mapping[str, PetscOption] | None = None,
    body: Geometry | None = None,
) -> LinearSolver | None:
    """Choose a linear solver; refuse a scene whose run takes more memory than there is, before it does. Collective.

    Args:
        scene: of a layer or a plane body.
        comm: the ranks that share it.
        options: PETSc options that go before the scene's own.
        body: the mesh, where it comes from a file; without it, such a scene is not judged.

    Returns:
        The linear solver, which is chosen with an eye to the memory; None where the scene is not judged.

    Raises:
        SceneError: on every rank.
        AdmissibilityError: the element that the scene asks for has other cells.
    """
    sizes = _described(scene) if body is None else sizes_of(body)
    if sizes is None:
        return None
    chosen = numerics(scene, 1.0, sizes.cell)
    there = available_memory(comm)
    factors_fit, beside_fit = (
        footprint(scene, chosen, sizes, ranks=comm.size, linear=way).total <= there
        for way in (_FACTORS_ALONE, _FACTORS_BESIDE)
    )
    linear = choose(
        scene.solver.linear,
        sizes.dimension,
        _unknowns(chosen, sizes),
        options={**scene.solver.petsc, **(options or {})},
        factors_fit=factors_fit,
        beside_fit=beside_fit,
    )
    needed = footprint(scene, chosen, sizes, ranks=comm.size, linear=linear)
    if needed.total > there:
        key, value = _blamed(scene, figures=needed.total - needed.figures <= there)
        allowed = (
            f"must make a problem that fits into the memory of this machine, {in_words(there)}, but this one would"
        )
        raise SceneError(line(key, value, f"{allowed} need about {needed}"))
    return linear


def _blamed(scene: Scene, *, figures: bool) -> tuple[str, object]:
    """The key by which a scene is too large, and its value.

    Args:
        scene: the scene.
        figures: whether it is so for its figures alone.
    """
    if figures:
        frames = isinstance(scene, PlaneScene) and scene.output.frames > len(scene.output.fields_at or ())
        key = "frames" if frames else "fields_at" if isinstance(scene, PlaneScene) else "profiles_at"
        return f"output.{key}", getattr(scene.output, key)
    key = "file" if isinstance(scene.geometry, MeshGeometry) else "cells"
    return f"geometry.{key}", getattr(scene.geometry, key)


def _described(scene: Scene) -> Sizes | None:
    """Sizes of the mesh that a scene describes, or None where it comes from a file."""
    if isinstance(scene, LayerScene):
        return Sizes("layer", "interval", scene.cells + 1, scene.cells, 1)
    assert isinstance(scene, PlaneScene)
    if not isinstance(scene.geometry, RectangleGeometry):
        return None
    nx, ny = scene.geometry.cells
    return Sizes("plane", "quadrilateral", (nx + 1) * (ny + 1), nx * ny, min(nx, ny) + 1)


def sizes_of(body: Geometry) -> Sizes:
    """Sizes of a mesh over all ranks."""
    topology = body.mesh.topology
    nodes, cells = (topology.index_map(dim).size_global for dim in (0, topology.dim))
    return Sizes(body.dimension, topology.cell_name(), nodes, cells, sqrt(nodes))
