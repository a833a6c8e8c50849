"""Batches of material points for the tests of the kernel: drawing states, calling the update, tensors to components."""

from dataclasses import dataclass
from functools import cache
from math import log10
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
    integrate,
    scaled,
    trace,
)

from cosserat_fx.hypoplasticity import FIRST_FAILURE
from cosserat_fx.layout import Component, Layout, layout
from cosserat_fx.material import Material
from cosserat_fx.typing import Array, CodeArray, IntArray
from cosserat_fx.update import build_update

SAND = Material.named("paper-sand")
LAYER, PLANE, SOLID, CLASSICAL = layout("layer"), layout("plane"), layout("solid"), layout("plane", polar=False)
NAMES = {LAYER: "layer", PLANE: "plane", SOLID: "solid", CLASSICAL: "classical plane"}
"""The layouts whose update the tests compile; each takes some ten seconds the first time."""


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
    one: Layout,
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
    driven = len(one.strain_slots)
    result = Result(
        forces=np.full_like(forces, np.nan),
        void_ratio=np.full(rows, np.nan),
        tangent=np.full((rows, driven, one.n_inputs), np.nan),
        substeps=np.full(rows, substeps, dtype=np.int32) if isinstance(substeps, int) else substeps.copy(),
        status=np.full(rows, 255, dtype=np.uint8),
        error=np.full(rows, np.nan),
        worst=-1,
        where=-1,
    )
    worst, where = build_update(one, spin=spin, void_ratio=evolving)(
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
    one: Layout,
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
            one,
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
def stress_scale(one: Layout) -> Array:
    """(n,) that takes forces to stresses: 1 for stresses, 1/d50 for couple stresses."""
    return np.array([1.0] * len(one.stress) + [1 / SAND.d50] * len(one.couple))


@cache
def strain_scale(one: Layout) -> Array:
    """(inputs,) that takes increments to strains: d50 for curvatures, 1 for strains and spins."""
    return np.array([1.0] * len(one.strain) + [SAND.d50] * len(one.curvature) + [1.0] * len(one.spin))


def normal_components(one: Layout) -> npt.NDArray[np.bool_]:
    """(n,) true for the normal stresses among the forces."""
    return np.array([k < len(one.stress) and i == j for k, (i, j) in enumerate(one.forces)])


def force_difference(one: Layout, forces: Array, expected: Array) -> Array:
    """(m,) largest difference of forces, couple stresses over d50, relative to the trace of the expected stress."""
    difference = np.abs((forces - expected) * stress_scale(one)).max(axis=1)
    return np.asarray(difference / np.abs(expected[:, normal_components(one)].sum(axis=1)))


def _tensor(components: tuple[Component, ...], values: Tensor, symmetric: bool) -> Tensor:
    tensor = np.zeros((*values.shape[:-1], 3, 3), dtype=values.dtype)
    for k, (i, j) in enumerate(components):
        tensor[..., i, j] = values[..., k]
        if symmetric:
            tensor[..., j, i] = values[..., k]
    return tensor


def tensors(one: Layout, forces: Tensor, void_ratio: Tensor) -> State:
    """Forces and void ratios as a state of the reference law."""
    stress, couple = np.split(forces, [len(one.stress)], axis=-1)
    return State(_tensor(one.stress, stress, not one.polar), _tensor(one.couple, couple, False), np.asarray(void_ratio))


def increment_tensors(one: Layout, increments: Tensor) -> Increment:
    """Increments as those of the reference law."""
    cuts = np.cumsum([len(one.strain), len(one.curvature)])
    strain, curvature, spin = np.split(increments, cuts, axis=-1)
    turn = _tensor(one.spin, spin, False)
    return Increment(
        _tensor(one.strain, strain, not one.polar),
        _tensor(one.curvature, curvature, False),
        turn - np.swapaxes(turn, -1, -2),
    )


def components(one: Layout, state: State) -> Tensor:
    """The forces of a layout in a state of the reference law."""
    stress = [state.stress[..., i, j] for i, j in one.stress]
    return np.stack(stress + [state.couple[..., i, j] for i, j in one.couple], axis=-1)


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
    rng: np.random.Generator, one: Layout, pressure: Array, mobilised: Array, *, rest_share: float = 0.5
) -> Array:
    """Random stresses and couple stresses at given distances from the isotropic state.

    Args:
        rng: source of the numbers.
        one: the layout.
        pressure: (m,) mean pressure, Pa.
        mobilised: (m,) root of |s*|^2/a^2 + |m|^2/a_c^2, which is 1 at the critical state and 0 at isotropic ones.
        rest_share: largest share of it in antisymmetric stresses and couple stresses.
    """
    m = len(pressure)
    drawn = tensors(one, rng.normal(size=(m, len(one.forces))), np.zeros(m))
    deviator = unit_deviators(drawn.stress)
    limit = limit_size(deviator)
    twist = drawn.stress - np.swapaxes(drawn.stress, -1, -2)
    rest = np.sqrt(contract(twist, twist) + contract(drawn.couple, drawn.couple))
    rest = np.maximum(rest, np.finfo(float).tiny)  # a classical layout has none
    share = rng.uniform(0, rest_share, m)
    along, across = mobilised * limit * np.sqrt(1 - share**2), mobilised * share / rest
    stress = np.eye(3) / 3 + scaled(along, deviator) + scaled(across * limit, twist)
    couple = scaled(across * SAND.a_c * SAND.d50, drawn.couple)
    return components(one, State(scaled(-3 * pressure, stress), scaled(-3 * pressure, couple), drawn.void_ratio))


def unit_deviators(tensor: Tensor) -> Tensor:
    """Symmetric deviatoric parts over their norm."""
    symmetric = (tensor + np.swapaxes(tensor, -1, -2)) / 2
    deviator = symmetric - scaled(trace(symmetric) / 3, np.eye(3))
    return scaled(1 / np.sqrt(contract(deviator, deviator)), deviator)


def draw_void_ratio(rng: np.random.Generator, pressure: Array, low: float = 0.02, high: float = 0.98) -> Array:
    """Void ratios between e_d (0) and e_i (1) at the pressures."""
    e_i, _, e_d = characteristic_void_ratios(-3 * pressure, SAND)
    return np.asarray(e_d + rng.uniform(low, high, len(pressure)) * (e_i - e_d))


def draw_increments(rng: np.random.Generator, one: Layout, size: Array, *, volume: float = 0.05) -> Array:
    """Random increments, mostly shear, with curvature and spin.

    Args:
        rng: source of the numbers.
        one: the layout.
        size: (m,) norm of strain and curvature times d50, and bound of each component of spin.
        volume: weight of the normal strains.
    """
    shares = np.r_[
        np.where([i == j for i, j in one.strain], volume, 1.0),
        np.full(len(one.curvature), 0.5),
    ]
    driven = rng.normal(size=(len(size), len(shares))) * shares
    driven *= (size / np.linalg.norm(driven, axis=1))[:, None]
    spin = rng.uniform(-1, 1, (len(size), len(one.spin))) * size[:, None]
    return np.asarray(np.concatenate([driven, spin], axis=1) / strain_scale(one))


def draw(
    one: Layout,
    m: int,
    sizes: tuple[float, float],
    *,
    seed: int,
    pressures: tuple[float, float] = (10, 1e7),
    mobilised: tuple[float, float] = (0.0, 0.98),
) -> tuple[Array, Array, Array]:
    """Forces, void ratios and increments of m points; increments and pressures are spread evenly over their decades."""
    rng = np.random.default_rng(seed)
    pressure = 10 ** rng.uniform(log10(pressures[0]), log10(pressures[1]), m)
    forces = draw_forces(rng, one, pressure, rng.uniform(mobilised[0], mobilised[1], m))
    size = 10 ** rng.uniform(log10(sizes[0]), log10(sizes[1]), m)
    return forces, draw_void_ratio(rng, pressure), draw_increments(rng, one, size)


def exact(one: Layout, forces: Array, void_ratio: Array, increments: Array, *, evolving: bool = True) -> State:
    """The reference law, tightly integrated point by point."""
    ends = [
        integrate(tensors(one, *point), increment_tensors(one, increment), SAND, evolving=evolving)
        for *point, increment in zip(forces, void_ratio, increments, strict=True)
    ]
    return State(*(np.array([getattr(end, part) for end in ends]) for part in ("stress", "couple", "void_ratio")))
