"""Band and friction metrics on profiles and histories whose answers are known in closed form."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from numpy.typing import ArrayLike

from cosserat_fx.output.layer_bands import BandMetrics, band_metrics, friction_metrics, wall_travel
from cosserat_fx.typing import Array

HEIGHT, D50 = 0.04, 0.5e-3
SIGMA = 2e-3
FWHM = 2.0 * np.sqrt(2.0 * np.log(2.0)) * SIGMA


def points(cells: int) -> Array:
    return (np.arange(cells) + 0.5) * HEIGHT / cells


def measure(y: Array, strain: Array, **columns: ArrayLike) -> BandMetrics:
    plain = {"void_ratio": 0.7, "s11_Pa": -100e3, "s22_Pa": -100e3, "s33_Pa": -100e3, "s12_Pa": 50e3, **columns}
    profile = {name: np.broadcast_to(np.asarray(value, dtype=np.float64), y.shape) for name, value in plain.items()}
    return band_metrics({"y_m": y, "shear_strain": strain, **profile}, 0.76, d50=D50, height=HEIGHT)


def gaussian(y: Array, middle: float) -> Array:
    return 3.0 * np.exp(-0.5 * ((y - middle) / SIGMA) ** 2)


def test_full_width_of_a_gaussian_converges_with_second_order() -> None:
    """The peak falls between two points and the crossings are linear: both errors are of second order."""
    cells = np.array([80, 160, 320, 640])
    errors = [abs(measure(points(n), gaussian(points(n), 0.5 * HEIGHT)).thickness_m - FWHM) for n in cells]
    assert errors[0] < 0.01 * FWHM
    order = -np.polyfit(np.log(cells), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_where_a_gaussian_band_lies(sign: float) -> None:
    y = points(401)
    band = measure(y, sign * gaussian(y, 0.3 * HEIGHT))
    assert band.position_m == pytest.approx(0.3 * HEIGHT, abs=0.5 * HEIGHT / 401)
    assert band.relative_position == pytest.approx(0.3, abs=0.5 / 401)
    assert band.centre_m == pytest.approx(0.3 * HEIGHT, abs=1e-6)
    assert band.upper_m - band.lower_m == band.thickness_m == band.thickness_d50 * D50
    assert band.touches is None
    assert band.shear_strain_max == pytest.approx(3.0, rel=1e-3)


def test_a_box_is_as_thick_as_it_is_up_to_half_a_cell() -> None:
    """Between the last point inside (1) and the first outside (0) the strain is 1/2 half-way."""
    y = points(80)
    band = measure(y, np.where((y > 0.010) & (y < 0.015), 1.0, 0.0))
    assert (band.lower_m, band.upper_m) == pytest.approx((0.010, 0.015), abs=1e-12)
    assert band.thickness_d50 == pytest.approx(10.0, abs=1e-9)


def test_a_second_weaker_band_is_not_counted() -> None:
    y = points(400)
    band = measure(y, gaussian(y, 0.01) + 0.8 * gaussian(y, 0.03))
    assert band.thickness_m == pytest.approx(FWHM, rel=0.01)
    assert band.centre_m == pytest.approx(0.01, rel=0.01)


@pytest.mark.parametrize(("middle", "wall"), [(0.0, "bottom"), (HEIGHT, "top")])
def test_a_band_at_a_wall_ends_there(middle: float, wall: str) -> None:
    y = points(640)
    band = measure(y, gaussian(y, middle))
    assert band.touches == wall
    assert (band.lower_m if wall == "bottom" else band.upper_m) == middle
    assert band.thickness_m == pytest.approx(0.5 * FWHM, rel=1e-2)


def test_the_dilated_zone_reaches_from_the_outermost_points_half_way_to_the_loosest_one() -> None:
    """Of a Gaussian it is the full width at half maximum, whatever dips in the middle, and a wall ends it."""
    y = points(640)
    dip = 0.1 * np.exp(-0.5 * ((y - 0.5 * HEIGHT) / (0.1 * SIGMA)) ** 2)
    inside = measure(y, gaussian(y, 0.5 * HEIGHT), void_ratio=0.6 + 0.05 * gaussian(y, 0.5 * HEIGHT) - dip)
    # The largest value is where the dip has faded; the level falls by half of what is missing there.
    assert inside.dilated_thickness_d50 * D50 == pytest.approx(FWHM, rel=0.05)
    assert inside.dilated_lower_m + inside.dilated_upper_m == pytest.approx(HEIGHT)
    at_wall = measure(y, gaussian(y, HEIGHT), void_ratio=0.6 + 0.05 * gaussian(y, HEIGHT))
    assert at_wall.dilated_upper_m == HEIGHT
    assert at_wall.dilated_thickness_d50 * D50 == pytest.approx(0.5 * FWHM, rel=1e-2)


@pytest.mark.parametrize("cells", [1, 2, 80])
def test_a_homogeneous_strain_is_a_band_as_thick_as_the_layer(cells: int) -> None:
    y = points(cells)
    band = measure(y, 1.0 + 0.9 * y / HEIGHT)
    assert (band.lower_m, band.upper_m, band.thickness_m, band.touches) == (0.0, HEIGHT, HEIGHT, "both")


def test_the_state_is_that_in_the_middle_between_the_edges() -> None:
    """Columns linear in y are interpolated exactly; the middle lies between two points."""
    y = points(80)
    rise = y / HEIGHT
    band = measure(
        y,
        gaussian(y, 0.5 * HEIGHT),
        void_ratio=0.6 + 0.2 * rise,
        s11_Pa=-100e3 * (1.0 + rise),
        s22_Pa=-100e3,
        s33_Pa=-100e3 * (1.0 - rise),
        s12_Pa=1e3 * rise,
    )
    assert band.centre_m == pytest.approx(0.5 * HEIGHT)
    assert band.void_ratio == pytest.approx(0.7)
    assert band.void_ratio_over_critical == pytest.approx(0.7 / 0.76)
    assert (band.s11_over_s22, band.s33_over_s22, band.s12_Pa) == pytest.approx((1.5, 0.5, 500.0))
    assert band.void_ratio_max == 0.6 + 0.2 * rise[-1]
    assert band.void_ratio_max_y_m == y[-1]
    assert band.void_ratio_over_critical_max == pytest.approx((0.6 + 0.2 * rise[-1]) / 0.76)


def test_the_critical_void_ratio_may_vary_over_the_height() -> None:
    y = points(80)
    profile = {name: np.full_like(y, -1.0) for name in ("s11_Pa", "s22_Pa", "s33_Pa", "s12_Pa")}
    profile |= {"y_m": y, "shear_strain": gaussian(y, 0.01), "void_ratio": np.full_like(y, 0.7)}
    band = band_metrics(profile, 0.7 + y, d50=D50, height=HEIGHT)
    assert band.critical_void_ratio == pytest.approx(0.7 + band.centre_m)
    assert band.void_ratio_over_critical_max == pytest.approx(0.7 / (0.7 + y[0]))


def test_the_metrics_are_plain_numbers_for_json() -> None:
    y = points(8)
    history = {name: np.array([1.0, 2.0]) for name in ("shear_stress_Pa", "normal_stress_Pa", "top_displacement_m")}
    history["bottom_displacement_m"] = np.zeros(2)
    for metrics in (measure(y, 1.0 + y), friction_metrics(history)):
        assert json.loads(json.dumps(asdict(metrics), allow_nan=False)) == asdict(metrics)


@pytest.mark.parametrize(
    ("y", "strain", "message"),
    [
        ([0.01, 0.01], [1.0, 1.0], "ascend"),
        ([0.03, 0.01], [1.0, 1.0], "ascend"),
        ([0.01, 0.05], [1.0, 1.0], "ascend"),
        ([], [], "ascend"),
        ([0.01, 0.03], [0.0, 0.0], "no band"),
        ([0.01, 0.03], [np.nan, 1.0], "no band"),
    ],
)
def test_a_profile_without_sense_is_refused(y: list[float], strain: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        measure(np.array(y), np.array(strain))


def history(travel: ArrayLike, shear: ArrayLike, normal: ArrayLike = -100e3) -> dict[str, Array]:
    """A history of both walls moving against each other."""
    moved = np.asarray(travel, dtype=np.float64)
    return {
        "top_displacement_m": 0.75 * moved,
        "bottom_displacement_m": -0.25 * moved,
        "shear_stress_Pa": np.broadcast_to(np.asarray(shear, dtype=np.float64), moved.shape),
        "normal_stress_Pa": np.broadcast_to(np.asarray(normal, dtype=np.float64), moved.shape),
    }


def test_travel_is_that_of_the_top_relative_to_the_bottom() -> None:
    np.testing.assert_allclose(wall_travel(history([0.0, 1.0, 4.0], 0.0)), [0.0, 1.0, 4.0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_refined_peak_is_exact_for_a_parabola_on_uneven_steps(sign: float) -> None:
    travel = np.array([0.0, 1.0, 1.7, 2.9, 3.1, 6.0]) * 1e-3
    shear = 60e3 - 1e9 * (travel - 2.2e-3) ** 2
    metrics = friction_metrics(history(sign * travel, sign * shear))
    assert metrics.refined_peak_shear_stress_Pa == pytest.approx(60e3, rel=1e-12)
    assert metrics.refined_peak_shear_stress_travel_m == pytest.approx(sign * 2.2e-3, rel=1e-12)
    assert metrics.refined_peak_friction == pytest.approx(0.6, rel=1e-12)
    assert metrics.refined_peak_friction_travel_m == pytest.approx(sign * 2.2e-3, rel=1e-12)
    assert metrics.peak_shear_stress_Pa == shear[2]
    assert metrics.peak_friction == pytest.approx(shear[2] / 100e3)
    assert metrics.peak_friction_travel_m == pytest.approx(sign * 1.7e-3)
    assert metrics.residual_shear_stress_Pa == abs(shear[-1])
    assert metrics.residual_friction == pytest.approx(abs(shear[-1]) / 100e3)
    assert metrics.residual_travel_m == pytest.approx(sign * 6e-3)


def test_friction_and_shear_stress_peak_apart_when_the_normal_stress_changes() -> None:
    metrics = friction_metrics(history([1.0, 2.0, 3.0], [50.0, 60.0, 90.0], [-100.0, -100.0, -200.0]))
    assert (metrics.peak_friction, metrics.peak_friction_travel_m) == (0.6, 2.0)
    assert (metrics.peak_shear_stress_Pa, metrics.peak_shear_stress_travel_m) == (90.0, 3.0)
    assert metrics.residual_friction == 0.45


def test_a_peak_at_the_end_of_the_leg_is_not_refined() -> None:
    metrics = friction_metrics(history([1.0, 2.0, 3.0], [10.0, 20.0, 25.0]))
    assert metrics.refined_peak_shear_stress_Pa == metrics.peak_shear_stress_Pa == 25.0
    assert metrics.refined_peak_friction_travel_m == metrics.residual_travel_m == 3.0


def test_a_plateau_and_a_rest_are_not_divided_by_zero() -> None:
    assert friction_metrics(history([1.0, 2.0, 3.0], 30.0)).refined_peak_shear_stress_Pa == 30.0
    assert friction_metrics(history([1.0, 2.0, 2.0, 3.0], [1.0, 3.0, 2.0, 1.0])).refined_peak_shear_stress_Pa == 3.0
    assert friction_metrics(history([0.0, 0.0], [1.0, 3.0])).peak_shear_stress_Pa == 3.0


@pytest.mark.parametrize("start", [[], [0.0]])
def test_only_the_first_leg_counts(start: list[float]) -> None:
    """The later legs are rougher, and must not be seen; a row for the layer at rest changes nothing."""
    travel = np.array([*start, 1.0, 2.0, 3.0, 4.0, 3.0, -4.0, 4.0])
    shear = np.array([*(0.0 for _ in start), 30.0, 60.0, 40.0, 35.0, -90.0, -99.0, 99.0])
    metrics = friction_metrics(history(-travel, -shear))
    assert metrics.peak_shear_stress_Pa == 60.0
    assert metrics.residual_shear_stress_Pa == 35.0
    assert metrics.residual_travel_m == -4.0


def test_an_empty_history_is_refused() -> None:
    with pytest.raises(ValueError, match="without a step"):
        friction_metrics(history([], []))
