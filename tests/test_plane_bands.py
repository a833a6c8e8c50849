"""Band metrics in the plane, against bands that are known exactly."""

from dataclasses import replace

import numpy as np
import pytest
import specimens
from specimens import AMPLITUDE, BACKGROUND, D50, MIDDLE, WIDTH, Field, Kind, band, specimen

from cosserat_fx.output.plane_bands import NoBandError, PlaneBand, measure_band
from cosserat_fx.output.plane_fields import PlaneState

ANGLES = (30.0, -45.0, 52.3, -65.0)
PROFILES = (specimens.gauss, specimens.sech2)


def measure(state: PlaneState) -> PlaneBand:
    return measure_band(state, specimens.boundaries(), d50=D50)


def errors(size: float, kind: Kind, *, scatter: float = 0.0) -> tuple[float, np.ndarray]:
    """Largest error of the inclination (degrees) and the relative errors of the thickness."""
    rng = np.random.default_rng(3)
    angles, thicknesses = [], []
    for angle in ANGLES:
        for width in (0.006, 0.01):
            for profile in PROFILES:
                state = specimen(band(angle, width, profile=profile), size, kind)
                noise = 1 + scatter * rng.standard_normal(len(state.cells))
                found = measure(replace(state, means={"shear_strain": state.means["shear_strain"] * noise}))
                assert found.whole
                assert found.rises_to == ("right" if angle > 0 else "left")
                angles.append(abs(found.inclination_deg - abs(angle)))
                thicknesses.append(found.thickness_m / specimens.thickness(width, profile) - 1)
    return max(angles), np.array(thicknesses)


@pytest.mark.parametrize("kind", ["even", "graded", "distorted", "triangles"])
def test_inclination_and_thickness_are_as_good_as_told_and_converge(kind: Kind) -> None:
    """The cells smear a band: its variance grows by theirs, so that its thickness grows with their size squared."""
    coarse_angle, coarse = errors(0.0025, kind)
    fine_angle, fine = errors(0.00125, kind)
    assert coarse_angle < 0.15
    assert fine_angle < 0.1
    assert -0.01 < coarse.min() < coarse.max() < 0.075
    assert np.abs(fine).max() < 0.02
    assert np.abs(fine).mean() < 0.4 * np.abs(coarse).mean()


def test_a_third_mesh_leaves_almost_nothing() -> None:
    angle, thickness = errors(0.000625, "even")
    assert angle < 0.05
    assert np.abs(thickness).max() < 0.005


def test_scatter_of_the_cells_does_as_little_harm_as_told() -> None:
    angle, thickness = errors(0.0025, "even", scatter=0.05)
    assert angle < 0.5
    assert np.abs(thickness).max() < 0.09


def test_place_maximum_and_boundaries() -> None:
    found = measure(specimen(band(52.0, 0.008), 0.00125))
    across = specimens.frame(52.0)[1]
    assert (np.array([found.x_m, found.y_m]) - MIDDLE) @ across == pytest.approx(0.0, abs=1e-4)
    assert found.x_m == pytest.approx(WIDTH / 2, abs=1e-3)
    assert found.shear_strain == pytest.approx(AMPLITUDE + BACKGROUND, rel=0.01)
    assert found.shear_strain_max == pytest.approx(AMPLITUDE + BACKGROUND, rel=0.01)
    assert found.thickness_d50 == found.thickness_m / D50
    assert found.meets == ("right", "left")


@pytest.mark.parametrize(("angle", "meets"), [(0.0, ("right", "left")), (90.0, ("bottom", "top"))])
def test_cells_in_rows_along_the_band(angle: float, meets: tuple[str, ...]) -> None:
    found = measure(specimen(band(angle, 0.008)))
    assert found.inclination_deg == pytest.approx(angle, abs=0.05)
    assert found.thickness_m == pytest.approx(specimens.thickness(0.008, specimens.gauss), rel=0.04)
    assert found.meets == meets


def test_the_inclination_on_the_deformed_body() -> None:
    """Shear along the band leaves its direction; shortening by 7 % and widening by 5 % turns it."""
    along, across = specimens.frame(52.0)

    def displacement(points: np.ndarray) -> np.ndarray:
        slip = 0.005 * np.tanh((points - MIDDLE) @ across / 0.004)
        return np.asarray(slip[:, None] * along + points * [0.05, -0.07])

    found = measure(specimen(band(52.0, 0.008), displacement=displacement))
    expected = np.degrees(np.arctan(0.93 / 1.05 * np.tan(np.radians(52.0))))
    assert found.inclination_deg == pytest.approx(52.0, abs=0.1)
    assert found.deformed_inclination_deg == pytest.approx(expected, abs=0.2)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_of_two_crossing_bands_the_stronger_one_is_measured(share: float) -> None:
    one, other = band(52.0, 0.008), band(-52.0, 0.008, background=0.0, amplitude=share * AMPLITUDE)
    found = measure(specimen(lambda points: one(points) + other(points)))
    assert found.inclination_deg == pytest.approx(52.0, abs=0.5)
    assert found.thickness_m == pytest.approx(specimens.thickness(0.008, specimens.gauss), rel=0.06)
    if share < 1:
        assert found.rises_to == "right"


def test_of_a_reflected_band_the_longer_part_is_measured() -> None:
    corner = np.array([WIDTH, 0.09])
    below, above = band(52.0, 0.008, middle=corner), band(-52.0, 0.008, middle=corner, amplitude=1.2)
    found = measure(specimen(lambda points: np.where(points[..., 1] < corner[1], below(points), above(points))))
    assert found.inclination_deg == pytest.approx(52.0, abs=0.2)
    assert found.rises_to == "right"
    assert found.thickness_m == pytest.approx(specimens.thickness(0.008, specimens.gauss), rel=0.04)


def test_a_band_along_a_boundary_ends_there() -> None:
    """Half of it is outside; the other half begins at the boundary."""
    found = measure(specimen(band(0.0, 0.008, middle=np.zeros(2)), 0.00125))
    assert not found.whole
    assert "bottom" in found.meets
    assert found.thickness_m == pytest.approx(specimens.thickness(0.008, specimens.gauss) / 2, rel=0.05)


@pytest.mark.parametrize("thin", [0.001, 0.002])
def test_a_band_thinner_than_the_cells_is_as_thick_as_they_show_it(thin: float) -> None:
    found = measure(specimen(band(52.0, thin)))
    assert found.inclination_deg == pytest.approx(52.0, abs=1.0)
    assert 0.0025 < found.thickness_m < 0.004


@pytest.mark.parametrize(
    ("strain", "reason"),
    [
        (lambda points: 0.0 * points[..., 0], "the shear strain is zero everywhere"),
        (lambda points: 0.2 + 0.1 * points[..., 1] / specimens.HEIGHT, "nearly even: 0.3 at its largest, 0.25 in"),
        (
            lambda points: 0.05 + np.exp(-(((points - MIDDLE) / 0.004) ** 2).sum(axis=-1)),
            "at its largest, 0.05 in the median",
        ),
    ],
    ids=["zero", "even", "spot"],
)
def test_where_there_is_no_band_the_reason_is_told(strain: Field, reason: str) -> None:
    with pytest.raises(NoBandError, match=reason):
        measure(specimen(strain, 0.00125))
