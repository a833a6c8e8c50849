"""The figures, drawn from a synthetic run that looks like the paper's layer."""

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.image import imread

from cosserat_fx import plots
from cosserat_fx.output import layer_figure, page
from cosserat_fx.results import OutputError, Run, RunFolder, read_run

HEIGHT, D50, POINTS = 0.04, 0.5e-3, 80
REQUESTED = (0.004, 0.01, 0.02, 0.03)


def history_row(step: int, travel: float, normal_stress: float) -> dict[str, float | int]:
    """One step: a peak at 2 mm, softening, dilation that levels off."""
    friction = np.sign(travel) * (
        0.5 * np.tanh(abs(travel) / 4e-4) + 0.2 * (abs(travel) / 2e-3) ** 2 * np.exp(2.0 - 2.0 * abs(travel) / 2e-3)
    )
    return {
        "step": step,
        "top_displacement_m": travel,
        "shear_stress_Pa": -friction * normal_stress,
        "normal_stress_Pa": normal_stress,
        "height_change_m": 6e-4 * np.tanh(abs(travel) / 5e-3) - 5e-5 * np.tanh(abs(travel) / 2e-4),
        "newton_iterations": 4,
        "void_ratio_max": 0.76,
        "void_ratio_min": 0.59,
        "bottom_displacement_m": 0.0,
        "step_size_m": 5e-4,
        "cutbacks": 0,
        "substeps_max": 2,
        "mobilised_friction": friction,
        "max_shear_strain": 50.0 * abs(travel),
        "jumps": 0,
    }


def profile_block(step: int, travel: float, middle: float) -> dict[str, np.ndarray | float | int]:
    """Profiles with a band ten grains thick that takes up the shear more and more."""
    y = (np.arange(POINTS) + 0.5) * HEIGHT / POINTS
    width = 5.0 * D50 / np.arccosh(np.sqrt(2.0))
    arm = (y - middle) / width
    share = abs(travel) / (abs(travel) + 3e-3)
    walls = np.tanh((np.array([0.0, HEIGHT]) - middle) / width)
    shear = travel * ((1.0 - share) / HEIGHT + share / (np.ptp(walls) * width) / np.cosh(arm) ** 2)
    void_ratio = 0.6 + share * (0.15 / np.cosh(arm / 1.3) ** 4 + 0.06 * np.exp(-((np.abs(arm) - 1.5) ** 2) / 0.2))
    return {
        "top_displacement_m": travel,
        "y_m": y,
        "u1_m": travel * ((1.0 - share) * y / HEIGHT + share * (np.tanh(arm) - walls[0]) / np.ptp(walls)),
        "u2_m": 6e-4 * share * (np.tanh(arm) - walls[0]) / np.ptp(walls),
        "omega_rad": -0.4 * shear,
        "void_ratio": void_ratio,
        "s11_Pa": -100e3 + 22e3 * share * np.exp(-((np.abs(arm) - 1.5) ** 2)) - 9e3 * share,
        "s22_Pa": -100e3,
        "s33_Pa": -100e3 + 11e3 * share * np.exp(-((np.abs(arm) - 1.5) ** 2)) - 5e3 * share,
        "s12_Pa": np.sign(travel) * 50e3,
        "s21_Pa": np.sign(travel) * (50e3 - 12e3 * share * (1.0 - 2.0 * arm**2) * np.exp(-(arm**2))),
        "m31_N_per_m": 0.0,
        "m32_N_per_m": 18.0 * share * arm * np.exp(0.5 - 0.5 * arm**2),
        "shear_strain": shear,
        "step": step,
    }


def write_run(
    folder: Path,
    *,
    middle: float = 0.5 * HEIGHT,
    targets: tuple[float, ...] = (0.03,),
    requested: tuple[float, ...] = REQUESTED,
    normal_stress: float = -100e3,
    locked: bool = False,
) -> Run:
    """Write and read back a run along the targets, which meets each requested displacement once."""
    out = RunFolder.create(folder, overwrite=False)
    path = np.concatenate([np.linspace(a, b, round(abs(b - a) / 5e-4) + 1)[1:] for a, b in pairwise((0.0, *targets))])
    left = list(requested)
    for step, travel in enumerate(path, start=1):
        normal = normal_stress * (1.0 + 2.0 * np.tanh(abs(travel) / 5e-3)) if locked else normal_stress
        row = history_row(step, travel, normal)
        out.append_history(row | {"height_change_m": 0.0} if locked else row)
        if left and np.isclose(travel, left[0], rtol=0.0, atol=1e-9):
            out.append_profile(profile_block(step, left.pop(0), middle))
    assert not left
    out.write_summary(
        {
            "format": 1,
            "status": "done",
            "reason": None,
            "scene": {"geometry": {"height": HEIGHT}, "initial": {"void_ratio": 0.6}},
            "band": {"critical_void_ratio": 0.7602},
        }
    )
    return read_run(folder)


def picture(file: Path) -> np.ndarray:
    """Grey values, of shape (pixels, pixels); a figure with nothing on it would be one colour."""
    grey = imread(file)[..., :3].mean(axis=2)
    assert grey.std() > 0.05
    return grey


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return write_run(tmp_path_factory.mktemp("runs") / "middle")


def test_all_figures_are_drawn_at_print_size(run: Run) -> None:
    drawn = plots.draw_all(run.path)
    assert [file.relative_to(run.path) for file in drawn] == [
        Path("figures/history.png"),
        Path("figures/profiles.png"),
        Path("figures/layer.png"),
    ]
    for file in drawn:
        assert picture(file).shape[1] == int(16.0 / 2.54 * 200)


@pytest.mark.parametrize(
    "kind",
    [
        {"targets": (0.004, -0.004, 0.004), "requested": (0.004, 0.0, -0.004, 0.004)},
        {"locked": True},
        {"targets": (0.12,), "requested": (0.002, 0.004, 0.01, 0.02, 0.05, 0.08, 0.12)},
        {"requested": (0.03,)},
    ],
    ids=["cyclic", "constant height", "many profiles", "one profile"],
)
def test_other_kinds_of_runs_are_drawn(tmp_path: Path, kind: dict[str, Any]) -> None:
    run = write_run(tmp_path / "run", **kind)
    for draw in (plots.draw_history, plots.draw_profiles):
        draw(run, tmp_path / "figure.png")
        picture(tmp_path / "figure.png")
    assert layer_figure.draw_layer(run, tmp_path / "layer.png", "matplotlib") == "matplotlib"
    picture(tmp_path / "layer.png")


def test_a_run_that_stopped_early_gives_what_it_has(tmp_path: Path) -> None:
    assert plots.draw_all(RunFolder.create(tmp_path / "killed", overwrite=False).path) == []
    run = write_run(tmp_path / "before the first profile", requested=())
    assert [file.name for file in plots.draw_all(run.path)] == ["history.png"]


def test_one_point_and_a_frozen_void_ratio_are_drawn(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run")
    one = {name: column[::POINTS][:1] for name, column in run.profiles.items()}
    one |= {"void_ratio": np.array([0.6]), "omega_rad": np.zeros(1), "m32_N_per_m": np.zeros(1)}
    run = replace(run, profiles=one)
    plots.draw_profiles(run, tmp_path / "profiles.png")
    layer_figure.draw_layer(run, tmp_path / "layer.png", "matplotlib")
    picture(tmp_path / "layer.png")


def test_labels_tell_the_travel_and_with_reversals_the_step(run: Run, tmp_path: Path) -> None:
    assert page.labels(run) == ["4 mm", "10 mm", "20 mm", "30 mm"]
    cyclic = write_run(tmp_path / "run", targets=(0.004, -0.004), requested=(0.004, -0.004))
    assert page.labels(cyclic) == ["4 mm (step 8)", "\N{MINUS SIGN}4 mm (step 24)"]


def test_the_layer_is_as_high_and_as_displaced_as_the_walls_say(run: Run) -> None:
    """Extrapolation to the walls gives their displacement, which no quadrature point has."""
    start, *states = layer_figure._columns(run)
    assert (np.ptp(start.y), np.ptp(start.x)) == pytest.approx((40.0, 20.0))
    for column, travel in zip(states, REQUESTED, strict=True):
        assert column.x[-1, 0] - column.x[0, 0] == pytest.approx(1e3 * travel, rel=1e-3)
        assert np.ptp(column.y) > 40.0
    edges = [(c.x.min(), c.x.max()) for c in (start, *states)]
    assert all(left[1] < right[0] for left, right in pairwise(edges))


def test_states_that_do_not_fit_beside_each_other_go_below(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", targets=(0.2,), requested=(0.1, 0.2))
    start, beside, below = layer_figure._columns(run)
    assert beside.y.min() == pytest.approx(0.0, abs=1e-6)
    assert start.x.max() < beside.x.min()
    assert below.y.max() < -1.0
    assert below.x.min() == start.x.min() == 0.0


def test_vtk_and_matplotlib_paint_the_same_picture(run: Run, tmp_path: Path) -> None:
    by_default = layer_figure.draw_layer(run, tmp_path / "default.png")
    assert layer_figure.draw_layer(run, tmp_path / "matplotlib.png", "matplotlib") == "matplotlib"
    if by_default == "matplotlib":
        pytest.skip("VTK cannot render here, and matplotlib stood in as it should")
    difference = np.abs(picture(tmp_path / "default.png") - picture(tmp_path / "matplotlib.png"))
    assert difference.mean() < 0.005


def test_matplotlib_stands_in_where_vtk_dies(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dying = tmp_path / "dying"
    dying.write_text("#!/bin/sh\nkill -ABRT $$\n")
    dying.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(dying))
    assert layer_figure.draw_layer(run, tmp_path / "layer.png") == "matplotlib"
    picture(tmp_path / "layer.png")
    with pytest.raises(RuntimeError, match="VTK cannot render"):
        layer_figure.draw_layer(run, tmp_path / "layer.png", "pyvista")


def test_matplotlib_stands_in_where_vtk_paints_nothing(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some drivers succeed with a blank image."""
    monkeypatch.setattr(sys, "executable", "/bin/true")
    monkeypatch.setattr(layer_figure, "imread", lambda _: np.ones((4, 4, 3)))
    assert layer_figure.draw_layer(run, tmp_path / "layer.png") == "matplotlib"


def test_drawing_leaves_the_settings_of_matplotlib_alone(run: Run, tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    plots.draw_history(run, tmp_path / "history.png")
    assert dict(mpl.rcParams) == before


def test_noise_is_not_blown_up() -> None:
    low, high = page.axis_range(-100.0 + 1e-12 * np.arange(3.0))
    assert high - low > 2.0
    assert page.axis_range(np.array([0.0, 1e-18]), least=0.04)[1] > 0.02
    low, high = page.axis_range(np.zeros(3))
    assert low < 0.0 < high


def test_what_cannot_be_read_or_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="not a run"):
        plots.draw_all(tmp_path)
    run = write_run(tmp_path / "run")
    (run.path / "figures").write_text("in the way")
    with pytest.raises(OutputError, match="figures cannot be written"):
        plots.draw_all(run.path)
