"""The law integrated over an increment: accuracy, invariances."""

import numpy as np
import pytest
from points import (
    CLASSICAL,
    LAYER,
    NAMES,
    PLANE,
    SAND,
    SOLID,
    components,
    draw,
    draw_forces,
    draw_increments,
    draw_void_ratio,
    exact,
    force_difference,
    increment_tensors,
    normal_components,
    strain_scale,
    stress_scale,
    tensors,
    update,
)
from reference_law import State, characteristic_void_ratios, trace
from scipy.spatial.transform import Rotation

from cosserat_fx.hypoplasticity import FIRST_FAILURE, Status
from cosserat_fx.layout import Layout
from cosserat_fx.typing import Array

every_layout = pytest.mark.parametrize("one", NAMES, ids=NAMES.get)
every_polar_layout = pytest.mark.parametrize("one", [LAYER, PLANE, SOLID], ids=NAMES.get)


# --- accuracy ---


@every_layout
def test_the_update_is_of_second_order(one: Layout) -> None:
    """Orders of the stress fitted between 8 and 64 substeps; the void ratio is exact."""
    forces, void_ratio, increments = draw(one, 8, (1e-3, 1e-2), pressures=(1e3, 1e6), seed=3)
    end = exact(one, forces, void_ratio, increments)
    numbers = np.array([8, 16, 32, 64])
    results = [update(one, increments, forces, void_ratio, substeps=int(number)) for number in numbers]
    errors = np.array([force_difference(one, result.forces, components(one, end)) for result in results])
    orders = -np.polyfit(np.log(numbers), np.log(errors), 1)[0]
    assert np.all((orders > 1.9) & (orders < 2.3))
    assert results[0].void_ratio == pytest.approx(end.void_ratio, rel=1e-9)


@pytest.mark.parametrize("pressure", [10.0, 1e3, 1e7])
def test_the_adapted_update_is_as_accurate_as_asked_for(pressure: float) -> None:
    """The tolerance holds for each substep; their errors add up to a few times as much."""
    forces, void_ratio, increments = draw(LAYER, 8, (1e-4, 1e-2), pressures=(pressure, pressure), seed=4)
    end = exact(LAYER, forces, void_ratio, increments)
    for tolerance in (1e-3, 1e-5):
        result = update(LAYER, increments, forces, void_ratio, adapt=True, tolerance=tolerance)
        error = force_difference(LAYER, result.forces, components(LAYER, end))
        assert result.worst < FIRST_FAILURE
        assert result.error.max() <= tolerance
        assert tolerance / 20 < error.max() < 10 * tolerance


@pytest.mark.parametrize("gap", [1e-8, 1e-5, 1e-3])
def test_compression_leads_away_from_the_densest_state(gap: float) -> None:
    """Though the void ratio first falls below e_d of the old pressure: the rising pressure lowers e_d faster."""
    rng = np.random.default_rng(5)
    pressure = np.geomspace(1e2, 1e6, 10)
    forces = draw_forces(rng, SOLID, pressure, np.full(10, 0.3))
    void_ratio = draw_void_ratio(rng, pressure, gap, gap)
    increments = draw_increments(rng, SOLID, np.full(10, 1e-2), volume=1.0)
    normal = [SOLID.strain.index((i, i)) for i in range(3)]
    increments[:, normal] = -np.abs(increments[:, normal]) - 2e-3
    result = update(SOLID, increments, forces, void_ratio, adapt=True, max_substeps=100)
    end = tensors(SOLID, result.forces, result.void_ratio)
    before, after = (characteristic_void_ratios(sigma_kk, SAND)[2] for sigma_kk in (-3 * pressure, trace(end.stress)))
    assert np.all(result.status == Status.OK)
    assert np.all(result.void_ratio < before)
    assert np.all(result.void_ratio / after > void_ratio / before)
    if gap > 1e-6:  # nearer to e_d the reference's integrator fails
        some = np.s_[::4]
        expected = components(SOLID, exact(SOLID, forces[some], void_ratio[some], increments[some]))
        assert force_difference(SOLID, result.forces[some], expected).max() < 1e-3


@every_layout
def test_the_error_estimate_tracks_the_error_of_one_substep(one: Layout) -> None:
    """For small errors their ratio is near 1; large ones, of stiff points, are overrated rather than overlooked."""
    m = 300 if one is SOLID else 1000
    forces, void_ratio, increments = draw(one, m, (1e-6, 1e-2), seed=6)
    single = update(one, increments, forces, void_ratio, adapt=True, tolerance=np.inf)
    accurate = update(one, increments, forces, void_ratio, substeps=200)
    good = (single.status < FIRST_FAILURE) & (accurate.status < FIRST_FAILURE) & (single.substeps == 1)
    error = force_difference(one, single.forces, accurate.forces)[good]
    estimate = single.error[good]
    small, large = (error > 1e-8) & (error < 1e-2), error > 1e-2
    assert good.mean() > 0.85
    assert min(small.sum(), large.sum()) > m / 10
    assert 0.5 < np.median(estimate[small] / error[small]) < 1.5
    assert np.quantile(estimate[small] / error[small], 0.05) > 0.2
    assert np.quantile(estimate[small] / error[small], 0.95) < 5
    assert np.quantile(estimate[large] / error[large], 0.02) > 0.2


def test_isotropic_compression_stays_on_the_loosest_void_ratio() -> None:
    """From 10 Pa to several MPa in increments of 1 %, chained."""
    forces = np.where(normal_components(SOLID), -10.0, 0.0)[None, :]
    e_i, _, _ = characteristic_void_ratios(np.array([-30.0]), SAND)
    void_ratio = e_i
    compression = np.zeros((1, SOLID.n_inputs))
    compression[0, [SOLID.strain.index((i, i)) for i in range(3)]] = -0.01
    for _ in range(15):
        result = update(SOLID, compression, forces, void_ratio, adapt=True, tolerance=1e-7, max_substeps=4000)
        assert result.worst < FIRST_FAILURE
        forces, void_ratio = result.forces, result.void_ratio
        e_i, _, _ = characteristic_void_ratios(trace(tensors(SOLID, forces, void_ratio).stress), SAND)
        assert void_ratio == pytest.approx(e_i, rel=1e-5)
        assert forces[0] == pytest.approx(np.where(normal_components(SOLID), forces[0, 0], 0.0))
    assert -forces[0, 0] > 1e6


def test_large_shear_ends_in_the_critical_state() -> None:
    """At constant volume the pressure goes where e is e_c, the stress to the cone of Matsuoka and Nakai, and stays."""
    shear = np.zeros((1, CLASSICAL.n_inputs))
    shear[0, CLASSICAL.strain.index((0, 1))] = 0.2
    forces, void_ratio = np.where(normal_components(CLASSICAL), -100e3, 0.0)[None, :], np.array([0.7])
    for _ in range(40):
        result = update(CLASSICAL, shear, forces, void_ratio, adapt=True)
        assert result.worst < FIRST_FAILURE
        change, forces = force_difference(CLASSICAL, result.forces, forces), result.forces
    stress = tensors(CLASSICAL, forces, void_ratio).stress[0]
    _, e_c, _ = characteristic_void_ratios(np.trace(stress), SAND)
    first, second, third = np.linalg.eigvalsh(stress)
    sine = np.sin(np.radians(SAND.phi_c))
    ratio = (first + second + third) * (first * second + second * third + third * first) / (first * second * third)
    assert change < 1e-9
    assert e_c == pytest.approx(0.7, rel=1e-9)
    assert ratio == pytest.approx((9 - sine**2) / (1 - sine**2), rel=1e-9)
    assert np.diag(stress) == pytest.approx(np.mean(np.diag(stress)), rel=1e-9)


# --- invariances ---


def test_rotating_state_and_increment_rotates_the_result() -> None:
    m = 100
    forces, void_ratio, increments = draw(SOLID, m, (1e-6, 1e-3), seed=7)
    turns = Rotation.random(m, random_state=7).as_matrix()

    def turned(values: Array) -> Array:
        blocks = values.reshape(m, -1, 3, 3)
        return np.asarray((turns[:, None] @ blocks @ turns[:, None].swapaxes(-1, -2)).reshape(values.shape))

    spin = turned(increment_tensors(SOLID, increments).spin)
    rotated = np.concatenate([turned(increments[:, :18]), spin[:, *np.transpose(SOLID.spin)]], axis=1)
    result = update(SOLID, increments, forces, void_ratio, substeps=3)
    result_rotated = update(SOLID, rotated, turned(forces), void_ratio, substeps=3)
    assert result.worst < FIRST_FAILURE
    assert force_difference(SOLID, result_rotated.forces, turned(result.forces)).max() < 1e-11
    assert np.all(result_rotated.status == result.status)


@every_layout
def test_a_rigid_rotation_turns_the_stress(one: Layout) -> None:
    """About x3, to third order in the angle; the pressure stays to rounding, the void ratio for ever."""
    forces, void_ratio, _ = draw(one, 20, (1, 1), seed=8)
    angles = np.array([0.02, 0.04, 0.08])
    errors = []
    for angle in angles:
        increments = np.zeros((20, one.n_inputs))
        increments[:, one.n_inputs - len(one.spin) + one.spin.index((0, 1))] = -angle
        result = update(one, increments, forces, void_ratio)
        turn = Rotation.from_rotvec([0, 0, angle]).as_matrix()
        start = tensors(one, forces, void_ratio)
        turned = State(turn @ start.stress @ turn.T, turn @ start.couple @ turn.T, void_ratio)
        errors.append(force_difference(one, result.forces, components(one, turned)))
        assert np.all(result.status == Status.OK)
        assert np.all(result.void_ratio == void_ratio)
        pressures = (values[:, normal_components(one)].sum(axis=1) for values in (result.forces, forces))
        assert np.divide(*pressures) == pytest.approx(1, rel=1e-13)
    orders = np.polyfit(np.log(angles), np.log(errors), 1)[0]
    assert np.all((orders > 2.8) & (orders < 3.2))


@every_polar_layout
def test_no_couple_stress_and_no_curvature_make_no_couple_stress(one: Layout) -> None:
    cut, first, last = len(one.stress), len(one.strain), len(one.strain_slots)
    forces, void_ratio, increments = draw(one, 50, (1e-6, 1e-3), seed=9)
    forces[:, cut:], increments[:, first:last] = 0, 0
    result = update(one, increments, forces, void_ratio, substeps=2)
    assert result.worst < FIRST_FAILURE
    assert np.all(result.forces[:, cut:] == 0)


@pytest.mark.parametrize("other", [PLANE, SOLID], ids=NAMES.get)
def test_a_layer_is_a_plane_and_a_solid(other: Layout) -> None:
    """What the layer leaves out is zero in the others, and what it carries is the same, the tangent included."""
    forces, void_ratio, increments = draw(LAYER, 200, (1e-6, 1e-3), seed=10)
    force_slots = [
        len(other.stress) * (k >= 5) + group.index(c)
        for k, (group, c) in enumerate(
            [(other.stress, c) for c in LAYER.stress] + [(other.couple, c) for c in LAYER.couple]
        )
    ]
    driven = [other.strain.index(c) for c in LAYER.strain]
    driven += [len(other.strain) + other.curvature.index(c) for c in LAYER.curvature]
    inputs = driven + [len(other.strain_slots) + other.spin.index(c) for c in LAYER.spin]
    embedded, increments_embedded = np.zeros((200, len(other.forces))), np.zeros((200, other.n_inputs))
    embedded[:, force_slots], increments_embedded[:, inputs] = forces, increments
    layer = update(LAYER, increments, forces, void_ratio, substeps=2)
    wider = update(other, increments_embedded, embedded, void_ratio, substeps=2)
    assert layer.worst < FIRST_FAILURE
    assert np.all(wider.status == layer.status)
    assert np.all(wider.void_ratio == layer.void_ratio)
    assert force_difference(LAYER, wider.forces[:, force_slots], layer.forces).max() < 1e-12
    assert np.all(np.delete(wider.forces, force_slots, axis=1) == 0)
    scale = stress_scale(LAYER)[list(LAYER.strain_slots), None] / strain_scale(LAYER)
    difference = np.abs(wider.tangent[:, driven][:, :, inputs] - layer.tangent) * scale
    assert np.all(difference.max(axis=(1, 2)) < 1e-7 * np.abs(layer.tangent * scale).max(axis=(1, 2)))


def test_the_classical_law_is_the_polar_one_without_rotations() -> None:
    forces, void_ratio, increments = draw(CLASSICAL, 200, (1e-6, 1e-3), seed=11)
    start, path = tensors(CLASSICAL, forces, void_ratio), increment_tensors(CLASSICAL, increments)
    strain = np.stack([path.strain[:, i, j] for i, j in PLANE.strain], axis=1)
    polar = np.concatenate([strain, np.zeros((200, 2)), path.spin[:, 0, 1, None]], axis=1)
    classical = update(CLASSICAL, increments, forces, void_ratio, substeps=2)
    cosserat = update(PLANE, polar, components(PLANE, start), void_ratio, substeps=2)
    good = classical.status < FIRST_FAILURE
    assert good.mean() > 0.95
    assert np.all(cosserat.status == classical.status)
    end = components(PLANE, tensors(CLASSICAL, classical.forces, classical.void_ratio))
    assert force_difference(PLANE, cosserat.forces, end)[good].max() < 1e-12


def test_a_frozen_void_ratio_stays_what_it_was() -> None:
    forces, void_ratio, increments = draw(LAYER, 5, (1e-3, 1e-2), pressures=(1e3, 1e6), seed=12)
    end = exact(LAYER, forces, void_ratio, increments, evolving=False)
    result = update(LAYER, increments, forces, void_ratio, substeps=200, evolving=False)
    assert result.worst < FIRST_FAILURE
    assert np.all(result.void_ratio == void_ratio)
    assert force_difference(LAYER, result.forces, components(LAYER, end)).max() < 1e-4
    assert np.all(update(LAYER, increments, forces, void_ratio, substeps=200).void_ratio != void_ratio)


def test_without_objective_terms_the_spin_does_nothing() -> None:
    forces, void_ratio, increments = draw(LAYER, 200, (1e-6, 1e-3), seed=13)
    driven = len(LAYER.strain_slots)
    still = np.where(np.arange(LAYER.n_inputs) < driven, increments, 0)
    off = update(LAYER, increments, forces, void_ratio, substeps=2, spin=False)
    on = update(LAYER, still, forces, void_ratio, substeps=2)
    assert off.worst < FIRST_FAILURE
    assert force_difference(LAYER, off.forces, on.forces).max() < 1e-14
    assert np.all(off.tangent[:, :, driven:] == 0)
    assert np.any(on.tangent[:, :, driven:] != 0)
