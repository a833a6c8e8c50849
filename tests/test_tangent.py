"""The tangent of the discrete update, against complex steps of the reference scheme and differences of the update.

Entries are compared in scaled units (couple stresses over d50, curvatures times d50), block by block: stress or couple
stress by strain, curvature or spin. An error is relative to the largest entry of its block, or to a thousandth of the
largest entry of the whole tangent where a block is smaller than that.
"""

from itertools import pairwise

import numpy as np
import pytest
from points import (
    NAMES,
    SAND,
    SOLID,
    adapted_substeps,
    components,
    draw,
    force_difference,
    increment_tensors,
    normal_components,
    rows,
    strain_scale,
    stress_scale,
    tensors,
    update,
)
from reference_law import discrete, rate

from cosserat_fx.hypoplasticity import FIRST_FAILURE, Status
from cosserat_fx.layout import Layout
from cosserat_fx.typing import Array

every_layout = pytest.mark.parametrize("one", NAMES, ids=NAMES.get)


def block_error(one: Layout, tangent: Array, expected: Array) -> Array:
    """(m,) largest error of each tangent as defined above."""
    scale = stress_scale(one)[list(one.strain_slots), None] / strain_scale(one)
    difference, size = np.abs(tangent - expected) * scale, np.abs(expected) * scale
    floor = 1e-3 * size.max(axis=(1, 2))
    strain, driven = len(one.strain), len(one.strain_slots)
    worst = np.zeros(len(tangent))
    for top, bottom in pairwise([0, strain, driven] if one.polar else [0, strain]):
        for left, right in pairwise(sorted({0, strain, driven, one.n_inputs})):
            block = np.s_[:, top:bottom, left:right]
            worst = np.maximum(
                worst, difference[block].max(axis=(1, 2)) / np.maximum(size[block].max(axis=(1, 2)), floor)
            )
    return worst


def by_complex_step(
    one: Layout, forces: Array, void_ratio: Array, increments: Array, substeps: int
) -> tuple[Array, Array]:
    """Forces at the end of the reference scheme (NaN where it found none), and their tangent."""
    start, h = tensors(one, forces, void_ratio), 1e-60 / strain_scale(one)
    end, stages = discrete(start, increment_tensors(one, increments), SAND, substeps=substeps)
    found = np.isfinite(stages).all(axis=(0, 1, 3))
    tangent = np.full((len(forces), len(one.strain_slots), one.n_inputs), np.nan)
    for j in range(one.n_inputs):
        step = 1j * h[j] * (np.arange(one.n_inputs) == j)
        perturbed = increment_tensors(one, increments[found] + step)
        there, _ = discrete(rows(start, found), perturbed, SAND, substeps=substeps, like=stages[:, :, found])
        tangent[found, :, j] = np.imag(components(one, there))[:, list(one.strain_slots)] / h[j]
    return np.asarray(components(one, end)), tangent


REGIMES = {
    "tiny": ((1e-12, 1e-8), (0.0, 0.98)),
    "small": ((1e-8, 1e-3), (0.0, 0.98)),
    "large": ((1e-3, 0.2), (0.0, 0.98)),
    "near-critical": ((1e-7, 1e-2), (0.9999, 1.0001)),
    "near-isotropic": ((1e-7, 1e-2), (1e-6, 1e-5)),
    "isotropic": ((1e-7, 1e-2), (0.0, 0.0)),
}


@every_layout
@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("substeps", [1, 3])
def test_the_tangent_is_that_of_the_reference_scheme(one: Layout, regime: str, substeps: int) -> None:
    """Wherever kernel and reference found the same stages: those of a huge increment can have several solutions."""
    sizes, mobilised = REGIMES[regime]
    forces, void_ratio, increments = draw(one, 50 if one is SOLID else 100, sizes, mobilised=mobilised, seed=1)
    result = update(one, increments, forces, void_ratio, substeps=substeps)
    good = result.status < FIRST_FAILURE
    end, tangent = by_complex_step(one, forces[good], void_ratio[good], increments[good], substeps)
    same = force_difference(one, result.forces[good], end) < 1e-12
    assert good.mean() > (0.6 if regime == "large" else 0.85)
    assert same.mean() > 0.9
    assert block_error(one, result.tangent[good][same], tangent[same]).max() < 1e-7


@every_layout
def test_the_tangent_is_the_derivative_of_the_update(one: Layout) -> None:
    """By central differences of sixth order over the better of two distances, with the adapted substeps frozen."""
    forces, void_ratio, increments = draw(one, 100 if one is SOLID else 600, (1e-6, 1e-2), seed=2)
    substeps, good = adapted_substeps(one, increments, forces, void_ratio, tolerance=1e-3)
    forces, void_ratio, increments, substeps = forces[good], void_ratio[good], increments[good], substeps[good]
    result = update(one, increments, forces, void_ratio, substeps=substeps)
    size = np.linalg.norm(increments * strain_scale(one), axis=1)

    def differences(reach: float) -> Array:
        tangent, h = np.zeros_like(result.tangent), reach * size[:, None] / strain_scale(one)
        for j in range(one.n_inputs):
            for distance, weight in ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60)):
                for sign in (1, -1):
                    moved = increments.copy()
                    moved[:, j] += sign * distance * h[:, j]
                    there = update(one, moved, forces, void_ratio, substeps=substeps, tangent=False)
                    tangent[:, :, j] += sign * weight * there.forces[:, list(one.strain_slots)] / h[:, j, None]
        return tangent

    error = np.minimum(*(block_error(one, result.tangent, differences(reach)) for reach in (1e-3, 4e-3)))
    assert good.mean() > 0.95
    assert error.max() < 1e-6


@every_layout
@pytest.mark.parametrize("substeps", [1, 4])
def test_at_rest_the_tangent_is_the_linear_part_of_the_law(one: Layout, substeps: int) -> None:
    """The half of the rate that changes sign with the increment, where the norm has no derivative."""
    forces, void_ratio, increments = draw(one, 100, (1e-6, 1e-2), seed=3)
    result = update(one, 0 * increments, forces, void_ratio, substeps=substeps)
    start, expected = tensors(one, forces, void_ratio), np.empty_like(result.tangent)
    for j in range(one.n_inputs):
        unit = np.tile(np.arange(one.n_inputs) == j, (100, 1)) / strain_scale(one)
        forth, back = (components(one, rate(start, increment_tensors(one, way * unit), SAND)) for way in (1, -1))
        expected[:, :, j] = ((forth - back) / 2)[:, list(one.strain_slots)] * strain_scale(one)[j]
    assert np.all(result.status == Status.OK)
    assert force_difference(one, result.forces, forces).max() < 1e-15
    assert np.all(result.void_ratio == void_ratio)
    assert block_error(one, result.tangent, expected).max() < 1e-13


def test_the_tangent_of_isotropic_compression_is_its_derivative_along_itself() -> None:
    """The stages are exactly isotropic there, where a(s) has a kink, which compression does not see."""
    pressure = np.geomspace(10, 1e7, 20)
    forces = -pressure[:, None] * normal_components(SOLID)
    along = -1.0 * np.array([i == j for i, j in SOLID.strain] + [False] * (SOLID.n_inputs - len(SOLID.strain)))
    ends = {}
    for size in (1 - 1e-4, 1.0, 1 + 1e-4):
        ends[size] = update(SOLID, np.tile(1e-5 * size * along, (20, 1)), forces, np.full(20, 0.6))
        assert np.all(ends[size].status == Status.OK)
    first, _, last = ends.values()
    difference = (last.forces - first.forces)[:, list(SOLID.strain_slots)] / 2e-9
    assert np.isfinite(ends[1.0].tangent).all()
    assert ends[1.0].tangent @ along == pytest.approx(difference, rel=1e-6)
