"""What the update promises its callers: a pure function of each point, and a reason where a point fails."""

from math import log10

import numpy as np
import pytest
from points import (
    LAYER,
    PLANE,
    SAND,
    components,
    draw,
    draw_forces,
    draw_increments,
    draw_void_ratio,
    exact,
    force_difference,
    normal_components,
    update,
)
from reference_law import characteristic_void_ratios

from cosserat_fx import rows as row
from cosserat_fx.dense import factorise, solve
from cosserat_fx.hypoplasticity import FIRST_FAILURE, REASONS, Status
from cosserat_fx.stages import mark_lost
from cosserat_fx.typing import Array

WRITTEN = ("forces", "void_ratio", "tangent", "substeps", "status", "error")

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
    """The other points are of no use then, and go no further than their first attempt; the report is on the gravest."""
    forces, void_ratio, increments = draw(LAYER, 9, (1e-2, 1e-1), pressures=(1e4, 1e6), seed=19)
    alone = update(LAYER, increments, forces, void_ratio, adapt=True)
    assert alone.worst < FIRST_FAILURE
    forces[4], forces[7] = with_stress(s11=-400e3, s22=150e3, s33=150e3), -ISOTROPIC
    result = update(LAYER, increments, forces, void_ratio, adapt=True)
    assert (result.worst, result.where) == (Status.TENSION, 7)
    assert result.status[4] == Status.RADICAND
    others = np.delete(np.arange(9), (4, 7))
    assert result.substeps[others].sum() < alone.substeps[others].sum() / 2
    for failing in (4, 7):
        np.testing.assert_array_equal(result.forces[failing], forces[failing])


def test_a_zero_pivot_does_not_pass_as_an_answer() -> None:
    """Factors without pivoting leave what is not finite behind it, which is noticed, in its own lane alone."""
    rows = np.full((row.NUMBER, row.LANES), np.nan)
    rows[row.MATRIX : row.MATRIX + 4, :3] = np.array(
        [[2.0, 0.0, 1.0], [1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [3.0, 0.0, 1.0]]
    )
    rows[row.CORRECTION : row.CORRECTION + 2, :3] = 1.0
    factorise(rows, row.MATRIX, 2, 3)
    solve(rows, row.MATRIX, row.CORRECTION, 2, 1, 3)
    mark_lost(rows, row.CORRECTION, 2, 3)
    assert (rows[row.ALONG, :3] != 0).tolist() == [False, True, False]
    assert rows[row.CORRECTION : row.CORRECTION + 2, 0] == pytest.approx([0.4, 0.2])


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
