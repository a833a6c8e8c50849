"""The law integrated over an increment: accuracy, invariances, purity and what becomes of points that fail."""

from math import log10

import numpy as np
import pytest
from points import (
    SAND,
    components,
    draw_forces,
    draw_increments,
    draw_void_ratio,
    force_difference,
    increment_tensors,
    normal_components,
    strain_scale,
    stress_scale,
    tensors,
    update,
)
from reference_law import State, characteristic_void_ratios, integrate, trace
from scipy.spatial.transform import Rotation

from cosserat_fx.hypoplasticity import FIRST_FAILURE, REASONS, Status
from cosserat_fx.layout import Layout, layout
from cosserat_fx.typing import Array

LAYER, PLANE, SOLID, CLASSICAL = layout("layer"), layout("plane"), layout("solid"), layout("plane", polar=False)
NAMES = {LAYER: "layer", PLANE: "plane", SOLID: "solid", CLASSICAL: "classical plane"}
every_layout = pytest.mark.parametrize("one", NAMES, ids=NAMES.get)
WRITTEN = ("forces", "void_ratio", "tangent", "substeps", "status", "error")
every_polar_layout = pytest.mark.parametrize("one", [LAYER, PLANE, SOLID], ids=NAMES.get)


def draw(
    one: Layout, m: int, sizes: tuple[float, float], pressures: tuple[float, float] = (10, 1e7), *, seed: int
) -> tuple[Array, Array, Array]:
    """Forces, void ratios and increments; little volume change, so that the pressure need not vanish."""
    rng = np.random.default_rng(seed)
    pressure = 10 ** rng.uniform(log10(pressures[0]), log10(pressures[1]), m)
    forces = draw_forces(rng, one, pressure, rng.uniform(0, 0.98, m))
    size = 10 ** rng.uniform(log10(sizes[0]), log10(sizes[1]), m)
    return forces, draw_void_ratio(rng, pressure), draw_increments(rng, one, size, volume=0.05)


def exact(one: Layout, forces: Array, void_ratio: Array, increments: Array, *, evolving: bool = True) -> State:
    """The reference law, tightly integrated point by point."""
    ends = [
        integrate(tensors(one, *point), increment_tensors(one, increment), SAND, evolving=evolving)
        for *point, increment in zip(forces, void_ratio, increments, strict=True)
    ]
    return State(*(np.array([getattr(end, part) for end in ends]) for part in ("stress", "couple", "void_ratio")))


# --- accuracy ---


@every_layout
def test_the_update_is_of_second_order(one: Layout) -> None:
    """Orders of the stress fitted between 8 and 64 substeps; the void ratio is exact."""
    forces, void_ratio, increments = draw(one, 8, (1e-3, 1e-2), (1e3, 1e6), seed=3)
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
    forces, void_ratio, increments = draw(LAYER, 8, (1e-4, 1e-2), (pressure, pressure), seed=4)
    end = exact(LAYER, forces, void_ratio, increments)
    for tolerance in (1e-3, 1e-5):
        result = update(LAYER, increments, forces, void_ratio, adapt=True, tolerance=tolerance)
        error = force_difference(LAYER, result.forces, components(LAYER, end))
        assert result.worst < FIRST_FAILURE
        assert result.error.max() <= tolerance
        assert tolerance / 20 < error.max() < 10 * tolerance


@pytest.mark.parametrize("gap", [1e-6, 1e-3])
def test_points_near_the_densest_state_are_compressed(gap: float) -> None:
    """Where the void ratio first falls below e_d of the old pressure; the rising pressure lowers e_d as fast."""
    rng = np.random.default_rng(5)
    pressure = np.array([1e3, 1e5, 1e6])
    forces = draw_forces(rng, SOLID, pressure, np.full(3, 0.3))
    void_ratio = draw_void_ratio(rng, pressure, gap, gap)
    increments = draw_increments(rng, SOLID, np.full(3, 1e-2), volume=1.0)
    normal = [SOLID.strain.index((i, i)) for i in range(3)]
    increments[:, normal] = -np.abs(increments[:, normal]) - 2e-3
    end = exact(SOLID, forces, void_ratio, increments)
    result = update(SOLID, increments, forces, void_ratio, adapt=True, tolerance=1e-4)
    _, _, e_d = characteristic_void_ratios(trace(tensors(SOLID, forces, void_ratio).stress), SAND)
    assert np.all(result.void_ratio < e_d)
    assert np.all(result.status == Status.OK)
    assert force_difference(SOLID, result.forces, components(SOLID, end)).max() < 5e-4


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
    forces, void_ratio, increments = draw(LAYER, 5, (1e-3, 1e-2), (1e3, 1e6), seed=12)
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


# --- a pure function of each point ---


@pytest.mark.parametrize("adapt", [False, True])
def test_the_trial_is_a_pure_function_of_the_committed_state(adapt: bool) -> None:
    state = draw(LAYER, 300, (1e-6, 1e-3), seed=14)
    forces, void_ratio, increments = (values.copy() for values in state)
    first = update(LAYER, increments, forces, void_ratio, adapt=adapt)
    update(LAYER, -increments, forces, void_ratio, adapt=adapt)
    again = update(LAYER, increments, forces, void_ratio, adapt=adapt)
    for name in WRITTEN:
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    for now, before in zip((forces, void_ratio, increments), state, strict=True):
        np.testing.assert_array_equal(now, before)


@pytest.mark.parametrize("adapt", [False, True])
def test_points_do_not_know_of_each_other(adapt: bool) -> None:
    """Any selection of the rows in any order gives what all rows give, and leaves the others alone."""
    forces, void_ratio, increments = draw(PLANE, 300, (1e-6, 1e-3), seed=15)
    together = update(PLANE, increments, forces, void_ratio, adapt=adapt)
    assert together.worst < FIRST_FAILURE
    chosen = np.random.default_rng(15).permutation(300)[:40].astype(np.int32)
    for part in (chosen[:1], chosen):
        some = update(PLANE, increments[part], forces, void_ratio, adapt=adapt, points=part)
        for name in WRITTEN:
            one, other = getattr(some, name), getattr(together, name)
            np.testing.assert_array_equal(one[part], other[part])
            untouched = np.delete(one, part, axis=0)
            assert np.all(np.isnan(untouched) | np.isin(untouched, (1, 255))), name


def test_adapted_substeps_are_kept_and_give_the_same_when_frozen() -> None:
    forces, void_ratio, increments = draw(LAYER, 300, (1e-6, 1e-3), seed=16)
    adapted = update(LAYER, increments, forces, void_ratio, adapt=True)
    frozen = update(LAYER, increments, forces, void_ratio, substeps=adapted.substeps)
    assert adapted.worst < FIRST_FAILURE
    assert adapted.substeps.min() == 1 < adapted.substeps.max()
    np.testing.assert_array_equal(frozen.forces, adapted.forces)
    np.testing.assert_array_equal(frozen.tangent, adapted.tangent)
    np.testing.assert_array_equal(frozen.substeps, adapted.substeps)
    more = update(LAYER, increments, forces, void_ratio, adapt=True, substeps=50)
    assert np.all(more.substeps == 50)


def test_without_a_tangent_none_is_written() -> None:
    forces, void_ratio, increments = draw(LAYER, 50, (1e-6, 1e-3), seed=17)
    without = update(LAYER, increments, forces, void_ratio, tangent=False)
    assert np.all(np.isnan(without.tangent))
    np.testing.assert_array_equal(without.forces, update(LAYER, increments, forces, void_ratio).forces)


# --- points that fail ---

ISOTROPIC = np.where(normal_components(LAYER), -100e3, 0.0)
SHEAR = np.array([0.0, 1e-3, 0.0, 0.0, 5e-4])


def outcome(
    forces: Array = ISOTROPIC,
    void_ratio: float = 0.7,
    increment: Array = SHEAR,
    *,
    max_substeps: int = 1000,
    tolerance: float = 1e-4,
    adapt: bool = True,
) -> Status:
    """Status of one point of a layer, after the checks that hold for every failing point."""
    result = update(
        LAYER,
        increment[None],
        forces[None],
        np.array([void_ratio]),
        adapt=adapt,
        tolerance=tolerance,
        max_substeps=max_substeps,
    )
    status = Status(int(result.status[0]))
    assert result.worst == status
    assert REASONS[status]
    if status >= FIRST_FAILURE:
        assert result.where == 0
        np.testing.assert_array_equal(result.forces[0], forces)
        np.testing.assert_array_equal(result.void_ratio, void_ratio)
        assert np.all(result.tangent == 0)
    else:
        assert np.isfinite(result.forces).all()
        assert np.isfinite(result.tangent).all()
    return status


def with_stress(**stress: float) -> Array:
    forces = ISOTROPIC.copy()
    for name, value in stress.items():
        forces[LAYER.stress_index(int(name[1]) - 1, int(name[2]) - 1)] = value
    return forces


def test_an_ordinary_point_is_updated() -> None:
    assert outcome() == Status.OK


def test_a_point_in_tension_is_told() -> None:
    assert outcome(forces=-ISOTROPIC) == Status.TENSION


def test_a_point_pulled_apart_is_told() -> None:
    assert outcome(increment=np.array([0.05, 0.0, 0.0, 0.0, 0.0])) == Status.TENSION


def test_a_point_denser_than_e_d_is_told() -> None:
    assert outcome(void_ratio=0.47) == Status.DENSER_THAN_E_D


def test_a_point_outside_the_domain_of_a_is_told() -> None:
    assert outcome(forces=with_stress(s11=-400e3, s22=150e3, s33=150e3)) == Status.RADICAND


def test_too_few_substeps_are_told() -> None:
    assert outcome(increment=10 * SHEAR, max_substeps=2) == Status.SUBSTEPS
    assert outcome(increment=10 * SHEAR, max_substeps=2, tolerance=1.0) == Status.OK


def test_huge_increments_fail_cleanly_or_not_at_all() -> None:
    """In one substep of up to 50 % from anywhere, with stresses outside the limit surface and void ratios below e_d."""
    m = 3000
    rng = np.random.default_rng(18)
    pressure = 10 ** rng.uniform(-3, 9, m)
    forces = draw_forces(rng, LAYER, pressure, rng.uniform(0, 3, m))
    void_ratio = draw_void_ratio(rng, pressure, -0.1, 1.1)
    increments = draw_increments(rng, LAYER, 10 ** rng.uniform(-3, log10(0.5), m), volume=1.0)
    result = update(LAYER, increments, forces, void_ratio)
    failed = result.status >= FIRST_FAILURE
    assert set(result.status) == set(Status) - {Status.SUBSTEPS, Status.NOT_FINITE}
    np.testing.assert_array_equal(result.forces[failed], forces[failed])
    np.testing.assert_array_equal(result.void_ratio[failed], void_ratio[failed])
    assert np.all(result.tangent[failed] == 0)
    for written in (result.forces, result.void_ratio, result.tangent):
        assert np.isfinite(written).all()
    assert result.worst == result.status.max()
    assert result.where == result.status.argmax()


def test_a_failing_point_ends_the_search_for_substeps() -> None:
    """The other points are of no use then; the report is on the first that failed."""
    forces, void_ratio, increments = draw(LAYER, 9, (1e-3, 1e-2), (1e4, 1e6), seed=19)
    forces[4], forces[7] = with_stress(s11=-400e3, s22=150e3, s33=150e3), -ISOTROPIC
    result = update(LAYER, increments, forces, void_ratio, adapt=True)
    assert (result.worst, result.where) == (Status.RADICAND, 4)
    assert result.status[7] == Status.TENSION
    assert np.all(result.substeps[:4] > 1)
    assert np.all(result.substeps[5:] == 1)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
@pytest.mark.parametrize("slot", range(LAYER.n_inputs))
def test_an_increment_that_is_no_number_is_told(slot: int, value: float) -> None:
    increment = SHEAR.copy()
    increment[slot] = value
    assert outcome(increment=increment) == Status.NOT_FINITE
    assert outcome(increment=increment, adapt=False) == Status.NOT_FINITE


def test_a_point_looser_than_e_i_goes_on() -> None:
    e_i, _, _ = characteristic_void_ratios(np.array(-300e3), SAND)
    assert outcome(void_ratio=float(e_i) * 0.99) == Status.OK
    assert outcome(void_ratio=float(e_i) * 1.01) == Status.LOOSER_THAN_E_I
    looser = np.array([float(e_i) * 1.01])
    result = update(LAYER, SHEAR[None], ISOTROPIC[None], looser, adapt=True)
    end = exact(LAYER, ISOTROPIC[None], looser, SHEAR[None])
    assert force_difference(LAYER, result.forces, components(LAYER, end)).max() < 1e-3
