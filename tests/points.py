"""Batches of material points for the tests of the kernel: drawing states, calling the update, tensors to components."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from reference_law import (
    Increment,
    State,
    Tensor,
    characteristic_void_ratios,
    contract,
    critical_factor,
    scaled,
    trace,
)

from cosserat_fx.hypoplasticity import FIRST_FAILURE
from cosserat_fx.layout import Component, Layout
from cosserat_fx.material import Material
from cosserat_fx.typing import Array, CodeArray, IntArray
from cosserat_fx.update import build_update

SAND = Material.named("paper-sand")


@dataclass(frozen=True)
class Result:
    """What the update wrote, and what it returned."""

    forces: Array
    void_ratio: Array
    tangent: Array
    substeps: IntArray
    status: CodeArray
    error: Array
    worst: int
    where: int


def update(
    layout: Layout,
    increments: Array,
    forces: Array,
    void_ratio: Array,
    *,
    substeps: int | IntArray = 1,
    adapt: bool = False,
    tolerance: float = 1e-4,
    max_substeps: int = 1000,
    tangent: bool = True,
    points: IntArray | None = None,
    spin: bool = True,
    evolving: bool = True,
    material: Material = SAND,
) -> Result:
    """Calls the compiled update; what it has to write is filled with NaN before."""
    rows = len(forces)
    driven = len(layout.strain_slots)
    result = Result(
        forces=np.full_like(forces, np.nan),
        void_ratio=np.full(rows, np.nan),
        tangent=np.full((rows, driven, layout.n_inputs), np.nan),
        substeps=np.full(rows, substeps, dtype=np.int32) if isinstance(substeps, int) else substeps.copy(),
        status=np.full(rows, 255, dtype=np.uint8),
        error=np.full(rows, np.nan),
        worst=-1,
        where=-1,
    )
    worst, where = build_update(layout, spin=spin, void_ratio=evolving)(
        increments,
        np.arange(rows, dtype=np.int32) if points is None else points,
        forces,
        void_ratio,
        result.forces,
        result.void_ratio,
        result.tangent,
        result.substeps,
        result.status,
        result.error,
        material.kernel_parameters(),
        tolerance,
        max_substeps,
        adapt,
        tangent,
    )
    return Result(**(vars(result) | {"worst": worst, "where": where}))


def adapted_substeps(
    layout: Layout,
    increments: Array,
    forces: Array,
    void_ratio: Array,
    *,
    tolerance: float,
    material: Material = SAND,
) -> tuple[IntArray, npt.NDArray[np.bool_]]:
    """(m,) substeps that the update chooses, and which points it can update; one by one, as a failure ends a batch."""
    results = [
        update(
            layout,
            increments[q : q + 1],
            forces[q : q + 1],
            void_ratio[q : q + 1],
            adapt=True,
            tolerance=tolerance,
            max_substeps=200,
            tangent=False,
            material=material,
        )
        for q in range(len(forces))
    ]
    substeps = np.concatenate([result.substeps for result in results])
    return substeps, np.array([result.worst < FIRST_FAILURE for result in results])


@cache
def stress_scale(layout: Layout) -> Array:
    """(n,) that takes forces to stresses: 1 for stresses, 1/d50 for couple stresses."""
    return np.array([1.0] * len(layout.stress) + [1 / SAND.d50] * len(layout.couple))


@cache
def strain_scale(layout: Layout) -> Array:
    """(inputs,) that takes increments to strains: d50 for curvatures, 1 for strains and spins."""
    return np.array([1.0] * len(layout.strain) + [SAND.d50] * len(layout.curvature) + [1.0] * len(layout.spin))


def normal_components(layout: Layout) -> npt.NDArray[np.bool_]:
    """(n,) true for the normal stresses among the forces."""
    return np.array([k < len(layout.stress) and i == j for k, (i, j) in enumerate(layout.forces)])


def force_difference(layout: Layout, one: Array, other: Array) -> Array:
    """(m,) largest difference of forces, couple stresses over d50, relative to the trace of the second's stress."""
    difference = np.abs((one - other) * stress_scale(layout)).max(axis=1)
    return np.asarray(difference / np.abs(other[:, normal_components(layout)].sum(axis=1)))


def _tensor(components: tuple[Component, ...], values: Tensor, symmetric: bool) -> Tensor:
    tensor = np.zeros((*values.shape[:-1], 3, 3), dtype=values.dtype)
    for k, (i, j) in enumerate(components):
        tensor[..., i, j] = values[..., k]
        if symmetric:
            tensor[..., j, i] = values[..., k]
    return tensor


def tensors(layout: Layout, forces: Tensor, void_ratio: Tensor) -> State:
    """Forces and void ratios as a state of the reference law."""
    stress, couple = np.split(forces, [len(layout.stress)], axis=-1)
    return State(
        _tensor(layout.stress, stress, not layout.polar), _tensor(layout.couple, couple, False), np.asarray(void_ratio)
    )


def increment_tensors(layout: Layout, increments: Tensor) -> Increment:
    """Increments as those of the reference law."""
    cuts = np.cumsum([len(layout.strain), len(layout.curvature)])
    strain, curvature, spin = np.split(increments, cuts, axis=-1)
    turn = _tensor(layout.spin, spin, False)
    return Increment(
        _tensor(layout.strain, strain, not layout.polar),
        _tensor(layout.curvature, curvature, False),
        turn - np.swapaxes(turn, -1, -2),
    )


def components(layout: Layout, state: State) -> Tensor:
    """The forces of a layout in a state of the reference law."""
    stress = [state.stress[..., i, j] for i, j in layout.stress]
    return np.stack(stress + [state.couple[..., i, j] for i, j in layout.couple], axis=-1)


def rows(state: State, which: Any) -> State:
    """Some points of a batch."""
    return State(state.stress[which], state.couple[which], state.void_ratio[which])


def limit_size(direction: Tensor) -> Array:
    """Size (m,) of s* on the Matsuoka-Nakai cone, |s*| = a(s), along unit symmetric deviators, by bisection."""
    inside, outside = np.zeros(len(direction)), np.full(len(direction), 0.8)
    for _ in range(60):
        middle = (inside + outside) / 2
        with np.errstate(invalid="ignore"):
            below = middle < critical_factor(np.eye(3) / 3 + scaled(middle, direction), SAND)
        inside, outside = np.where(below, middle, inside), np.where(below, outside, middle)
    return inside


def draw_forces(
    rng: np.random.Generator, layout: Layout, pressure: Array, mobilised: Array, *, rest_share: float = 0.5
) -> Array:
    """Random stresses and couple stresses at given distances from the isotropic state.

    Args:
        rng: source of the numbers.
        layout: components.
        pressure: (m,) mean pressure, Pa.
        mobilised: (m,) root of |s*|^2/a^2 + |m|^2/a_c^2, which is 1 at the critical state and 0 at isotropic ones.
        rest_share: largest share of it in antisymmetric stresses and couple stresses.
    """
    m = len(pressure)
    drawn = tensors(layout, rng.normal(size=(m, len(layout.forces))), np.zeros(m))
    deviator = unit_deviators(drawn.stress)
    limit = limit_size(deviator)
    twist = drawn.stress - np.swapaxes(drawn.stress, -1, -2)
    rest = np.sqrt(contract(twist, twist) + contract(drawn.couple, drawn.couple))
    rest = np.maximum(rest, np.finfo(float).tiny)  # a classical layout has none
    share = rng.uniform(0, rest_share, m)
    along, across = mobilised * limit * np.sqrt(1 - share**2), mobilised * share / rest
    stress = np.eye(3) / 3 + scaled(along, deviator) + scaled(across * limit, twist)
    couple = scaled(across * SAND.a_c * SAND.d50, drawn.couple)
    return components(layout, State(scaled(-3 * pressure, stress), scaled(-3 * pressure, couple), drawn.void_ratio))


def unit_deviators(tensor: Tensor) -> Tensor:
    """Symmetric deviatoric parts over their norm."""
    symmetric = (tensor + np.swapaxes(tensor, -1, -2)) / 2
    deviator = symmetric - scaled(trace(symmetric) / 3, np.eye(3))
    return scaled(1 / np.sqrt(contract(deviator, deviator)), deviator)


def draw_void_ratio(rng: np.random.Generator, pressure: Array, low: float = 0.02, high: float = 0.98) -> Array:
    """Void ratios between e_d (0) and e_i (1) at the pressures."""
    e_i, _, e_d = characteristic_void_ratios(-3 * pressure, SAND)
    return np.asarray(e_d + rng.uniform(low, high, len(pressure)) * (e_i - e_d))


def draw_increments(rng: np.random.Generator, layout: Layout, size: Array, *, volume: float = 0.1) -> Array:
    """Random increments, mostly shear, with curvature and spin.

    Args:
        rng: source of the numbers.
        layout: components.
        size: (m,) norm of strain and curvature times d50, and bound of each component of spin.
        volume: weight of the normal strains.
    """
    shares = np.r_[
        np.where([i == j for i, j in layout.strain], volume, 1.0),
        np.full(len(layout.curvature), 0.5),
    ]
    driven = rng.normal(size=(len(size), len(shares))) * shares
    driven *= (size / np.linalg.norm(driven, axis=1))[:, None]
    spin = rng.uniform(-1, 1, (len(size), len(layout.spin))) * size[:, None]
    return np.asarray(np.concatenate([driven, spin], axis=1) / strain_scale(layout))
