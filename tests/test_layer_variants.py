"""Layers that are another layer in disguise, other walls, other effects, and runs that have to stop early."""

from pathlib import Path

import numpy as np
import pytest
from layers import D50, HEIGHT, PRESSURE, REQUESTED, SAND, VOID_RATIO, difference, scene, unevenness, walk

from cosserat_fx.audit import FAIR_SMALL_STRAIN
from cosserat_fx.hypoplasticity import REASONS
from cosserat_fx.results import Run, Table, read_run
from cosserat_fx.run import run as run_scene

SOLVER_TOLERANCE = 1e-8
LOADED_TOP = f"normal_stress={-PRESSURE}"


def agree(a: Table, b: Table, factors: dict[str, float], tolerance: float = SOLVER_TOLERANCE) -> None:
    """Columns of b are factors times those of a."""
    for name, factor in factors.items():
        assert difference(factor * a[name], b[name]) < tolerance, name


# -- the same layer in disguise ----------------------------------------------------------------------------------------


def test_a_layer_ten_times_as_high_of_grains_ten_times_as_coarse_is_the_same(
    tmp_path: Path, default_runs: dict[str, Run]
) -> None:
    """Lengths come with grain diameters only."""
    large = walk(
        tmp_path / "run",
        "medium_rough",
        "geometry.height=0.4",
        "material.d50=5e-3",
        "walls.top.shear_displacement=0.3",
        "output.profiles_at=[0.04, 0.1, 0.2, 0.3]",
    )
    small = default_runs["medium_rough"]
    agree(small.history, large.history, {"top_displacement_m": 10, "height_change_m": 10, "shear_stress_Pa": 1})
    agree(small.profiles, large.profiles, {"u1_m": 10, "omega_rad": 1, "void_ratio": 1, "s11_Pa": 1, "m32_N_per_m": 10})


def test_stresses_come_with_the_granulate_hardness_only(tmp_path: Path, default_runs: dict[str, Run]) -> None:
    hard = ("material.h_s=1.9e9", "initial.stress=-1e6", "walls.top.normal_stress=-1e6")
    run, soft = walk(tmp_path / "run", "medium_rough", *hard), default_runs["medium_rough"]
    agree(soft.history, run.history, {"top_displacement_m": 1, "height_change_m": 1, "shear_stress_Pa": 10})
    agree(soft.profiles, run.profiles, {"u1_m": 1, "omega_rad": 1, "void_ratio": 1, "s11_Pa": 10, "m32_N_per_m": 10})


def test_shearing_to_the_left_is_shearing_to_the_right_in_a_mirror(
    tmp_path: Path, default_runs: dict[str, Run]
) -> None:
    """A mirror that turns x1 turns what has one index 1, counting the axial w and the first index of m as one."""
    leftwards = ("walls.top.shear_displacement=-0.03", "output.profiles_at=[-0.004, -0.01, -0.02, -0.03]")
    left, right = walk(tmp_path / "run", "medium_rough", *leftwards), default_runs["medium_rough"]
    agree(right.history, left.history, {"top_displacement_m": -1, "shear_stress_Pa": -1, "height_change_m": 1})
    even = dict.fromkeys(("u2_m", "void_ratio", "s11_Pa", "s22_Pa", "s33_Pa", "m31_N_per_m"), 1.0)
    odd = dict.fromkeys(("u1_m", "omega_rad", "s12_Pa", "s21_Pa", "m32_N_per_m"), -1.0)
    agree(right.profiles, left.profiles, even | odd)


def test_driving_the_bottom_is_driving_the_top_after_half_a_turn(tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """Half a turn about x3 reverses heights, displacements and couple stresses; w and the stresses stay."""
    walls = (
        "walls.bottom={rolling=0.0125, shear_displacement=-0.03}",
        f"walls.top={{rolling=0.0, {LOADED_TOP}}}",
    )
    bottom, top = walk(tmp_path / "run", "very_rough", *walls), default_runs["medium_rough"]
    assert difference(top.history["top_displacement_m"], -bottom.history["bottom_displacement_m"]) < SOLVER_TOLERANCE
    agree(top.history, bottom.history, {"shear_stress_Pa": 1, "height_change_m": 1, "void_ratio_max": 1})
    assert not np.any(bottom.history["top_displacement_m"])
    for here, there in zip(bottom.profile_blocks(), top.profile_blocks(), strict=True):
        turned = {name: column[::-1] for name, column in here.items()}
        kept = dict.fromkeys(("omega_rad", "void_ratio", "s11_Pa", "s33_Pa", "s12_Pa", "s21_Pa"), 1.0)
        agree(there, turned, kept | dict.fromkeys(("u1_m", "m31_N_per_m", "m32_N_per_m"), -1.0))
    assert bottom.summary["band"]["touches"] == "bottom"


def test_a_wall_that_slides_and_rolls_is_a_rolling_one_that_moves_less(
    tmp_path: Path, default_runs: dict[str, Run]
) -> None:
    """f_u = 0.8 of 37.5 mm reach the grains, 3 cm; f_r/f_u is the medium rough wall's; the rest is sliding."""
    wall = f"walls.top={{f_u=0.8, f_r=0.01, f_s=0.19, shear_displacement=0.0375, {LOADED_TOP}}}"
    stations = "output.profiles_at=[0.005, 0.0125, 0.025, 0.0375]"
    fractions = walk(tmp_path / "run", "very_rough", wall, stations, "stepping.first_step=1.25e-4")
    rolling = default_runs["medium_rough"]
    agree(rolling.history, fractions.history, {"top_displacement_m": 1.25, "shear_stress_Pa": 1, "height_change_m": 1})
    agree(rolling.profiles, fractions.profiles, {"u1_m": 1, "omega_rad": 1, "void_ratio": 1, "m32_N_per_m": 1})


# -- other walls -------------------------------------------------------------------------------------------------------


def test_two_medium_rough_walls_share_the_shear(tmp_path: Path) -> None:
    """Both drive by half and roll: the layer stays alike from above and below, with a band at each wall."""
    run = walk(
        tmp_path / "run",
        "very_rough",
        "walls.bottom={rolling=0.0125, shear_displacement=-0.015}",
        f"walls.top={{rolling=0.0125, shear_displacement=0.015, {LOADED_TOP}}}",
    )
    assert run.summary["status"] == "done"
    last = run.profile_blocks()[-1]
    for name in ("shear_strain", "omega_rad", "void_ratio", "s11_Pa", "s21_Pa"):
        assert difference(last[name], last[name][::-1]) < 1e-6
    strain = np.abs(last["shear_strain"])
    assert min(strain[0], strain[-1]) > 10 * strain[len(strain) // 2]


def test_a_layer_that_moves_as_a_whole_is_not_sheared(tmp_path: Path) -> None:
    """After 1 mm of shear both walls go 1 cm to the right: nothing happens, in a few steps."""
    run = walk(
        tmp_path / "run",
        "very_rough",
        "walls.bottom={shear_displacement=[0.0, 0.01]}",
        f"walls.top={{shear_displacement=[0.001, 0.011], {LOADED_TOP}}}",
        "output.profiles_at=[0.001]",
        "stepping.max_steps=60",
    )
    assert run.summary["status"] == "done"
    moving = run.history["bottom_displacement_m"] > 0
    sheared = run.history["shear_stress_Pa"]
    assert sheared[moving] == pytest.approx(sheared[~moving][-1], rel=SOLVER_TOLERANCE)


@pytest.mark.parametrize("wall", ["very_rough", "medium_rough"])
def test_at_constant_height_dilating_sand_presses_against_the_walls(wall: str, tmp_path: Path) -> None:
    """The wall does not rise, so the mean of the void ratio stays; the sand that wants to dilate builds up pressure."""
    rolling = {"very_rough": 0.0, "medium_rough": 0.0125}[wall]
    top = f"walls.top={{rolling={rolling}, constant_height=true, shear_displacement=0.03}}"
    run = walk(tmp_path / "run", wall, top)
    assert run.summary["status"] == "done"
    assert not np.any(run.history["height_change_m"])
    assert run.history["normal_stress_Pa"][-1] < -10 * PRESSURE
    for profile in run.profile_blocks():
        assert np.mean(profile["void_ratio"]) == pytest.approx(VOID_RATIO, abs=2e-6)
        assert unevenness(profile["s22_Pa"]) < SOLVER_TOLERANCE


@pytest.mark.parametrize("pressure", [200e3, 50e3])
def test_a_normal_stress_that_differs_from_the_initial_one_comes_first(pressure: float, tmp_path: Path) -> None:
    """The layer is compressed, or relieved, without shear; what is prescribed is reached before the wall moves."""
    run = walk(tmp_path / "run", "very_rough", f"walls.top.normal_stress={-pressure}")
    history = run.history
    assert run.summary["status"] == "done"
    resting = history["top_displacement_m"] == 0
    assert 0 < resting.sum() < len(resting)
    assert history["normal_stress_Pa"][resting][-1] == pytest.approx(-pressure, rel=SOLVER_TOLERANCE)
    assert history["normal_stress_Pa"][~resting] == pytest.approx(-pressure, rel=SOLVER_TOLERANCE)
    assert np.max(np.abs(history["shear_stress_Pa"][resting])) < SOLVER_TOLERANCE * pressure
    settled = history["height_change_m"][resting]
    assert np.all(np.diff(settled) * (PRESSURE - pressure) > 0)
    assert set(REQUESTED) <= set(history["top_displacement_m"])
    assert run.summary["friction"]["residual_friction"] == pytest.approx(0.5957, rel=0.01)


# -- other effects -----------------------------------------------------------------------------------------------------


def test_without_grain_rotations_the_layer_shears_evenly(tmp_path: Path) -> None:
    """Classical hypoplasticity has no length: no band on the primary branch, no couple stress, equal shear stresses."""
    run = walk(tmp_path / "run", "very_rough", "effects.polar=false")
    assert run.summary["status"] == "done"
    assert run.summary["sizes"]["unknowns"] == 2 * 81
    for profile in run.profile_blocks():
        assert unevenness(profile["shear_strain"]) < SOLVER_TOLERANCE
        assert unevenness(profile["void_ratio"]) < SOLVER_TOLERANCE
        assert np.array_equal(profile["s12_Pa"], profile["s21_Pa"])
        assert not np.any([profile[name] for name in ("omega_rad", "m31_N_per_m", "m32_N_per_m")])
    assert run.summary["band"]["touches"] == "both"
    assert run.summary["friction"]["peak_friction"] == pytest.approx(0.632, rel=0.01)


def test_which_spin_matters_little(tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """The Jaumann terms move peak and residual by about 0.7 %; on whose spin they stand hardly matters."""
    macro = default_runs["medium_rough"].summary["friction"]
    for spin, low, high in (("none", 0.004, 0.010), ("cosserat", 0.0, 0.002)):
        run = walk(tmp_path / spin, "medium_rough", f'effects.spin="{spin}"')
        for key in ("refined_peak_shear_stress_Pa", "residual_shear_stress_Pa"):
            assert low < abs(run.summary["friction"][key] / macro[key] - 1) < high


def test_a_frozen_void_ratio_stays(tmp_path: Path) -> None:
    run = walk(tmp_path / "run", "very_rough", "effects.void_ratio=false")
    assert run.summary["status"] == "done"
    assert set(run.history["void_ratio_max"]) == set(run.history["void_ratio_min"]) == {VOID_RATIO}
    assert run.summary["friction"]["peak_friction"] == run.summary["friction"]["residual_friction"]


def test_small_strains_that_grow_large_are_told(tmp_path: Path) -> None:
    run = walk(tmp_path / "run", "very_rough", "effects.finite_strain=false")
    largest = run.history["max_shear_strain"].max()
    assert largest > FAIR_SMALL_STRAIN
    [warning] = run.summary["warnings"]
    assert warning.startswith(f"finite strain was off, but the shear strain reached {largest:.3g}")
    assert "effects.finite_strain = true" in warning


def test_small_displacements_are_taken_as_small_strains_and_fairly_so(tmp_path: Path) -> None:
    """1 mm is 2.5 % of the height: auto says small, there is no warning, and finite strains differ by less than 1 %."""
    short = ("walls.top.shear_displacement=0.001", "output.profiles_at=[0.001]")
    small = walk(tmp_path / "small", "very_rough", *short)
    finite = walk(tmp_path / "finite", "very_rough", *short, "effects.finite_strain=true")
    chosen = {effect["name"]: effect["choice"] for effect in small.summary["effects"]}
    assert (chosen["finite strain"], chosen["spin"]) == ("off", "none")
    assert small.summary["warnings"] == []
    ends = [run.history["shear_stress_Pa"][-1] for run in (small, finite)]
    assert 1e-5 < abs(ends[0] / ends[1] - 1) < 0.01


def test_a_point_looser_than_the_law_knows_is_told(tmp_path: Path) -> None:
    """Strong rolling dilates the grains at the wall beyond e_i: once, with where and from when."""
    run = walk(tmp_path / "run", "medium_rough", "walls.top.rolling=0.125")
    assert run.summary["status"] == "done"
    [warning] = run.summary["warnings"]
    assert "e_i" in warning
    assert "first at y = 0.03" in warning
    loose = run.history["void_ratio_max"] > SAND.characteristic_void_ratios(PRESSURE).e_i
    travel = run.history["top_displacement_m"][np.argmax(loose)]
    assert loose.any()
    assert not loose.all()
    assert f"from a travel of {travel:.6g} m on" in warning


# -- runs that stop early ----------------------------------------------------------------------------------------------


def test_sand_that_liquefies_stops_the_run_and_leaves_what_was_computed(tmp_path: Path) -> None:
    """Very loose sand at constant height contracts until it carries nothing: static liquefaction, the law's end."""
    top = "walls.top={constant_height=true, shear_displacement=0.03}"
    loose = scene("very_rough", top, "initial.void_ratio=1.05", "geometry.cells=40", "stepping.min_step=1e-6")
    ledger = run_scene(loose, tmp_path / "run")
    run = read_run(tmp_path / "run")
    assert run.summary["status"] == "stopped"
    assert run.summary["reason"] == ledger.reason
    reached = run.history["top_displacement_m"][-1]
    assert f"the step from {reached:.9g} m failed at the smallest size, 1e-06 m: " in run.summary["reason"]
    assert len(run.history["step"]) == run.summary["steps"] == ledger.steps > 10
    done = [travel for travel in REQUESTED if travel <= reached]
    assert [block["top_displacement_m"][0] for block in run.profile_blocks()] == done == [0.004, 0.01]
    assert abs(run.history["normal_stress_Pa"][-1]) < 0.01 * PRESSURE
    assert np.all(run.history["step_size_m"] >= 1e-6)
    assert run.summary["cutbacks"] > 0


def test_a_law_that_fails_says_why_and_where(tmp_path: Path) -> None:
    """Rolling 1600 times as strong as on the medium rough wall drives the grains beside it out of the law's domain."""
    run = walk(tmp_path / "run", "medium_rough", "walls.top.rolling=20.0", "stepping.min_step=1e-5")
    assert run.summary["status"] == "stopped"
    assert len(run.history["step"]) == run.summary["steps"] < 5
    reached = run.summary["steps"] and run.history["top_displacement_m"][-1]
    cause = run.summary["reason"].removeprefix(f"the step from {reached:.9g} m failed at the smallest size, 1e-05 m: ")
    reason, _, place = cause.rpartition(" at ")
    assert reason in REASONS.values()
    assert HEIGHT - 2 * D50 < float(place.removesuffix(" m")) < HEIGHT


def test_a_run_may_be_limited_to_some_steps(tmp_path: Path) -> None:
    run = walk(tmp_path / "run", "very_rough", "stepping.max_steps=3")
    assert run.summary["status"] == "stopped"
    assert run.summary["reason"].startswith("the run reached its limit of 3 steps at a travel of ")
    assert run.history["step"].tolist() == [1, 2, 3]
    assert run.profiles["step"].size == 0
    assert run.summary["band"]["shear_strain_max"] == run.history["max_shear_strain"][-1]  # measured all the same


def test_steps_stay_within_the_bounds_of_the_scene(tmp_path: Path) -> None:
    bounds = ("stepping.min_step=5e-5", "stepping.first_step=2e-4", "stepping.max_step=1e-3")
    run = walk(tmp_path / "run", "very_rough", *bounds)
    sizes = run.history["step_size_m"]
    assert sizes[0] == 2e-4
    assert sizes.max() == pytest.approx(1e-3, rel=1e-9)
    assert sizes.min() >= 5e-5
