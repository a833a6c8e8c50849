"""The kernel's own exponential and logarithm, against numpy's."""

import numpy as np
import pytest

from cosserat_fx.elementary import exponential, logarithm
from cosserat_fx.typing import Array

SPACING = float(np.finfo(float).eps)


def relative_error(values: Array, exact: Array) -> float:
    return float(np.abs(values / exact - 1).max())


def test_the_exponential_over_all_of_its_range() -> None:
    x = np.concatenate((np.linspace(-708, 709, 20_001), np.linspace(-1e-3, 1e-3, 2001), np.geomspace(1e-300, 1, 500)))
    assert relative_error(np.array([exponential(v) for v in x]), np.exp(x)) < 2 * SPACING


def test_the_exponential_neither_overflows_nor_vanishes() -> None:
    assert np.isfinite(exponential(1e4))
    assert exponential(-1e4) > 0


def test_the_logarithm_over_all_normal_numbers() -> None:
    x = np.concatenate((np.geomspace(1e-307, 1e307, 20_000), 1 + np.linspace(-1e-3, 1e-3, 2000)))
    assert logarithm(1.0) == 0
    assert relative_error(np.array([logarithm(v) for v in x]), np.log(x)) < 4 * SPACING


@pytest.mark.parametrize("power", [0.4, 0.6, 1.05])
def test_powers_by_both(power: float) -> None:
    """Also where base and exponent are far from one: the error of the logarithm grows with its size."""
    x = np.geomspace(1e-9, 1, 2001)
    assert relative_error(np.array([exponential(power * logarithm(v)) for v in x]), x**power) < 30 * SPACING
