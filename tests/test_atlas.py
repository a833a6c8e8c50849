"""A short stability atlas: some scenes of benchmarks/stability_atlas.py that cost little, hard corners among them."""

import re
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
atlas: Any = import_module("stability_atlas_scenes")
runs: Any = import_module("stability_atlas_runs")

SAMPLES = [scene for scene in atlas.samples(64) if scene.cells <= 60][:7]
CORNERS = [scene for scene in atlas.corners(64) if scene.cells == 2][::2]
"""Two cells are soon solved, however hard the rest."""
CAUSES = "exceeds e_i|next to e_[id]|come to e_d|below e_d|no longer compressive|ellipticity|left the domain"
PLACE = r"at [-\d.e]+ m\b"


def name(scene: Any) -> str:
    return f"{scene.kind} {scene.number}, {scene.walk}"


@pytest.mark.parametrize("scene", [*SAMPLES, *CORNERS], ids=name)
def test_a_scene_reaches_its_end_or_names_what_keeps_it(scene: Any) -> None:
    """A physical cause with its place, and numbers in all fields either way."""
    outcome = runs.walk(scene)
    assert outcome.finite
    if outcome.ending != "done":
        assert outcome.ending == "stopped"
        assert re.search(CAUSES, outcome.reason)
        assert re.search(PLACE, outcome.reason)


def test_the_samples_fill_the_box_and_the_corners_are_its_own() -> None:
    """Of 2**n Sobol points each half of every side holds half; six sides of a corner tell the seventh."""
    samples, corners = atlas.samples(64), atlas.corners(64)
    for axis in (axis for axis in atlas.AXES if axis.key != "fineness"):  # which the number of cells bounds
        parts = [axis.part(getattr(scene, axis.key)) for scene in samples]
        assert sum(part < 0.5 for part in parts) == len(samples) / 2
        assert {round(axis.part(getattr(scene, axis.key)), 12) for scene in corners} <= {0.0, 1.0}
    assert (
        len(corners)
        == len(
            {
                (scene.pressure, scene.density, scene.rolling, scene.height, scene.fineness, scene.a_c)
                for scene in corners
            }
        )
        == 64
    )
    assert max(scene.cells for scene in (*samples, *corners)) == atlas.MAX_CELLS
    assert {scene.walk for scene in samples} == set(atlas.WALKS)
    assert [scene.number for scene in (*samples, *corners)] == list(range(128))


def test_the_log_gives_back_what_it_was_given(tmp_path: Path) -> None:
    """So that an interrupted atlas goes on with the scene at which it was."""
    scene = atlas.samples(2)[1]
    outcome = runs.Outcome("stopped", 'it says "no", at 1 m', 0.25, 3, 14, 1, 0, 2, 7, 0.125, True)
    runs.Log(tmp_path / "atlas.csv").append(runs.Entry(scene, outcome))
    assert runs.Log(tmp_path / "atlas.csv").read() == [runs.Entry(scene, outcome)]


def test_a_scene_that_takes_too_long_hangs() -> None:
    outcome = runs.walk(atlas.samples(4)[3], max_seconds=0.05)
    assert outcome.ending == "hung"
    assert outcome.travelled < 1
