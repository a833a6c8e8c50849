"""A layout's components as small arrays: what the constitutive kernel knows of the kind of problem it works for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cosserat_fx.layout import Layout
from cosserat_fx.typing import Array, IntArray


class Tables(NamedTuple):
    """A layout's tables as small arrays, which become constants of the kernel that captures them.

    Attributes:
        weight: multiplicity of each force component in a contraction.
        normal: 1 for the components 11, 22, 33 of the stress, else 0.
        normals: the places of these components.
        n_stress, n_spin: number of stress components, which come first, and of spin components.
        share: part of a stress component that goes to its slot of the symmetric part; 0 for couples.
        symmetric: slot of each stress component in the symmetric order 11, 22, 33, 12, 13, 23.
        slots: force component that is conjugate to each strain and curvature increment.
        spin_row, spin_column, spin_of, spin_sign: the entries of L(W), as
            ``L[row, column] += sign * W[of]``.
    """

    weight: Array
    normal: Array
    normals: IntArray
    n_stress: int
    n_spin: int
    share: Array
    symmetric: IntArray
    slots: IntArray
    spin_row: IntArray
    spin_column: IntArray
    spin_of: IntArray
    spin_sign: Array


_SYMMETRIC_SLOT = {(0, 0): 0, (1, 1): 1, (2, 2): 2, (0, 1): 3, (1, 0): 3, (0, 2): 4, (2, 0): 4, (1, 2): 5, (2, 1): 5}


def tables(layout: Layout, *, spin: bool) -> Tables:
    """The kernel's tables for a layout, with the objective terms or without."""
    n_stress = len(layout.stress)
    entries: list[tuple[int, int, int, float]] = []
    groups = ((layout.stress, 0), (layout.couple, n_stress)) if spin else ()
    for components, offset in groups:
        find = {c: offset + k for k, c in enumerate(components)}
        if not layout.polar:
            find |= {(j, i): slot for (i, j), slot in find.items()}
        for i, j in components:
            for k in range(3):
                entries += _spin_entries(layout, find, (i, j), (i, k), (k, j), 1.0)
                entries += _spin_entries(layout, find, (i, j), (k, j), (i, k), -1.0)
    n = len(layout.forces)
    diagonal = np.array([i == j for i, j in layout.forces])
    stress = np.arange(n) < n_stress
    rows, columns, ofs, signs = np.ascontiguousarray(np.array(entries, dtype=np.float64).reshape(-1, 4).T)
    return Tables(
        weight=np.array(layout.weights),
        normal=np.where(stress & diagonal, 1.0, 0.0),
        normals=np.flatnonzero(stress & diagonal).astype(np.int32),
        n_stress=n_stress,
        n_spin=len(layout.spin),
        share=np.where(stress, np.where(diagonal | (not layout.polar), 1.0, 0.5), 0.0),
        symmetric=np.array([_SYMMETRIC_SLOT[c] for c in layout.forces], dtype=np.int32),
        slots=np.array(layout.strain_slots, dtype=np.int32),
        spin_row=rows.astype(np.int32),
        spin_column=columns.astype(np.int32),
        spin_of=ofs.astype(np.int32),
        spin_sign=signs,
    )


def _spin_entries(
    layout: Layout,
    find: dict[tuple[int, int], int],
    row: tuple[int, int],
    spin: tuple[int, int],
    column: tuple[int, int],
    sign: float,
) -> list[tuple[int, int, int, float]]:
    """The entry ``sign * W[spin] * y[column]`` of the component ``row``, if both exist."""
    if column not in find:
        return []
    if spin in layout.spin:
        return [(find[row], find[column], layout.spin.index(spin), sign)]
    if spin[::-1] in layout.spin:
        return [(find[row], find[column], layout.spin.index(spin[::-1]), -sign)]
    return []
