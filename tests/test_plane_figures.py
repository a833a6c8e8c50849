"""The figures of a plane body, drawn from a synthetic run with a band that grows."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
import specimens
from matplotlib.image import imread
from PIL import Image

from cosserat_fx import plots
from cosserat_fx.output import plane_figures
from cosserat_fx.output.plane_fields import PlaneFieldWriter, PlaneState
from cosserat_fx.results import BOUNDARY_COLUMNS, FORMAT, PLANE_COLUMNS, OutputError, Run, RunFolder, read_run

STATIONS = [0.003, 0.006]
FORCES = [f"{name}_{ending}" for name in ("bottom", "top") for ending in BOUNDARY_COLUMNS.values()]


def state(travel: float, *, flat: bool = False, polar: bool = True) -> PlaneState:
    """A specimen with a band that grows with the travel, lying on its side where flat."""
    along, across = specimens.frame(52.0)

    def displacement(points: np.ndarray) -> np.ndarray:
        slip = travel / 2 * (1 + np.tanh((points - specimens.MIDDLE) @ across / 0.004))
        return np.asarray(-slip[:, None] * along)

    strain = specimens.band(52.0, 0.008, background=5 * travel, amplitude=150 * travel)
    upright = specimens.specimen(strain, displacement=displacement, travel=travel)
    turned = replace(upright, points=upright.points[:, ::-1], displacement=upright.displacement[:, ::-1])
    return replace(turned if flat else upright, rotation=upright.rotation if polar else None)


def write_run(folder: Path, *, own: dict[str, float], fields: bool = True, **kind: Any) -> Run:
    """Write and read back a run of ten steps, one of them with a passage to another branch."""
    out = RunFolder.create(folder, False, (*PLANE_COLUMNS, *FORCES, *own), ())
    writer = PlaneFieldWriter(out.fields) if fields else None
    for step in range(11):
        travel = 0.001 * step
        if writer and (step % 2 == 0 or travel in STATIONS):
            writer.write(state(travel, **kind))
        if step:
            row: dict[str, float] = dict.fromkeys((*PLANE_COLUMNS, *FORCES), 0.0)
            row |= {"step": step, "travel_m": travel, "branch_passages": float(step == 4)}
            row |= {"top_force2_N_per_m": -4e3 * np.tanh(step), "bottom_force2_N_per_m": 4e3 * np.tanh(step)}
            out.append_history(row | {name: factor * step for name, factor in own.items()})
    columns = {name: {"boundary": "top", "quantity": "force2"} for name in own}
    scene = {"geometry": {"kind": "rectangle"}, "output": {"columns": columns}}
    out.write_summary({"format": FORMAT, "status": "done", "reason": None, "scene": scene, "stations_m": STATIONS})
    return read_run(folder)


def picture(file: Path) -> np.ndarray:
    """Grey values; a figure with nothing on it would be one colour."""
    grey = imread(file)[..., :3].mean(axis=2)
    assert grey.std() > 0.05
    return grey


@pytest.mark.parametrize(
    "kind",
    [{"own": {"axial_stress_Pa": 2e5, "shortening_m": 1e-3}}, {"own": {}, "flat": True}, {"own": {}, "polar": False}],
    ids=["own columns", "lying", "classical"],
)
def test_all_figures_are_drawn(tmp_path: Path, kind: dict[str, Any]) -> None:
    run = write_run(tmp_path / "run", **kind)
    drawn = plots.draw_all(run.path)
    names = ["history.png", "state_01.png", "state_02.png", "state_03.png", "shear_strain.gif"]
    assert [file.relative_to(run.path / "figures") for file in drawn] == [Path(name) for name in names]
    for file in drawn[:-1]:
        assert picture(file).shape[1] == int(16.0 / 2.54 * 200)
    with Image.open(drawn[-1]) as frames:
        assert getattr(frames, "n_frames") == 7  # noqa: B009  (only pictures of some formats have it)
    scene = run.summary["scene"] | {"output": {"animation": False}}
    RunFolder(run.path).write_summary(run.summary | {"scene": scene})
    assert plots.draw_all(run.path) == drawn[:-1]


def test_without_fields_there_is_a_history(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", own={}, fields=False)
    assert [file.name for file in plots.draw_all(run.path)] == ["history.png"]


def test_a_run_that_was_killed_at_its_start_gives_nothing(tmp_path: Path) -> None:
    out = RunFolder.create(tmp_path, False, PLANE_COLUMNS, ())
    assert tuple(read_run(tmp_path).history) == PLANE_COLUMNS
    PlaneFieldWriter(out.fields).write(state(0.0))
    out.write_summary({"format": FORMAT, "status": "running", "scene": {"geometry": {"kind": "mesh"}}})
    assert plots.draw_all(tmp_path) == []


def test_damaged_fields_are_told(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", own={})
    (run.path / "fields" / "plane.pvd").write_text("<VTKFile>")
    with pytest.raises(OutputError, match="fields cannot be read"):
        plots.draw_all(run.path)


def test_states_share_their_colours() -> None:
    """The scale spans all of them, the rotation's is the same to both sides."""
    states = [state(0.003), state(0.01)]
    e, w, strain = plane_figures._panels(states)
    assert (e.limits.vmin, e.limits.vmax) == (
        min(float(it.means["void_ratio"].min()) for it in states),
        states[1].means["void_ratio"].max(),
    )
    assert strain.limits.vmax == states[1].means["shear_strain"].max()
    assert states[1].rotation is not None
    assert w.limits.vmax == -float(w.limits.vmin or 0.0) == np.abs(states[1].rotation).max()


def test_the_outline_is_the_boundary() -> None:
    ends = plane_figures._outline(state(0.0))
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert lengths.sum() == pytest.approx(2 * (specimens.WIDTH + specimens.HEIGHT))


@pytest.mark.parametrize(
    ("column", "words"),
    [
        ("axial_stress_Pa", ("axial stress", " (kPa)", 1e-3)),
        ("top_force2_N_per_m", ("top force2", " (kN/m)", 1e-3)),
        ("gap_m", ("gap", " (mm)", 1e3)),
        ("friction", ("friction", "", 1.0)),
    ],
)
def test_a_column_s_name_says_its_unit(column: str, words: tuple[str, str, float]) -> None:
    assert plane_figures._spell(column) == words


def test_drawing_leaves_the_settings_of_matplotlib_alone(tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    plane_figures.draw_animation([state(0.0), state(0.01)], tmp_path / "moving.gif")
    assert dict(mpl.rcParams) == before
