"""The demos' scenes as a whole, and scenes that are hard to solve: all of them run through without help."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from layers import D50, HEIGHT, PRESSURE, REQUESTED, SAND, VOID_RATIO, WALLS, converged, mean_pressure, unevenness, walk

from cosserat_fx.material import Material
from cosserat_fx.results import Run

SOLVER_TOLERANCE = 1e-8

# -- the demos' scenes -------------------------------------------------------------------------------------------------


def test_the_default_scenes_need_few_steps_and_no_cutback(default_run: Run) -> None:
    summary, history = default_run.summary, default_run.history
    assert summary["status"] == "done"
    assert summary["warnings"] == []
    assert 0 < summary["steps"] <= 45
    assert 0 < summary["newton_iterations"] <= 220
    assert summary["cutbacks"] == 0
    assert history["step"].tolist() == list(range(1, summary["steps"] + 1))
    assert history["newton_iterations"].sum() == summary["newton_iterations"]


def test_requested_displacements_are_hit_to_the_last_bit(default_run: Run) -> None:
    travelled = default_run.history["top_displacement_m"]
    assert all(np.count_nonzero(travelled == travel) == 1 for travel in REQUESTED)
    assert travelled[-1] == REQUESTED[-1]
    assert np.all(np.diff(travelled) > 0)


@pytest.mark.parametrize("wall", WALLS)
def test_peak_and_residual_are_near_the_converged_values(wall: str, default_runs: dict[str, Run]) -> None:
    friction = default_runs[wall].summary["friction"]
    for key in ("peak_shear_stress_Pa", "refined_peak_shear_stress_Pa"):
        assert friction[key] == pytest.approx(converged(wall, "peak"), rel=0.002)
    assert friction["residual_shear_stress_Pa"] == pytest.approx(converged(wall, "residual"), rel=0.002)
    assert friction["peak_shear_stress_Pa"] == default_runs[wall].history["shear_stress_Pa"].max()


def test_the_peak_falls_before_four_millimetres(default_run: Run) -> None:
    friction = default_run.summary["friction"]
    assert 0.001 < friction["peak_shear_stress_travel_m"] < 0.004
    assert friction["peak_friction"] == pytest.approx(friction["peak_shear_stress_Pa"] / PRESSURE, rel=SOLVER_TOLERANCE)


def test_the_wall_rises_by_what_the_sand_dilates(default_run: Run) -> None:
    """A grain takes the volume 1 + e of its sand: the mean of (1 + e)/(1 + e_0) is the height over the initial height.

    The void ratio is integrated over the increments of strain, the height is a displacement: they agree to the third
    order in the increments.
    """
    for profile in default_run.profile_blocks():
        row = np.flatnonzero(default_run.history["step"] == profile["step"][0])
        dilation = np.mean((1 + profile["void_ratio"]) / (1 + VOID_RATIO)) - 1
        rise = default_run.history["height_change_m"][row] / HEIGHT
        assert rise == pytest.approx(dilation, abs=2e-6)


def test_states_stay_in_the_range_of_the_law(default_run: Run) -> None:
    void_ratio = default_run.profiles["void_ratio"]
    e_i, _, e_d = SAND.characteristic_void_ratios(mean_pressure(default_run.profiles))
    assert np.all(void_ratio > e_d)
    assert np.all(void_ratio < e_i)


# -- hard scenes -------------------------------------------------------------------------------------------------------


def run_through(folder: Path, wall: str, *overrides: str) -> Run:
    """Runs a scene and checks what always holds: it ends where it should, in equilibrium and within the law's range."""
    run = walk(folder, wall, *overrides)
    summary, history, scene = run.summary, run.history, run.summary["scene"]
    assert (summary["status"], summary["reason"]) == ("done", None)
    top = scene["walls"]["top"]
    travelled = history["top_displacement_m"]
    assert travelled[-1] == top["shear_displacement"][-1]
    assert set(scene["output"]["profiles_at"]) <= set(travelled)
    assert len(run.profile_blocks()) == len(scene["output"]["profiles_at"])
    if "normal_stress" in top:
        assert history["normal_stress_Pa"][-1] == pytest.approx(top["normal_stress"], rel=SOLVER_TOLERANCE)
    for profile in run.profile_blocks():
        assert unevenness(profile["s22_Pa"]) < SOLVER_TOLERANCE
        assert unevenness(profile["s12_Pa"]) < SOLVER_TOLERANCE
    _, _, e_d = Material(**scene["material"]).characteristic_void_ratios(mean_pressure(run.profiles))
    assert np.all(run.profiles["void_ratio"] > e_d)
    assert summary["cutbacks"] <= 3
    return run


def friction(run: Run) -> tuple[float, float]:
    """Largest friction, and friction in the end."""
    return run.summary["friction"]["peak_friction"], run.summary["friction"]["residual_friction"]


@pytest.mark.parametrize("wall", WALLS)
def test_on_640_cells(wall: str, tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """The grain diameter regularises: eight times finer cells change peak, residual and thickness little."""
    run = run_through(tmp_path / "run", wall, "geometry.cells=640")
    assert friction(run) == pytest.approx(friction(default_runs[wall]), rel=1e-3)
    band, coarse = run.summary["band"], default_runs[wall].summary["band"]
    assert band["thickness_m"] == pytest.approx(coarse["thickness_m"], rel=0.03)
    assert band["position_m"] == pytest.approx(coarse["position_m"], abs=D50)


@pytest.mark.parametrize("wall", WALLS)
def test_dense_and_loose(wall: str, tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """The denser, the higher the peak and the thinner the band; loose sand has no peak."""
    dense = run_through(tmp_path / "dense", wall, "initial.void_ratio=0.53")
    loose = run_through(tmp_path / "loose", wall, "initial.void_ratio=0.85")
    medium = default_runs[wall]
    peaks = [friction(run)[0] for run in (dense, medium, loose)]
    assert all(denser > 1.1 * looser for denser, looser in pairwise(peaks))
    thickness = [run.summary["band"]["thickness_m"] for run in (dense, medium, loose)]
    assert all(denser < looser for denser, looser in pairwise(thickness))
    assert friction(dense)[0] > 1.1 * friction(dense)[1]
    assert friction(loose)[0] == friction(loose)[1]
    assert loose.history["height_change_m"][-1] < 0 < dense.history["height_change_m"][-1]


def pressed(pressure: float) -> tuple[str, str]:
    return f"initial.stress={-pressure}", f"walls.top.normal_stress={-pressure}"


@pytest.mark.parametrize("wall", WALLS)
def test_under_low_and_high_pressure(wall: str, tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """Pressure closes the gap to the critical void ratio: at 10 MPa the same sand is loose."""
    low = run_through(tmp_path / "low", wall, *pressed(1e3))
    high = run_through(tmp_path / "high", wall, *pressed(10e6))
    peaks = [friction(run)[0] for run in (low, default_runs[wall], high)]
    assert all(lower > 1.05 * higher for lower, higher in pairwise(peaks))
    assert friction(high)[0] == friction(high)[1]
    assert low.history["height_change_m"][-1] > 0 > high.history["height_change_m"][-1]


@pytest.mark.parametrize("wall", WALLS)
def test_fine_and_coarse_grains(wall: str, tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """The coarser the grains, the thicker the band and the stiffer the layer, up to one of eight grains."""
    fine = run_through(tmp_path / "fine", wall, "material.d50=0.2e-3")
    coarse = run_through(tmp_path / "coarse", wall, "material.d50=5e-3")
    ordered = (fine, default_runs[wall], coarse)
    thickness = [run.summary["band"]["thickness_m"] for run in ordered]
    assert all(thicker > 1.5 * thinner for thinner, thicker in pairwise(thickness))
    residual = [friction(run)[1] for run in ordered]
    assert all(stiffer > softer for softer, stiffer in pairwise(residual))


def test_grains_that_roll_strongly(tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """w = -0.25 u1/d50 at the top: the wall is ten times smoother, the band at it a grain or two."""
    run = run_through(tmp_path / "run", "medium_rough", "walls.top.rolling=0.125")
    inner, outer = run.profile_blocks()[-1]["omega_rad"][-2:]
    assert outer + (outer - inner) / 2 == pytest.approx(-0.25 * 0.03 / D50, rel=0.05)
    assert run.summary["band"]["touches"] == "top"
    assert run.summary["band"]["thickness_d50"] < 2
    assert friction(run)[0] < friction(default_runs["medium_rough"])[0]


@pytest.mark.parametrize("wall", WALLS)
def test_to_and_fro(wall: str, tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """Peaks at 4 mm, -4 mm, 4 mm: friction turns with the wall, and every reversal starts with the first step again."""
    there = "walls.top.shear_displacement=[0.004, -0.004, 0.004]"
    run = run_through(tmp_path / "run", wall, there, "output.profiles_at=[0.004, -0.004, 0.004]")
    history = run.history
    corners = np.flatnonzero(np.isin(history["top_displacement_m"], (0.004, -0.004)))
    assert len(corners) == 3
    first, second, third = history["shear_stress_Pa"][corners]
    assert (second, third) == pytest.approx((-first, first), rel=0.06)
    before = default_runs[wall].history
    same = np.flatnonzero(before["top_displacement_m"] == 0.004)
    assert first == pytest.approx(before["shear_stress_Pa"][same][0], rel=SOLVER_TOLERANCE)
    after = history["step_size_m"][[0, *(corners[:2] + 1)]]
    assert after == pytest.approx(0.0025 * HEIGHT, rel=1e-9)


@pytest.mark.parametrize("wall", WALLS)
def test_one_target_with_a_large_first_step(wall: str, tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """A first step of 1 mm, a third of the way to the peak, costs half a per cent of the peak and no more."""
    run = run_through(tmp_path / "run", wall, "stepping.first_step=1e-3", "output.profiles_at=[0.03]")
    assert run.history["step_size_m"][0] == 1e-3
    peak, residual = friction(default_runs[wall])
    assert friction(run)[0] == pytest.approx(peak, rel=0.01)
    assert friction(run)[1] == pytest.approx(residual, rel=0.002)


@pytest.mark.parametrize("wall", WALLS)
def test_with_two_integration_points(wall: str, tmp_path: Path, default_runs: dict[str, Run]) -> None:
    """Full integration sees u1', constant, and w, linear, in the same strain: stresses zigzag within the cells."""
    run = walk(tmp_path / "run", wall, "solver.integration_points=2")
    assert run.summary["status"] == "done"
    assert run.summary["sizes"]["quadrature_points"] == 160
    assert friction(run)[0] == pytest.approx(friction(default_runs[wall])[0], rel=0.001)
    assert friction(run)[1] == pytest.approx(friction(default_runs[wall])[1], rel=0.01)
    two, one = (it.profile_blocks()[-1] for it in (run, default_runs[wall]))
    for name in ("s12_Pa", "s22_Pa"):
        assert unevenness(two[name]) > 0.1
        assert unevenness(two[name].reshape(-1, 2).mean(axis=1)) < 0.002
        assert unevenness(one[name]) < SOLVER_TOLERANCE
