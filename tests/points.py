"""Batches of material points for the tests of the kernel: drawing states, calling the update, tensors to components."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from reference_law import Increment, State, Tensor, characteristic_void_ratios, critical_factor

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


@cache
def stress_scale(layout: Layout) -> Tensor:
    """(n,) that takes forces to stresses: 1 for stresses, 1/d50 for couple stresses."""
    return np.r_[np.ones(len(layout.stress)), np.full(len(layout.couple), 1 / SAND.d50)]


@cache
def strain_scale(layout: Layout) -> Tensor:
    """(inputs,) that takes increments to strains: d50 for curvatures, 1 for strains and spins."""
    return np.r_[
        np.ones(len(layout.strain)), np.full(len(layout.curvature), SAND.d50), np.ones(len(layout.spin))
    ]


def _tensor(layout: Layout, components: tuple[Component, ...], values: Array) -> Tensor:
    tensor = np.zeros(values.shape[:-1] + (3, 3), dtype=values.dtype)
    for k, (i, j) in enumerate(components):
        tensor[..., i, j] = values[..., k]
        if not layout.polar:
            tensor[..., j, i] = values[..., k]
    return tensor


def tensors(layout: Layout, forces: Array, void_ratio: Array) -> State:
    """Forces as tensors."""
    cut = len(layout.stress)
    couple = np.zeros(forces.shape[:-1] + (3, 3), dtype=forces.dtype)
    for k, (i, j) in enumerate(layout.couple):
        couple[..., i, j] = forces[..., cut + k]
    return State(_tensor(layout, layout.stress, forces[..., :cut]), couple, void_ratio)


def increment_tensors(layout: Layout, increments: Array) -> Increment:
    """Increments as tensors."""
    parts = np.cumsum([len(layout.strain), len(layout.curvature)])
    strain, curvature, spin = np.split(increments, parts, axis=-1)
    bend = np.zeros(increments.shape[:-1] + (3, 3), dtype=increments.dtype)
    turn = np.zeros_like(bend)
    for k, (i, j) in enumerate(layout.curvature):
        bend[..., i, j] = curvature[..., k]
    for k, (i, j) in enumerate(layout.spin):
        turn[..., i, j] = spin[..., k]
        turn[..., j, i] = -spin[..., k]
    return Increment(_tensor(layout, layout.strain, strain), bend, turn)


def components(layout: Layout, state: State) -> Array:
    """The forces of a layout in tensors."""
    stress = [state.stress[..., i, j] for i, j in layout.stress]
    return np.stack(stress + [state.couple[..., i, j] for i, j in layout.couple], axis=-1)


def limit_size(direction: Tensor) -> Array:
    """Size of s* on the Matsuoka-Nakai cone, |s*| = a(s), along unit symmetric deviators (m, 3, 3)."""
    inside, outside = np.zeros(len(direction)), np.full(len(direction), 0.8)
    for _ in range(60):
        middle = (inside + outside) / 2
        with np.errstate(invalid="ignore"):
            a = critical_factor(np.eye(3) / 3 + middle[:, None, None] * direction, SAND)
        below = middle < np.where(np.isnan(a), 0, a)
        inside, outside = np.where(below, middle, inside), np.where(below, outside, middle)
    return inside


def draw_forces(
    rng: np.random.Generator, layout: Layout, pressure: Array, mobilised: Array, *, couple_share: float = 0.5
) -> Array:
    """Random stresses and couple stresses at a distance from the isotropic axis measured by the limit surface.

    In states of vanishing stress rate |s*|^2/a^2 + |m|^2/a_c^2 = 1 where f_d = 1. That root is `mobilised`.

    Args:
        rng: source.
        layout: components.
        pressure: (m,) mean pressure, Pa.
        mobilised: (m,) 0 at isotropic states, 1 on the limit surface.
        couple_share: largest share of couple stress and antisymmetric stress in it.
    """
    m, cut = len(pressure), len(layout.stress)
    part = tensors(layout, rng.normal(size=(m, len(layout.forces))), np.zeros(m))
    transpose = np.swapaxes(part.stress, -1, -2)
    deviator = (part.stress + transpose) / 2
    deviator -= np.trace(deviator, axis1=-2, axis2=-1)[:, None, None] / 3 * np.eye(3)
    deviator /= np.linalg.norm(deviator, axis=(-2, -1))[:, None, None]
    limit = limit_size(deviator)
    share = rng.uniform(0, couple_share, m) if layout.polar else np.zeros(m)
    twist = (part.stress - transpose) / 2
    rest = components(layout, State(twist, part.couple, part.void_ratio))
    rest /= np.maximum(np.linalg.norm(rest, axis=1), 1e-300)[:, None]
    # The rest counts through a (antisymmetric stress) and a_c (couple stress).
    weight = np.concatenate([np.tile(limit[:, None], cut), np.full((m, len(layout.forces) - cut), SAND.a_c)], axis=1)
    main = components(layout, State(deviator, 0 * deviator, part.void_ratio)) * limit[:, None]
    offset = mobilised[:, None] * (np.sqrt(1 - share**2)[:, None] * main + share[:, None] * weight * rest)
    normal = np.array([k < cut and i == j for k, (i, j) in enumerate(layout.forces)])
    return -3 * pressure[:, None] * (normal / 3 + offset) / stress_scale(layout)


def draw_void_ratio(rng: np.random.Generator, pressure: Array, low: float = 0.02, high: float = 0.98) -> Array:
    """Void ratios between e_d (0) and e_i (1) at the pressures."""
    e_i, _, e_d = characteristic_void_ratios(-3 * pressure, SAND)
    return e_d + rng.uniform(low, high, len(pressure)) * (e_i - e_d)


def draw_increments(
    rng: np.random.Generator, layout: Layout, size: Array, *, volume: float = 0.2, bending: float = 0.5
) -> Array:
    """Mostly shearing increments with random curvature and spin.

    Args:
        rng: source.
        layout: components.
        size: (m,) norm of strain and curvature times d50.
        volume: share of the normal strains.
        bending: share of the curvatures.
    """
    normal = np.array([i == j for i, j in layout.strain])
    shares = np.r_[np.where(normal, volume, 1.0), np.full(len(layout.curvature), bending)]
    driven = rng.normal(size=(len(size), len(shares))) * shares
    driven *= (size / np.linalg.norm(driven, axis=1))[:, None]
    spin = rng.uniform(-1, 1, (len(size), len(layout.spin))) * size[:, None]
    return np.concatenate([driven, spin], axis=1) / strain_scale(layout)
