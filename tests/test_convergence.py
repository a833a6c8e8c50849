"""Limits of sequences and rates, on sequences whose limits and rates are known."""

import math

import numpy as np
import pytest

from cosserat_fx.studies.convergence import fit_rate, limit, size
from cosserat_fx.typing import Array

PROFILE: Array = np.sin(np.linspace(0.0, 3.0, 50))
CHANGE: Array = np.cos(np.linspace(0.0, 2.0, 50))


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
@pytest.mark.parametrize(("exact", "change"), [(3.0, -0.2), (PROFILE, CHANGE)])
def test_a_power_of_the_resolution_is_extrapolated_to_its_limit(
    order: float, exact: float | Array, change: float | Array
) -> None:
    values = [exact + change * 2.0 ** (-order * level) for level in range(4)]
    found = limit(values, steady=0.1)
    assert found.extrapolated
    assert found.rate == pytest.approx(order)
    assert found.value == pytest.approx(exact, abs=1e-12)
    assert found.error >= size(values[-1] - np.asarray(exact)) * (1 - 1e-9) or order > 1.0
    assert found.error >= size(values[-1] - values[-2])


@pytest.mark.parametrize(
    "values",
    [
        [1.0, 1.1, 1.05],  # to and fro
        [1.0, 1.1, 1.2],  # no convergence at all
        [1.0, 1.8, 1.9],  # of order 3, faster than any method here
        [1.0, 1.1, 1.1],  # the same by chance
        [PROFILE, PROFILE + CHANGE, PROFILE + CHANGE + 0.5 * CHANGE[::-1] * np.sign(CHANGE)],  # another direction
        [1.0, 1.1],
    ],
)
def test_where_there_is_no_clean_rate_the_finest_counts(values: list[float] | list[Array]) -> None:
    found = limit(values)
    assert not found.extrapolated
    assert np.array_equal(found.value, values[-1])
    assert found.error >= size(np.subtract(values[-1], values[-2]))


def test_a_last_change_that_is_small_by_chance_does_not_make_the_error_small() -> None:
    found = limit([1.0, 1.4, 1.4])
    assert (float(found.value), found.extrapolated) == (1.4, False)
    assert found.error == pytest.approx(0.1)


def test_a_rate_has_to_be_steady_where_that_is_asked_for() -> None:
    changing = np.cumsum([0.0, 1.0, 0.9 / 2**0.1, 0.225]).tolist()
    assert limit(changing).rate == pytest.approx(math.log2(0.9 / 2**0.1 / 0.225))
    assert not limit(changing, steady=1.0).extrapolated


def test_an_exact_power_is_fitted_without_doubt() -> None:
    sizes = [1.0, 0.5, 0.25, 0.125]
    rate = fit_rate(sizes, [3.0 * h**1.7 for h in sizes])
    assert rate is not None
    assert rate.order == pytest.approx(1.7)
    assert rate.factor == pytest.approx(3.0)
    assert rate.points == 4
    assert rate.standard_error == pytest.approx(0.0, abs=1e-6)


def test_the_standard_error_is_that_of_least_squares() -> None:
    logarithms = np.array([0.0, 2.2, 3.8, 6.0])
    rate = fit_rate([1.0, math.e, math.e**2, math.e**3], np.exp(logarithms).tolist())
    assert rate is not None
    residuals = logarithms - np.polyval(np.polyfit(range(4), logarithms, 1), range(4))
    assert rate.standard_error == pytest.approx(math.sqrt(residuals @ residuals / 2 / 5))


def test_two_points_have_a_slope_but_no_doubt_and_one_has_none() -> None:
    rate = fit_rate([1.0, 0.5], [4.0, 1.0])
    assert rate is not None
    assert rate.order == pytest.approx(2.0)
    assert math.isnan(rate.standard_error)
    assert str(rate) == "2.00"
    assert fit_rate([1.0], [1.0]) is None
