import dataclasses
import math
import pickle

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosserat_fx.material import NAMED_SETS, KernelConstants, Material, MaterialError

SAND = Material.named("paper-sand")


def test_void_ratios_at_100_kpa_are_those_of_the_theory_page() -> None:
    ratios = SAND.characteristic_void_ratios(100e3)
    assert ratios == pytest.approx((1.1124644, 0.7601840, 0.4727974), abs=5e-8)
    assert (ratios.e_i, ratios.e_c, ratios.e_d) == ratios


def test_bracket_and_isotropic_factor_are_those_of_the_theory_page() -> None:
    assert SAND.a_isotropic == pytest.approx(0.3265986, abs=5e-8)
    assert SAND.h_i == pytest.approx(0.2340900, abs=5e-8)


def test_void_ratios_start_at_their_constants_and_vanish_under_infinite_pressure() -> None:
    assert SAND.characteristic_void_ratios(0.0) == (SAND.e_i0, SAND.e_c0, SAND.e_d0)
    assert SAND.characteristic_void_ratios(math.inf) == (0.0, 0.0, 0.0)


def test_void_ratios_of_an_array_are_those_of_its_entries() -> None:
    pressures = np.array([[1e3, 1e5], [1e6, 1e7]])
    together = SAND.characteristic_void_ratios(pressures)
    for index, pressure in np.ndenumerate(pressures):
        one_by_one = SAND.characteristic_void_ratios(float(pressure))
        assert tuple(ratio[index] for ratio in together) == pytest.approx(one_by_one, rel=1e-14)


@given(pressure=st.floats(1e-3, 1e9), factor=st.floats(1.001, 1e3))
def test_void_ratios_keep_their_order_and_proportion_and_fall_with_pressure(pressure: float, factor: float) -> None:
    e_i, e_c, e_d = SAND.characteristic_void_ratios(pressure)
    assert 0 < e_d < e_c < e_i
    assert e_i / SAND.e_i0 == pytest.approx(e_c / SAND.e_c0) == pytest.approx(e_d / SAND.e_d0)
    assert all(np.less(SAND.characteristic_void_ratios(pressure * factor), (e_i, e_c, e_d)))


@pytest.mark.parametrize("pressure", [-1.0, math.nan, np.array([1e5, -1e5])])
def test_tension_has_no_void_ratios(pressure: float) -> None:
    with pytest.raises(MaterialError, match=r"mean_pressure = .*: must be at least 0 \(Pa"):
        SAND.characteristic_void_ratios(pressure)


@pytest.mark.parametrize(
    ("changes", "key", "allowed"),
    [
        ({"e_d0": 0.0}, "e_d0", "greater than 0 and less than e_c0 = 0.82"),
        ({"e_d0": 0.82}, "e_d0", "less than e_c0 = 0.82"),
        ({"e_c0": 1.2}, "e_c0", "less than e_i0 = 1.2"),
        ({"e_i0": 0.8}, "e_c0", "less than e_i0 = 0.8"),
        ({"phi_c": 0}, "phi_c", "greater than 0 and less than 90 (degrees)"),
        ({"phi_c": 90}, "phi_c", "greater than 0 and less than 90 (degrees)"),
        ({"h_s": 0}, "h_s", "greater than 0 (Pa)"),
        ({"alpha": 0}, "alpha", "greater than 0"),
        ({"beta": -0.1}, "beta", "at least 0"),
        ({"n": 0}, "n", "greater than 0 and less than 1"),
        ({"n": 1}, "n", "greater than 0 and less than 1"),
        ({"d50": -0.5e-3}, "d50", "greater than 0 (m)"),
        ({"a_c": 0}, "a_c", "greater than 0"),
        ({"alpha": 2}, "alpha", "bracket h_i = -0.49"),
        ({"alpha": 1e9}, "alpha", "bracket h_i = -inf"),
    ],
)
def test_inadmissible_constants_are_refused(changes: dict[str, float], key: str, allowed: str) -> None:
    with pytest.raises(MaterialError) as caught:
        Material.named("paper-sand", **changes)
    expected = float(changes.get(key, getattr(SAND, key)))
    assert (caught.value.key, caught.value.value) == (key, expected)
    assert allowed in caught.value.allowed
    assert str(caught.value) == f"{key} = {expected!r}: {caught.value.allowed}"


@pytest.mark.parametrize("key", [field.name for field in dataclasses.fields(Material)])
@pytest.mark.parametrize("value", [math.nan, math.inf, True, "0.5", None, 10**400])
def test_only_finite_numbers_are_constants(key: str, value: object) -> None:
    with pytest.raises(MaterialError, match="must be a finite number") as caught:
        dataclasses.replace(SAND, **{key: value})  # type: ignore[arg-type]
    assert (caught.value.key, caught.value.value) == (key, value)


def test_alpha_is_admissible_exactly_up_to_the_root_of_the_bracket() -> None:
    with pytest.raises(MaterialError) as caught:
        Material.named("paper-sand", alpha=2.0)
    limit = float(caught.value.allowed.split("less than ")[1].split(",")[0])
    assert Material.named("paper-sand", alpha=limit * (1 - 1e-4)).h_i == pytest.approx(0, abs=1e-4)
    with pytest.raises(MaterialError):
        Material.named("paper-sand", alpha=limit * (1 + 1e-4))


def test_a_named_set_takes_overrides_and_keeps_the_rest() -> None:
    coarse = Material.named("paper-sand", d50=5e-3, beta=2)
    assert dataclasses.replace(coarse, d50=SAND.d50, beta=SAND.beta) == SAND == NAMED_SETS["paper-sand"]
    assert (coarse.d50, coarse.beta) == (5e-3, 2.0)
    assert isinstance(coarse.beta, float)


def test_an_unknown_set_is_refused_with_the_known_ones() -> None:
    with pytest.raises(MaterialError, match=r'"paper-sand" \(did you mean "paper-sand"\?\)') as caught:
        Material.named("papersand")
    assert (caught.value.key, caught.value.value) == ("constants", "papersand")


def test_an_unknown_constant_is_refused() -> None:
    with pytest.raises(TypeError, match="phi"):
        Material.named("paper-sand", phi=30.0)


def test_a_material_error_survives_pickling() -> None:
    error = pickle.loads(pickle.dumps(MaterialError("n", 2.0, "must be less than 1")))
    assert str(error) == "n = 2.0: must be less than 1"


def test_kernel_parameters_are_floats_that_numba_takes_by_name() -> None:
    @numba.njit()
    def largest_void_ratio_times_bracket(c: KernelConstants) -> float:
        return c.e_i0 * c.h_i

    parameters = SAND.kernel_parameters()
    shared = {name: getattr(SAND, name) for name in KernelConstants._fields}
    assert parameters._asdict() == shared
    assert all(type(value) is float for value in parameters)
    assert parameters.c_phi == pytest.approx(0.5 / 2.5)
    assert largest_void_ratio_times_bracket(parameters) == pytest.approx(SAND.e_i0 * SAND.h_i)
