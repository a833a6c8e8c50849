"""Where a walk stands, as numbers that any rank count can read: one record per cell, in the order of the mesh's source.

Nodes that several cells share are in the record of each of them. Within a cell, nodes and quadrature points have the
order of the reference cell, which depends neither on the partition nor on the version of DOLFINx.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cosserat_fx.problem import Problem
from cosserat_fx.stepping import Increment, Position, Stepper
from cosserat_fx.typing import Array, IntArray

_SAME_PLACE = 1e-9
"""How far corners may be from those in a record, relative to the body."""

type Records = npt.NDArray[np.void]


class Cells(NamedTuple):
    """Cells of this rank.

    Attributes:
        local: (n,) indices on this rank.
        numbers: (n,) positions in the mesh's source, ascending.
    """

    local: IntArray
    numbers: npt.NDArray[np.int64]


def own_cells(problem: Problem) -> Cells:
    """The cells whose records this rank writes."""
    return _in_order(problem, len(problem.state.cells))


def cells_in_sight(problem: Problem) -> Cells:
    """The cells whose records this rank needs: its own, and the ghosts for the nodes that these bring along."""
    cells = problem.geometry.mesh.topology.index_map(problem.geometry.mesh.topology.dim)
    return _in_order(problem, cells.size_local + cells.num_ghosts)


def _in_order(problem: Problem, count: int) -> Cells:
    numbers = np.asarray(problem.geometry.mesh.topology.original_cell_index[:count], dtype=np.int64)
    order = np.argsort(numbers).astype(np.int32)
    return Cells(order, numbers[order])


def cell_record(problem: Problem) -> np.dtype[np.void]:
    """What is kept of every cell, by name: corners, fields, state, and the last increment of fields and strains."""
    points = len(problem.state.rule_points)
    fields = problem.space.dofmap.list.shape[1] * problem.space.dofmap.bs
    return np.dtype(
        [
            ("corners", "<f8", problem.geometry.cell_corners().shape[1:]),
            ("unknown", "<f8", (fields,)),
            ("unknown_increment", "<f8", (fields,)),
            ("forces", "<f8", (points, problem.state.forces_n.shape[1])),
            ("void_ratio", "<f8", (points,)),
            ("strain_increment", "<f8", (points, problem.strain_increments().shape[1])),
        ]
    )


def take(stepper: Stepper) -> tuple[dict[str, Any], Records]:
    """Where a walk stands between two steps.

    Args:
        stepper: the walk.

    Returns:
        Scalars that JSON can hold, and the records of :func:`own_cells`.
    """
    problem, last = stepper.problem, stepper.last
    state, cells = problem.state, own_cells(problem).local
    dofs = _unknowns(problem, cells)
    records = np.zeros(len(cells), cell_record(problem))
    records["corners"] = problem.geometry.cell_corners()[cells]
    records["unknown"] = problem.committed.x.array[dofs]
    records["forces"] = _by_cell(problem, state.forces_n[state.points])[cells]
    records["void_ratio"] = _by_cell(problem, state.e_n[state.points])[cells]
    if last is not None:
        records["unknown_increment"] = last.unknown[dofs]
        records["strain_increment"] = _by_cell(problem, last.strains)[cells]
    scalars = {
        **stepper.position._asdict(),
        "last_size": None if last is None else last.size,
        "internal_work": problem.internal_work,
    }
    return scalars, records


def put_back(stepper: Stepper, scalars: dict[str, Any], records: Records) -> None:
    """Let a walk stand where another one stood. Collective.

    Args:
        stepper: a walk of the same problem, on any number of ranks.
        scalars: of :func:`take`.
        records: of :func:`cells_in_sight`.
    """
    problem, state = stepper.problem, stepper.problem.state
    seen = cells_in_sight(problem).local
    dofs = _unknowns(problem, seen)
    own = np.empty(len(state.cells), records.dtype)
    mine = seen < len(own)
    own[seen[mine]] = records[mine]

    problem.committed.x.array[dofs] = records["unknown"]
    state.forces_n[state.points] = own["forces"].reshape(len(state.points), state.forces_n.shape[1])
    state.e_n[state.points] = own["void_ratio"].reshape(-1)
    problem.resume(scalars["internal_work"])
    stepper.position = Position(**{name: scalars[name] for name in Position._fields})
    stepper.last = None
    if scalars["last_size"] is not None:
        unknown = np.zeros_like(problem.committed.x.array)
        unknown[dofs] = records["unknown_increment"]
        strains = own["strain_increment"].reshape(len(state.points), records["strain_increment"].shape[2])
        stepper.last = Increment(scalars["last_size"], unknown, strains)


def is_of_this_mesh(problem: Problem, records: Records) -> bool:
    """Whether the corners in the records of :func:`cells_in_sight` are those of this mesh; the same on every rank."""
    seen, corners = cells_in_sight(problem).local, problem.geometry.cell_corners()
    mine = seen < len(corners)
    apart = np.abs(corners[seen[mine]] - records["corners"][mine]).max(initial=0.0)
    low, high = problem.geometry.extent()
    return bool(np.max(problem.comm.allgather(apart)) <= _SAME_PLACE * np.max(high - low))


def _unknowns(problem: Problem, cells: IntArray) -> IntArray:
    """Unknowns of some cells, (cells, unknowns of a cell)."""
    dofmap = problem.space.dofmap
    blocks: IntArray = dofmap.list[cells]
    unknowns: IntArray = blocks[:, :, None] * dofmap.bs + np.arange(dofmap.bs, dtype=np.int32)
    return unknowns.reshape(len(cells), unknowns.shape[1] * unknowns.shape[2])


def _by_cell(problem: Problem, values: Array) -> Array:
    """Values at this rank's own points, cell by cell."""
    return values.reshape(len(problem.state.cells), len(problem.state.rule_points), *values.shape[1:])
