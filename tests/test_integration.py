"""The update as a method: its order, exact paths, reported failures, independence of points."""

import numpy as np
import points
import pytest
import reference_law
from points import SAND

from cosserat_fx.hypoplasticity import FIRST_FAILURE, Status
from cosserat_fx.layout import Layout, layout
from cosserat_fx.typing import Array

LAYER, PLANE, SOLID, CLASSICAL = layout("layer"), layout("plane"), layout("solid"), layout("plane", polar=False)


def isotropic(one: Layout, pressure: float, m: int = 1) -> Array:
    forces = np.zeros((m, len(one.forces)))
    forces[:, points.normal_components(one)] = -pressure
    return forces


def strain(one: Layout, **by_component: float) -> Array:
    """One increment from its strain components, as in ``strain(PLANE, s01=1e-3)``."""
    increment = np.zeros((1, one.n_inputs))
    for name, value in by_component.items():
        increment[0, one.strain.index((int(name[1]), int(name[2])))] = value
    return increment


def shear(one: Layout, size: float) -> Array:
    """Simple shear of du1/dx2 = size with half of it as spin, and some curvature where there is any."""
    increment = strain(one, s01=size if one.polar else size / 2)
    increment[0, -1 if len(one.spin) == 1 else len(one.strain_slots)] = size / 2
    if one.curvature:
        increment[0, len(one.strain) + one.curvature.index((2, 1))] = 0.3 * size / SAND.d50
    return increment


@pytest.mark.parametrize("one", [LAYER, PLANE, SOLID, CLASSICAL], ids=["layer", "plane", "solid", "classical"])
def test_the_update_converges_with_second_order(one: Layout) -> None:
    forces, void_ratio, increment = isotropic(one, 1e5), np.array([0.6]), shear(one, 0.01)
    start = points.rows(points.tensors(one, forces, void_ratio), 0)
    turn = points.increment_tensors(one, increment)
    exact_state = reference_law.integrate(
        start, reference_law.Increment(**{name: part[0] for name, part in vars(turn).items()}), SAND
    )
    exact = points.components(one, exact_state)[None]
    counts = np.array([32, 64, 128])
    errors = [
        points.force_difference(
            one, points.update(one, increment, forces, void_ratio, substeps=int(n), tangent=False).forces, exact
        )[0]
        for n in counts
    ]
    rate = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert rate == pytest.approx(2.0, abs=0.2)
    assert errors[-1] < 1e-4
    end = points.update(one, increment, forces, void_ratio, substeps=8, tangent=False).void_ratio
    assert end[0] == pytest.approx(exact_state.void_ratio, rel=1e-9)


def test_chosen_substeps_meet_the_tolerance() -> None:
    """The true error of a shear from rest follows the tolerance asked for and stays within a few times of it."""
    forces, void_ratio, increment = isotropic(LAYER, 1e5), np.array([0.6]), shear(LAYER, 0.02)
    tight = points.update(LAYER, increment, forces, void_ratio, substeps=2000, tangent=False).forces
    for tolerance in (1e-3, 1e-4, 1e-5):
        result = points.update(LAYER, increment, forces, void_ratio, adapt=True, tolerance=tolerance, tangent=False)
        assert result.error[0] <= tolerance
        assert points.force_difference(LAYER, result.forces, tight)[0] < 5 * tolerance


def test_isotropic_compression_from_e_i_stays_on_e_i() -> None:
    pressure = 1e4
    forces, void_ratio = isotropic(SOLID, pressure), np.array([SAND.characteristic_void_ratios(pressure).e_i])
    increment = strain(SOLID, s00=-1e-3, s11=-1e-3, s22=-1e-3)
    for _ in range(20):
        result = points.update(SOLID, increment, forces, void_ratio, substeps=20, tangent=False)
        forces, void_ratio = result.forces, result.void_ratio
    normal = forces[0, points.normal_components(SOLID)]
    assert normal == pytest.approx(normal[0], rel=1e-12)
    assert -normal[0] > 5 * pressure
    assert void_ratio[0] == pytest.approx(SAND.characteristic_void_ratios(-normal[0]).e_i, rel=1e-5)


def test_layouts_agree_where_they_overlap() -> None:
    """A layer's increment in the plane and in the solid, and a symmetric one in the classical continuum."""
    rng = np.random.default_rng(3)
    increment = rng.normal(size=(1, LAYER.n_inputs)) * [1e-3, 1e-2, 1e-2, 1.0, 1e-2]
    results = {}
    for one in (LAYER, PLANE, SOLID):
        wide = np.zeros((1, one.n_inputs))
        targets = [one.strain.index(c) for c in LAYER.strain]
        targets.append(len(one.strain) + one.curvature.index((2, 1)))
        targets.append(len(one.strain_slots) + one.spin.index((0, 1)))
        wide[:, targets] = increment
        result = points.update(one, wide, isotropic(one, 1e5), np.array([0.6]), substeps=4, tangent=False)
        results[one] = [result.forces[0, one.forces.index(c)] for c in LAYER.stress]
    assert results[PLANE] == pytest.approx(results[LAYER], rel=1e-12)
    assert results[SOLID] == pytest.approx(results[LAYER], rel=1e-12)
    polar = points.update(
        PLANE, strain(PLANE, s00=1e-3, s01=5e-3, s10=5e-3), isotropic(PLANE, 1e5), np.array([0.6]), tangent=False
    )
    classical = points.update(
        CLASSICAL, strain(CLASSICAL, s00=1e-3, s01=5e-3), isotropic(CLASSICAL, 1e5), np.array([0.6]), tangent=False
    )
    for component in CLASSICAL.stress:
        expected = polar.forces[0, PLANE.stress.index(component)]
        assert classical.forces[0, CLASSICAL.stress.index(component)] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("one", "increment", "void_ratio", "max_substeps", "status"),
    [
        (PLANE, {"s00": 0.3, "s11": 0.3}, 0.6, 8, {Status.TENSION, Status.LOCAL_NEWTON, Status.RADICAND}),
        (PLANE, {"s01": 1e-3}, 0.46, 4, {Status.DENSER_THAN_E_D}),
        (LAYER, {"s01": 0.2}, 0.6, 1, {Status.SUBSTEPS}),
        (LAYER, {"s01": np.nan}, 0.6, 8, {Status.NOT_FINITE}),
    ],
    ids=["stretched", "too dense", "too few substeps", "not a number"],
)
def test_a_point_that_cannot_be_updated_says_why_and_stays(
    one: Layout, increment: dict[str, float], void_ratio: float, max_substeps: int, status: set[Status]
) -> None:
    forces, e = isotropic(one, 1e5), np.array([void_ratio])
    result = points.update(
        one, strain(one, **increment), forces, e, adapt=True, tolerance=1e-6, max_substeps=max_substeps
    )
    assert Status(result.worst) in status
    assert result.status[0] == result.worst >= FIRST_FAILURE
    assert result.where == 0
    assert np.array_equal(result.forces, forces)
    assert np.array_equal(result.void_ratio, e)
    assert not result.tangent.any()


def test_a_point_looser_than_e_i_goes_on() -> None:
    loosest = SAND.characteristic_void_ratios(1e5).e_i
    result = points.update(LAYER, shear(LAYER, 1e-3), isotropic(LAYER, 1e5), np.array([1.05 * loosest]), substeps=4)
    assert result.status[0] == Status.LOOSER_THAN_E_I < FIRST_FAILURE
    assert np.isfinite(result.forces).all()
    assert result.tangent.any()


def test_the_trial_is_a_pure_function_and_points_are_independent() -> None:
    rng = np.random.default_rng(4)
    m = 50
    forces = points.draw_forces(rng, LAYER, np.full(m, 1e5), rng.uniform(0.1, 0.9, m))
    e = points.draw_void_ratio(rng, np.full(m, 1e5))
    increments = points.draw_increments(rng, LAYER, np.full(m, 1e-3))
    before = forces.copy(), e.copy()
    batch = points.update(LAYER, increments, forces, e, substeps=3)
    again = points.update(LAYER, increments, forces, e, substeps=3)
    assert np.array_equal(batch.forces, again.forces)
    assert np.array_equal(batch.tangent, again.tangent)
    assert np.array_equal(forces, before[0])
    assert np.array_equal(e, before[1])
    order = rng.permutation(m).astype(np.int32)
    shuffled = points.update(LAYER, increments[order], forces, e, substeps=3, points=order)
    assert np.array_equal(shuffled.forces, batch.forces)
    for q in range(0, m, 10):
        alone = points.update(LAYER, increments[q : q + 1], forces[q : q + 1], e[q : q + 1], substeps=3)
        assert np.array_equal(alone.forces[0], batch.forces[q])


def test_effects_that_are_off_change_nothing() -> None:
    forces, e, increment = isotropic(LAYER, 1e5), np.array([0.6]), shear(LAYER, 0.01)
    still = increment.copy()
    still[0, -1] = 0.0
    without = points.update(LAYER, increment, forces, e, substeps=4, spin=False, tangent=False)
    at_rest = points.update(LAYER, still, forces, e, substeps=4, tangent=False)
    assert without.forces == pytest.approx(at_rest.forces, rel=1e-12, abs=1e-9)
    compressed = increment + strain(LAYER, s11=-1e-3)
    frozen = points.update(LAYER, compressed, forces, e, substeps=4, evolving=False, tangent=False)
    moving = points.update(LAYER, compressed, forces, e, substeps=4, tangent=False)
    assert frozen.void_ratio[0] == 0.6
    assert moving.void_ratio[0] == pytest.approx(1.6 * np.exp(-1e-3) - 1, rel=1e-14)
