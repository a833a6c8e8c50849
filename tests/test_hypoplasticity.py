"""The compiled rate law at one point: the theory page's numbers, invariances, and its derivatives by complex step."""

from dataclasses import dataclass
from itertools import product

import numpy as np
import pytest
from points import (
    SAND,
    components,
    draw_forces,
    draw_increments,
    draw_void_ratio,
    increment_tensors,
    limit_size,
    normal_components,
    strain_scale,
    stress_scale,
    tensors,
    unit_deviators,
)
from reference_law import State, characteristic_void_ratios, trace
from reference_law import rate as reference_rate
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from cosserat_fx import rows as row
from cosserat_fx.hypoplasticity import (
    Status,
    add_input_derivative,
    critical_stress,
    rate,
    stage_matrix,
    state_factors,
)
from cosserat_fx.layout import Dimension, Layout, layout
from cosserat_fx.tables import tables
from cosserat_fx.typing import Array

SOLID = layout("solid")
C = SAND.kernel_parameters()
DIMENSIONS: tuple[Dimension, ...] = ("layer", "plane", "solid")
LAYOUTS = [layout(dimension, polar=polar) for dimension, polar in product(DIMENSIONS, (True, False))]


def name(one: Layout) -> str:
    return f"{one.dimension}, {'polar' if one.polar else 'classical'}"


@dataclass(frozen=True)
class Law:
    """What the kernel's law says at one point; forces and increments in the layout's order and SI units."""

    code: int
    rate: Array
    matrix: Array
    columns: Array
    f_s: float
    f_d: float
    a: float
    norm: float
    d: Array


def law_at(one: Layout, forces: Array, void_ratio: float, increment: Array, *, spin: bool = True) -> Law:
    """Calls the kernel's functions in a lane among others; couple stresses over d50, curvatures times d50 come back."""
    t = tables(one, spin=spin)
    n, driven, inputs = len(one.forces), len(one.strain_slots), one.n_inputs
    rows, lanes, lane = np.full((row.NUMBER, row.LANES), np.nan), 3, 1
    d, w = np.zeros(n), (increment * strain_scale(one))[driven:]
    d[t.slots] = (increment * strain_scale(one))[:driven]
    norm = float(np.sqrt(np.sum(t.weight * d**2)))
    for first, values in (
        (row.D, d),
        (row.WEIGHTED_D, t.weight * d),
        (row.SPIN, w),
        (row.Y, forces * stress_scale(one)),
        (row.NORM, np.array([norm])),
        (row.INVERSE_NORM, np.array([1 / norm if norm else 0.0])),
        (row.E, np.array([void_ratio])),
        (row.E_BY_VOLUME, np.array([1 + void_ratio])),
        (row.SCALE, np.array([1.0])),
        (row.STAGE_SENSITIVITY, np.zeros(n * inputs)),
    ):
        rows[first : first + len(values), lane] = values
    rate(rows, row.Y, lanes, C, t)
    stage_matrix(rows, lanes, t)
    add_input_derivative(rows, row.Y, lanes, t)
    f_s, f_d, a = rows[[row.F_S, row.F_D, row.A], lane]
    return Law(
        code=int(rows[row.CODE, lane]),
        rate=rows[row.RATE : row.RATE + n, lane].copy(),
        matrix=rows[row.MATRIX : row.MATRIX + n * n, lane].reshape(n, n).copy(),
        columns=rows[row.STAGE_SENSITIVITY : row.STAGE_SENSITIVITY + n * inputs, lane].reshape(n, inputs).copy(),
        f_s=float(f_s),
        f_d=float(f_d),
        a=float(a),
        norm=norm,
        d=d,
    )


def law_in_solid(stress: Array, void_ratio: float, strain: Array, *, spin: Array | None = None) -> Law:
    """The solid layout's law without couple stresses and curvatures."""
    turn = np.zeros((3, 3)) if spin is None else spin
    inputs = [*(strain[c] for c in SOLID.strain), *np.zeros(len(SOLID.curvature)), *(turn[c] for c in SOLID.spin)]
    state = State(stress, np.zeros((3, 3)), np.asarray(void_ratio))
    return law_at(SOLID, components(SOLID, state), void_ratio, np.array(inputs))


def random_points(one: Layout, m: int, seed: int, *, size: float = 1.0) -> tuple[Array, Array, Array]:
    """Forces, void ratios and rates from 10 Pa to 10 MPa inside the limit surface."""
    rng = np.random.default_rng(seed)
    pressure = 10 ** rng.uniform(1, 7, m)
    forces = draw_forces(rng, one, pressure, rng.uniform(0, 0.99, m))
    return forces, draw_void_ratio(rng, pressure), draw_increments(rng, one, np.full(m, size), volume=1.0)


def random_deviators(m: int, seed: int) -> Array:
    return unit_deviators(np.random.default_rng(seed).normal(size=(m, 3, 3)))


def critical_stress_of(deviator: Array) -> tuple[float, Array]:
    a, *gradient = critical_stress(C.c_phi, *deviator[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    return a, np.array(gradient)


# --- the numbers of the theory page, at sigma = -100 kPa I and e = 0.6 ---

PRESSURE = 100e3
ISOTROPIC = -PRESSURE * np.eye(3)
COMPRESSION = -np.eye(3)


def pressure_rate(e: float) -> float:
    """Under isotropic compression at a unit rate of each normal strain."""
    speed = law_in_solid(ISOTROPIC, e, COMPRESSION)
    return -float(speed.rate[normal_components(SOLID)].sum()) / 3


@pytest.fixture(scope="module")
def e_i() -> float:
    """The void ratio at which isotropic compression changes it as e_i0 exp(-(3p/h_s)^n) changes with p."""
    log_slope = -SAND.n * (3 * PRESSURE / SAND.h_s) ** SAND.n / PRESSURE
    return float(brentq(lambda e: -3 * (1 + e) - e * log_slope * pressure_rate(e), 0.8, 1.3, xtol=1e-13))


def test_the_loosest_void_ratio_is_that_of_the_theory_page(e_i: float) -> None:
    assert e_i == pytest.approx(1.1124644, abs=5e-8)


def test_the_critical_void_ratio_is_that_of_the_theory_page() -> None:
    e_c = brentq(lambda e: state_factors(-3 * PRESSURE, e, C)[1] - 1, 0.6, 1.0, xtol=1e-13)
    assert e_c == pytest.approx(0.7601840, abs=5e-8)


def test_the_densest_void_ratio_is_that_of_the_theory_page() -> None:
    """Where f_d to the power 1/alpha, which is linear in e, vanishes; below it there is no law."""
    low, high = (state_factors(-3 * PRESSURE, e, C)[1] ** (1 / SAND.alpha) for e in (0.6, 0.7))
    e_d = 0.6 - 0.1 * low / (high - low)
    assert e_d == pytest.approx(0.4727974, abs=5e-8)
    assert state_factors(-3 * PRESSURE, e_d * (1 + 1e-9), C)[1] > 0
    assert state_factors(-3 * PRESSURE, e_d * (1 - 1e-9), C)[1] < 0


def test_the_factors_are_those_of_the_theory_page(e_i: float) -> None:
    f_s, f_d, *_ = state_factors(-3 * PRESSURE, 0.6, C)
    assert f_s == pytest.approx(153.594675e6, abs=0.5)
    assert f_d == pytest.approx(0.9142464, abs=5e-8)
    f_b, *_ = state_factors(-3 * PRESSURE, e_i, C)
    assert f_b == pytest.approx(80.322003e6, abs=0.5)
    assert pressure_rate(e_i) / f_b == pytest.approx(0.2340900, abs=5e-8)  # h_i


def test_the_critical_stress_function_is_that_of_the_theory_page() -> None:
    a, gradient = critical_stress_of(np.zeros((3, 3)))
    assert a == pytest.approx(0.3265986, abs=5e-8)
    assert np.all(gradient == 0)


def test_the_critical_surface_is_the_cone_of_matsuoka_and_nakai() -> None:
    sine = np.sin(np.radians(SAND.phi_c))
    for direction in random_deviators(500, seed=1):
        size = brentq(lambda x, n=direction: critical_stress_of(x * n)[0] - x, 0.01, 0.8, xtol=1e-14)
        first, second, third = np.linalg.eigvalsh(np.eye(3) / 3 + size * direction)
        ratio = (first + second + third) * (first * second + second * third + third * first) / (first * second * third)
        assert ratio == pytest.approx((9 - sine**2) / (1 - sine**2), rel=1e-9)
        assert ratio == pytest.approx(11.6667, abs=5e-5)


def test_the_stress_rate_vanishes_in_critical_states() -> None:
    """At e_c and |s*| = a under D = -s*/a."""
    rng = np.random.default_rng(2)
    directions = random_deviators(300, seed=2)
    traces = -3 * 10 ** rng.uniform(1, 7, 300)
    for direction, size, sigma_kk in zip(directions, limit_size(directions), traces, strict=True):
        _, e_c, _ = characteristic_void_ratios(sigma_kk, SAND)
        speed = law_in_solid(sigma_kk * (np.eye(3) / 3 + size * direction), float(e_c), -direction)
        assert np.abs(speed.rate).max() < 1e-13 * speed.f_s


def test_stiffness_grows_as_the_power_1_minus_n_of_pressure_at_constant_relative_density() -> None:
    """Apart from (1 + e_i)/e_i, which f_b holds and which tends to a constant at low pressure."""
    traces = -3 * np.geomspace(1e-3, 1e7, 41)
    e_i, _, _ = characteristic_void_ratios(traces, SAND)
    for density in (0.6, 0.8, 1.0):
        f_s = np.array([state_factors(sigma_kk, density * e, C)[0] for sigma_kk, e in zip(traces, e_i, strict=True)])
        power = f_s * e_i / (1 + e_i) / (-traces) ** (1 - SAND.n)
        assert power == pytest.approx(power[0], rel=1e-12)
        slope = np.diff(np.log(f_s)) / np.diff(np.log(-traces))
        assert slope[0] == pytest.approx(1 - SAND.n, abs=1e-3)


# --- against the reference law, and its symmetries ---


@pytest.mark.parametrize("one", LAYOUTS, ids=name)
def test_rates_are_those_of_the_reference_law(one: Layout) -> None:
    forces, void_ratio, increments = random_points(one, 500, seed=3)
    end = reference_rate(tensors(one, forces, void_ratio), increment_tensors(one, increments), SAND)
    expected = components(one, end) * stress_scale(one)
    for q in range(len(forces)):
        law = law_at(one, forces[q], void_ratio[q], increments[q])
        assert law.code == Status.OK
        assert np.abs(law.rate - expected[q]).max() < 1e-13 * law.f_s


@pytest.mark.parametrize("one", LAYOUTS, ids=name)
@pytest.mark.parametrize("mobilised", [0.9, 1.0, 1e-5], ids=["ordinary", "near-critical", "near-isotropic"])
def test_derivatives_are_those_of_the_reference_law(one: Layout, mobilised: float) -> None:
    """To 1e-9 of the largest entry, couple stresses over d50 and curvatures times d50, by complex step."""
    m, n, step = 300, len(one.forces), 1e-40
    rng = np.random.default_rng(4)
    pressure = 10 ** rng.uniform(1, 7, m)
    forces = draw_forces(rng, one, pressure, mobilised * (1 + 1e-6 * rng.uniform(-1, 1, m)))
    void_ratio = draw_void_ratio(rng, pressure)
    increments = draw_increments(rng, one, np.ones(m), volume=1.0)

    units = np.eye(n)[:, None, :] / stress_scale(one)
    there = tensors(one, forces + 1j * step * units, void_ratio)
    by_forces = np.imag(components(one, reference_rate(there, increment_tensors(one, increments), SAND))) / step
    units = np.eye(one.n_inputs)[:, None, :] / strain_scale(one)
    perturbed = increment_tensors(one, increments + 1j * step * units)
    void_ratios = void_ratio + 1j * (1 + void_ratio) * np.imag(trace(perturbed.strain))
    by_inputs = np.imag(components(one, reference_rate(tensors(one, forces, void_ratios), perturbed, SAND))) / step

    for q in range(m):
        law = law_at(one, forces[q], void_ratio[q], increments[q])
        matrix = np.eye(n) - by_forces[:, q].T * stress_scale(one)[:, None]
        columns = by_inputs[:, q].T * stress_scale(one)[:, None]
        assert np.abs(law.matrix - matrix).max() < 1e-9 * np.abs(matrix).max()
        assert np.abs(law.columns - columns).max() < 1e-9 * np.abs(columns).max()


@pytest.mark.parametrize("factor", [1e-9, 0.3, 7.0, 1e6])
def test_the_law_is_positively_homogeneous_of_degree_one(factor: float) -> None:
    for forces, void_ratio, increment in zip(*random_points(SOLID, 100, seed=5), strict=True):
        law = law_at(SOLID, forces, void_ratio, increment)
        faster = law_at(SOLID, forces, void_ratio, factor * increment)
        assert np.abs(faster.rate - factor * law.rate).max() < 1e-13 * factor * law.f_s


def test_the_law_is_isotropic() -> None:
    """Rotating stress, couple stress, strain, curvature and spin rotates the rates."""
    m = 100
    forces, void_ratio, increments = random_points(SOLID, m, seed=6)
    turns = Rotation.random(m, random_state=6).as_matrix()

    def turned(values: Array, turn: Array) -> Array:
        blocks = values.reshape(-1, 3, 3)
        return np.asarray((turn @ blocks @ turn.T).reshape(values.shape))

    for q, turn in enumerate(turns):
        spin = increment_tensors(SOLID, increments[q]).spin
        spin_turned = (turn @ spin @ turn.T)[tuple(np.transpose(SOLID.spin))]
        increment = np.concatenate([turned(increments[q][:18], turn), spin_turned])
        law = law_at(SOLID, forces[q], void_ratio[q], increments[q])
        law_turned = law_at(SOLID, turned(forces[q], turn), void_ratio[q], increment)
        assert np.abs(law_turned.rate - turned(law.rate, turn)).max() < 1e-13 * law.f_s


@pytest.mark.parametrize("one", [one for one in LAYOUTS if one.polar], ids=name)
def test_no_couple_stress_and_no_curvature_make_no_couple_stress(one: Layout) -> None:
    cut, first, last = len(one.stress), len(one.strain), len(one.strain_slots)
    forces, void_ratio, increments = random_points(one, 50, seed=7)
    forces[:, cut:], increments[:, first:last] = 0, 0
    for q in range(len(forces)):
        assert np.all(law_at(one, forces[q], void_ratio[q], increments[q]).rate[cut:] == 0)


@pytest.mark.parametrize("one", LAYOUTS, ids=name)
def test_without_the_objective_terms_spin_does_nothing(one: Layout) -> None:
    for forces, void_ratio, increment in zip(*random_points(one, 50, seed=8), strict=True):
        still = np.where(np.arange(one.n_inputs) < len(one.strain_slots), increment, 0)
        without = law_at(one, forces, void_ratio, increment, spin=False)
        assert np.all(without.rate == law_at(one, forces, void_ratio, still).rate)
        assert np.all(without.columns[:, len(one.strain_slots) :] == 0)


def test_the_spin_turns_the_stress() -> None:
    """W = -1 about x3 carries x2 to x1, so that s22 feeds s12: ds12 = W12 s22 - s11 W12."""
    stress, spin = np.diag([-200e3, -100e3, -50e3]), np.zeros((3, 3))
    spin[0, 1], spin[1, 0] = 1.0, -1.0
    turning = law_in_solid(stress, 0.7, np.zeros((3, 3)), spin=spin).rate
    expected = np.zeros(18)
    expected[[SOLID.forces.index((0, 1)), SOLID.forces.index((1, 0))]] = 100e3
    assert turning == pytest.approx(expected, abs=1e-9)


# --- where there is no law ---


def test_tension_is_told() -> None:
    for mean in (0.0, 1.0, np.nan):
        assert law_in_solid(mean * np.eye(3), 0.7, COMPRESSION).code == Status.TENSION


def test_too_dense_a_state_is_told() -> None:
    assert law_in_solid(ISOTROPIC, 0.4727, COMPRESSION).code == Status.DENSER_THAN_E_D
    assert law_in_solid(ISOTROPIC, np.nan, COMPRESSION).code == Status.DENSER_THAN_E_D


@pytest.mark.parametrize(
    "principal",
    [
        pytest.param([2.0, -0.5, -0.5], id="negative denominator"),
        pytest.param([1.0, 1.0, -1.0], id="negative radicand"),
        pytest.param([0.9, 0.9, -0.8], id="negative a"),
        pytest.param([1.0, 0.0, 0.0], id="zero over zero"),
        pytest.param([np.nan, np.nan, np.nan], id="not a number"),
    ],
)
def test_a_stress_outside_the_domain_of_a_is_told(principal: list[float]) -> None:
    assert critical_stress_of(np.diag(principal) - np.eye(3) / 3)[0] == -1
    if np.isfinite(principal).all():
        assert law_in_solid(-1e5 * np.diag(principal), 0.7, COMPRESSION).code == Status.RADICAND
