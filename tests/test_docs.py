"""The pages say what the program does: commands and programs in them run, tables are those of the code."""

import contextlib
import io
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pages
import pytest
import reference_law
import typer.main
from scenes import RECTANGLE, change
from typer.testing import CliRunner

from cosserat_fx import cli
from cosserat_fx.elements import DEFAULT, ELEMENTS
from cosserat_fx.hypoplasticity import FIRST_FAILURE, REASONS, Status
from cosserat_fx.material import Material
from cosserat_fx.output import layer_figure
from cosserat_fx.output.layer_bands import BandMetrics, FrictionMetrics
from cosserat_fx.output.plane_bands import PlaneBand
from cosserat_fx.results import BOUNDARY_COLUMNS, HISTORY_COLUMNS, PLANE_COLUMNS, PROFILE_COLUMNS, Run, read_run
from cosserat_fx.run import run as run_scene
from cosserat_fx.scene import parse_scene

ROOT = pages.ROOT

# -- every page --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", pages.pages())
def test_links_lead_somewhere(page: str) -> None:
    for link in pages.links(page):
        if "://" in link:
            continue
        file, _, anchor = link.partition("#")
        target = (ROOT / page).parent / file if file else ROOT / page
        assert target.exists(), link
        assert not anchor or anchor in pages.anchors(str(target.resolve().relative_to(ROOT))), link


@pytest.mark.parametrize("page", pages.pages())
def test_files_that_are_named_exist(page: str) -> None:
    named = re.findall(r"`((?:cosserat_fx|forms|demos|docs|tests)/[\w/.]*)`", pages.text(page))
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_the_pictures_are_light() -> None:
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", pages.text("README.md")):
        assert (ROOT / picture).stat().st_size < 250_000


# -- commands ----------------------------------------------------------------------------------------------------------


def test_make_knows_its_targets() -> None:
    phony = re.search(r"^\.PHONY: (.+)$", pages.text("Makefile"), re.MULTILINE)
    wanted = [shlex.split(command)[1] for command in pages.commands("README.md") if command.startswith("make ")]
    assert phony is not None
    assert wanted == ["demo", "test"]
    assert set(wanted) <= set(phony[1].split())


def test_the_container_is_used_as_its_file_says() -> None:
    told = re.findall(r"^#   (docker .+?)(?:\s{2,}.*)?$", pages.text("Dockerfile"), re.MULTILINE)
    wanted = [command for command in pages.commands("README.md") if command.startswith("docker ")]
    assert len(wanted) == 3
    assert set(wanted) <= set(told)


def usage(name: str, command: Any) -> str:
    """A command's line in the README, from what typer knows."""
    words = [f"cosserat-fx {name}"]
    for it in command.params:
        names = it.opts[:1] if it.param_type_name == "option" else []
        word = " ".join([*names, *filter(None, [it.metavar])])
        words.append(word if it.required else f"[{word}]")
        words[-1] += "..." if getattr(it, "multiple", False) else ""
    if "ignore_unknown_options" in command.context_settings:
        words.append("[-petsc_option [VALUE]]...")
    return " ".join(words)


def test_the_command_line_is_as_told() -> None:
    known = typer.main.get_command(cli.app).commands  # type: ignore[attr-defined]
    (told,) = pages.blocks("README.md", "text")
    assert told.splitlines() == [usage(name, command) for name, command in known.items()]


def test_the_exit_statuses_are_as_told() -> None:
    told = f"0 when the run is done, {cli.BAD_INPUT} for bad input, with nothing written, and {cli.STOPPED} when"
    assert told in pages.words("docs/output.md")


@dataclass(frozen=True)
class FollowedReadme:
    """What doing as the README says left behind, with fewer cells: the folder and what its Python printed."""

    folder: Path
    printed: str

    def run(self, name: str) -> Run:
        return read_run(self.folder / "runs" / name)


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory) -> FollowedReadme:
    """Runs with 40 cells and draws figures once, without VTK; the demo's scene runs on one rank.

    The plane body is left to the tests of the demos.
    """
    folder = tmp_path_factory.mktemp("readme")
    (scene,) = pages.blocks("README.md", "toml")
    (folder / "first.toml").write_text(scene)
    shutil.copytree(ROOT / "demos", folder / "demos")
    program = ".venv/bin/cosserat-fx "
    commands = [command for command in pages.commands("README.md") if program in command]
    lines = [command.split(program)[1] for command in commands if "demos/biaxial.toml" not in command]
    assert len(lines) == len(commands) - 1 == 4
    output = io.StringIO()
    with contextlib.chdir(folder), pytest.MonkeyPatch.context() as patch:
        patch.setattr(layer_figure, "_vtk_image", lambda *_: None)
        for line in [*lines, "plot runs/medium_rough"]:
            arguments = shlex.split(line)
            if arguments[0] != "plot":
                arguments += ["--set", "geometry.cells=40"]
            if arguments[0] == "run":
                arguments += ["--set", "output.figures=false"]
            result = CliRunner().invoke(cli.app, arguments, catch_exceptions=False)
            assert result.exit_code == 0, result.output
        with contextlib.redirect_stdout(output):
            for block in pages.blocks("README.md", "python"):
                exec(block, {})
    return FollowedReadme(folder, output.getvalue())


def test_the_first_scene_does_what_the_readme_expects(followed: FollowedReadme) -> None:
    """Very rough: in the middle. Medium rough: at the wall, and a thinner zone loosens."""
    very, medium = followed.run("very_rough"), followed.run("medium_rough")
    assert very.summary["band"]["relative_position"] == pytest.approx(0.5, abs=0.1)
    assert medium.summary["band"]["relative_position"] > 0.9
    loosened = [run.summary["band"]["dilated_thickness_d50"] for run in (very, medium)]
    assert loosened[1] < 0.9 * loosened[0]
    places = [float(place) for place in re.findall(r"band at (\S+)", followed.printed)]
    assert places == [pytest.approx(run.summary["band"]["relative_position"], abs=0.005) for run in (very, medium)]


def test_the_first_scene_is_the_paper_s_very_rough_one(followed: FollowedReadme) -> None:
    first, paper = followed.run("very_rough"), followed.run("very_rough_on_two")
    assert first.history["shear_stress_Pa"][-1] == pytest.approx(paper.history["shear_stress_Pa"][-1], rel=2e-3)


# -- docs/output.md ----------------------------------------------------------------------------------------------------


def test_the_columns_are_those_of_the_tables() -> None:
    assert tuple(pages.column("docs/output.md", "history.csv of a layer")) == HISTORY_COLUMNS
    plane = (*PLANE_COLUMNS, *BOUNDARY_COLUMNS.values())
    assert tuple(pages.column("docs/output.md", "history.csv of a plane body")) == plane
    assert tuple(pages.column("docs/output.md", "profiles.csv")) == PROFILE_COLUMNS


@pytest.fixture(scope="module")
def plane_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A plane body sheared in three steps, too little for a band."""
    folder = tmp_path_factory.mktemp("plane") / "run"
    short = {"boundaries.top.u2": -2e-4, "boundaries.bottom.u1": 0.0, "material.d50": 3e-3, "output.frames": 2}
    tables = change(RECTANGLE, short)
    run_scene(parse_scene(tables), folder)
    return read_run(folder)


def told_files() -> list[set[str]]:
    """The files of the page's first two tables: of a layer and of a plane body."""
    rows = [row[0].strip("`") for above, row in pages.rows("docs/output.md") if above == "The folder of a run"]
    heads = [number for number, name in enumerate(rows) if name == "file"]
    return [set(rows[heads[0] + 1 : heads[1]]), set(rows[heads[1] + 1 :])]


def test_the_files_are_those_of_a_layer(followed: FollowedReadme) -> None:
    folder = followed.folder / "runs" / "medium_rough"
    numbered = {
        f"fields/layer_{number:04d}.vtu" for number in range(1, 1 + len(followed.run(folder.name).profile_blocks()))
    }
    assert told_files()[0] | numbered == {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}


def test_the_files_are_those_of_a_plane_body(plane_run: Run) -> None:
    folder = plane_run.path
    found = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}
    numbered = {name for name in found if re.search(r"_0*[1-9]\d*\.vtu$", name)}
    assert len(numbered) == 2
    assert told_files()[1] == found - numbered


def test_the_fields_are_those_of_a_run(followed: FollowedReadme, plane_run: Run) -> None:
    layer = followed.folder / "runs" / "medium_rough" / "fields" / "layer_0001.vtu"
    plane = plane_run.path / "fields" / "plane_0001.vtu"
    for kind, file in (("layer", layer), ("plane body", plane)):
        mesh = meshio.read(file)
        assert pages.column("docs/output.md", f"fields/ of a {kind}") == [*mesh.point_data, *mesh.cell_data]


def test_the_entries_are_those_of_a_summary(followed: FollowedReadme, plane_run: Run) -> None:
    layer, plane = followed.run("medium_rough").summary, plane_run.summary
    told = pages.column("docs/output.md", "run.json")
    assert told == [*layer, *(entry for entry in plane if entry not in layer)]
    assert set(layer) - set(plane) == {"band", "friction"}
    for name, example in (("sizes", layer["sizes"]), ("effects", layer["effects"][0])):
        (cells,) = (
            row[1] for above, row in pages.rows("docs/output.md") if above == "run.json" and row[0] == f"`{name}`"
        )
        assert sorted(re.findall(r"`(\w+)`", cells)) == sorted(example)
    tables = (("band of a layer", BandMetrics), ("band of a plane body", PlaneBand), ("friction", FrictionMetrics))
    for heading, metrics in tables:
        assert sorted(pages.column("docs/output.md", heading)) == sorted(field.name for field in fields(metrics))


# -- docs/elements.md --------------------------------------------------------------------------------------------------

CASES = ("biaxial", "platens", "core")


def test_the_elements_are_told() -> None:
    cells = [row for above, row in pages.rows("docs/elements.md") if above == "The elements"][1:]
    chosen = set(DEFAULT.values())
    assert cells == [[f"`{e.name}`", e.cell, e.words, "yes" if e.name in chosen else ""] for e in ELEMENTS.values()]


@pytest.mark.parametrize("case", CASES)
def test_the_default_elements_are_the_best_measured(case: str) -> None:
    """Of the elements with the same cells on the same mesh, none has a stress that is measurably nearer."""
    heads, *cells = [row for above, row in pages.rows("docs/elements.md") if above == f"Elements, {case}"]
    error: dict[str, float] = {}
    for row in cells:
        told = dict(zip(heads[:7], row, strict=False))
        if told["side (d50)"] == "2.5" and told["mesh"] in ("", "/"):
            error[told["element"]] = abs(float(told["error (%)"])) if told["error (%)"] else np.inf
    assert error.keys() == ELEMENTS.keys()
    for cell, default in DEFAULT.items():
        assert error[default] <= 0.02 + min(error[e.name] for e in ELEMENTS.values() if e.cell == cell)


# -- docs/theory.md ----------------------------------------------------------------------------------------------------


def test_the_numbers_of_the_theory_page() -> None:
    """At -100 kPa and e = 0.6."""
    sand, trace = Material.named("paper-sand"), np.array(-300e3)
    e_i, e_c, e_d = sand.characteristic_void_ratios(100e3)
    f_s, f_d = reference_law.factors(trace, np.array(0.6), sand)
    plain = {"e_i": e_i, "e_c": e_c, "e_d": e_d, "a_0": sand.a_isotropic, "h_i": sand.h_i, "f_d": float(f_d)}
    stiff = {"f_b": float(reference_law.barotropy(trace, sand)), "f_s": float(f_s)}
    heading = "Numbers to check an implementation by"
    cells = [row for above, row in pages.rows("docs/theory.md") if above == heading][1:]
    told = {row[k].strip("$"): row[k + 1] for row in cells for k in (0, 2)}
    assert told == {name: f"{value:.7f}" for name, value in plain.items()} | {
        name: f"{value / 1e6:.6f} MPa" for name, value in stiff.items()
    }


def test_the_codes_of_the_theory_page() -> None:
    cells = [row for above, row in pages.rows("docs/theory.md") if above == "What can go wrong with a point"][1:]
    assert cells == [[str(int(it)), f"`{it.name}`", REASONS[it]] for it in Status]
    assert f"From `{Status(FIRST_FAILURE).name}` on the update has failed" in pages.words("docs/theory.md")


# -- docs/extending.md -------------------------------------------------------------------------------------------------


def test_the_example_of_extending_prints_what_is_told() -> None:
    """To one unit of the last digit, which the choice of steps may move."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        for block in pages.blocks("docs/extending.md", "python")[:2]:
            exec(block, {})
    (told,) = pages.blocks("docs/extending.md", "text")
    number = r"-?\d+\.\d+"
    assert re.sub(number, "", output.getvalue()) == re.sub(number, "", told)
    for line, printed in zip(told.splitlines(), output.getvalue().splitlines(), strict=True):
        (rotation, stress), (w, s12) = ([float(n) for n in re.findall(number, it)] for it in (line, printed))
        assert w == pytest.approx(rotation, rel=5e-3, abs=1e-4)
        assert s12 == pytest.approx(stress, rel=2e-3)


def test_a_condition_of_ones_own_in_a_scene(tmp_path: Path) -> None:
    """The grains at the lid turn against the couple that the page says; new keys are checked like all others."""
    program, scene, out = tmp_path / "brushes.py", tmp_path / "brushed.toml", tmp_path / "run"
    program.write_text(pages.blocks("docs/extending.md", "python")[2])
    [told] = pages.blocks("docs/extending.md", "toml")
    scene.write_text(told)
    own = tomllib.loads(told)
    command = [sys.executable, str(program), "run", str(scene), "--out", str(out)]
    process = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (process.returncode, process.stderr) == (0, "")
    history, brush = read_run(out).history, own["boundaries"]["top"]["brush"]
    turned = brush["limit"] * np.tanh(brush["stiffness"] * history["top_w_rad"][-1] / brush["limit"])
    assert abs(turned) > 0.5 * brush["limit"]
    assert history["top_couple_N"][-1] == pytest.approx(-turned * own["geometry"]["width"], rel=0.05)
    process = subprocess.run(
        [*command, "--overwrite", "--set", "boundaries.top.brush.limit=-1"], capture_output=True, text=True, timeout=300
    )
    assert (process.returncode, process.stdout) == (2, "")
    assert process.stderr.startswith("cosserat-fx: boundaries.top.brush.limit = -1: ")
