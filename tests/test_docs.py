"""The pages say what the program does: commands and programs in them run, tables are those of the code."""

import contextlib
import io
import re
import shlex
import shutil
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import meshio
import numpy as np
import pages
import pytest
import reference_law
import typer.main
from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic.fields import FieldInfo
from typer.testing import CliRunner

from cosserat_fx import cli, effects, layer_figure
from cosserat_fx.bands import BandMetrics, FrictionMetrics
from cosserat_fx.hypoplasticity import FIRST_FAILURE, REASONS, Status
from cosserat_fx.material import NAMED_SETS, Material, MaterialError
from cosserat_fx.results import HISTORY_COLUMNS, PROFILE_COLUMNS, Run, read_run
from cosserat_fx.scene import DEFAULT_SET, Scene
from cosserat_fx.schema import Leg, Table, Unit, default_profiles

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


def test_the_picture_is_light() -> None:
    (picture,) = re.findall(r"!\[[^]]*\]\(([^)]+)\)", pages.text("README.md"))
    assert (ROOT / picture).stat().st_size < 200_000


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
    """Runs with 40 cells and draws figures once, without VTK; the demo's scene runs on one rank."""
    folder = tmp_path_factory.mktemp("readme")
    (scene,) = pages.blocks("README.md", "toml")
    (folder / "first.toml").write_text(scene)
    shutil.copytree(ROOT / "demos", folder / "demos")
    program = ".venv/bin/cosserat-fx "
    lines = [command.split(program)[1] for command in pages.commands("README.md") if program in command]
    assert len(lines) == 4
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
    assert tuple(pages.column("docs/output.md", "history.csv")) == HISTORY_COLUMNS
    assert tuple(pages.column("docs/output.md", "profiles.csv")) == PROFILE_COLUMNS


def test_the_files_are_those_of_a_run(followed: FollowedReadme) -> None:
    folder = followed.folder / "runs" / "medium_rough"
    told = set(pages.column("docs/output.md", "The folder of a run"))
    numbered = {
        f"fields/layer_{number:04d}.vtu" for number in range(1, 1 + len(followed.run(folder.name).profile_blocks()))
    }
    assert told | numbered == {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}


def test_the_fields_are_those_of_a_run(followed: FollowedReadme) -> None:
    mesh = meshio.read(followed.folder / "runs" / "medium_rough" / "fields" / "layer_0001.vtu")
    assert pages.column("docs/output.md", "fields/") == [*mesh.point_data, *mesh.cell_data]


def test_the_entries_are_those_of_a_summary(followed: FollowedReadme) -> None:
    summary = followed.run("medium_rough").summary
    assert pages.column("docs/output.md", "run.json") == list(summary)
    (sizes,) = (row[1] for above, row in pages.rows("docs/output.md") if above == "run.json" and row[0] == "`sizes`")
    assert re.findall(r"`(\w+)`", sizes) == list(summary["sizes"])
    for heading, metrics in (("band", BandMetrics), ("friction", FrictionMetrics)):
        assert sorted(pages.column("docs/output.md", heading)) == sorted(field.name for field in fields(metrics))


# -- docs/scene.md -----------------------------------------------------------------------------------------------------

WORDS = {float: "number", int: "integer", str: "text", bool: "true or false", tuple: "number or list", dict: "table"}


def flat(annotation: Any, metadata: list[Any]) -> tuple[list[Any], list[Any]]:
    """The types and literals that an annotation allows, and all metadata on the way."""
    kind, arguments = get_origin(annotation), get_args(annotation)
    if kind is Annotated:
        return flat(arguments[0], [*arguments[1:], *metadata])
    if kind in (Union, UnionType):
        branches = [flat(branch, []) for branch in arguments if branch is not NoneType]
        return [it for types, _ in branches for it in types], metadata + [it for _, found in branches for it in found]
    return (list(arguments) if kind is Literal else [kind or annotation]), metadata


def described(key: str, field: FieldInfo) -> tuple[str, str, str]:
    """Type, unit and allowed values of a key as the page spells them."""
    allowed, metadata = flat(field.annotation, field.metadata)
    literals = [it for it in allowed if isinstance(it, str)]
    units = [it.symbol.split(",")[0] for it in metadata if isinstance(it, Unit)]
    lower = [
        (it.gt, "<", ">") if isinstance(it, Gt) else (it.ge, "<=", ">=") for it in metadata if isinstance(it, Gt | Ge)
    ]
    upper = [(it.lt, "<") if isinstance(it, Lt) else (it.le, "<=") for it in metadata if isinstance(it, Lt | Le)]
    if literals:
        kind = "text, true or false" if bool in allowed else "text"
        choices = [f'`"{it}"`' for it in literals] + (["`true`", "`false`"] if bool in allowed else [])
        return kind, "", ", ".join(choices)
    bounds = ""
    if allowed[0] is tuple:
        least = sum(it.min_length for it in metadata if isinstance(it, MinLen))
        bounds = f"{least} to {sum(it.max_length for it in metadata if isinstance(it, MaxLen)):_} numbers"
    elif allowed[0] is dict:
        bounds = "text, true, false and numbers"
    elif lower and upper:
        bounds = f"`{lower[0][0]:_} {lower[0][1]} {key} {upper[0][1]} {upper[0][0]:_}`"
    elif lower or upper:
        bounds = f"`{key} {lower[0][2]} {lower[0][0]}`" if lower else f"`{key} {upper[0][1]} {upper[0][0]}`"
    return WORDS[allowed[0]], "".join(units), bounds


def schema(table: type[Table], path: str = "") -> Iterator[tuple[str, str, FieldInfo]]:
    """All keys but the material's, each with the path of its table."""
    for key, field in table.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, Table):
            yield from schema(inner, f"{path}.{key}".lstrip("."))
        elif key != "material":
            yield path, key, field


def told_keys() -> dict[tuple[str, str], list[str]]:
    """Rows of the page by table and key, without the key; a heading may name two tables."""
    return {
        (path, row[0].strip("`")): row[1:]
        for heading, row in pages.rows("docs/scene.md")
        for path in re.findall(r"\[([\w.]+)\]", heading) or [""]
        if row[0] != "key"
    }


def test_every_key_of_a_scene_is_told_with_type_unit_and_range() -> None:
    told = {at: row for at, row in told_keys().items() if at[0] != "material"}
    known = {(path, key): described(key, field) for path, key, field in schema(Scene)}
    assert {at: (row[0], row[1], row[3]) for at, row in told.items()} == known


def test_every_default_of_a_scene_is_told() -> None:
    told = told_keys()
    for path, key, field in schema(Scene):
        cell = told[path, key][2]
        if field.is_required() or field.get_default(call_default_factory=True) is None:
            assert cell == ("required" if field.is_required() else "—"), key
        else:
            default = field.get_default(call_default_factory=True)
            value = tomllib.loads(f"value = {cell.strip('`')}")["value"]
            assert default == ((value,) if isinstance(default, tuple) else value), key


def test_the_constants_are_told_with_range_and_default() -> None:
    """The ranges are expressions, tried on both sides of every bound: page and class allow the same values."""
    told = {key: row for (path, key), row in told_keys().items() if path == "material"}
    assert told.pop("constants")[2:4] == [f'`"{DEFAULT_SET}"`', ", ".join(f'`"{name}"`' for name in NAMED_SETS)]
    names = [field.name for field in fields(Material)]
    assert list(told) == names
    base = {name: float(getattr(NAMED_SETS[DEFAULT_SET], name)) for name in names}
    assert {name: float(row[2].strip("`")) for name, row in told.items()} == base
    *rules, last = sorted((row[3].strip("`") for row in told.values()), key=lambda rule: "h_i" in rule)
    assert "h_i" in last
    for name in names:
        for value in (-1.0, 0.0, 0.12, 0.2, 0.51, 0.7, 0.82, 0.9, 1.0, 1.2, 1.3, 30.0, 89.9, 90.0, 91.0):
            values = base | {name: value}
            fair = all(eval(rule, {}, values) for rule in rules) and eval(last, {}, values | {"h_i": bracket(**values)})
            with contextlib.nullcontext() if fair else pytest.raises(MaterialError):
                Material(**values)


def bracket(e_i0: float, e_d0: float, e_c0: float, phi_c: float, alpha: float, **_: float) -> float:
    """h_i as the theory page has it."""
    sine = np.sin(np.radians(phi_c))
    a_0 = np.sqrt(8 / 3) * sine / (3 - sine)
    return float(a_0**2 + 1 / 3 - ((e_i0 - e_d0) / (e_c0 - e_d0)) ** alpha * a_0 / np.sqrt(3))


def test_numbers_in_the_prose_of_the_scene_page() -> None:
    page = pages.words("docs/scene.md")
    assert f"move by more than {100 * effects.LARGE_DISPLACEMENT:g} % of the height" in page
    assert f"warns if shear strains exceeded {100 * effects.FAIR_SMALL_STRAIN:g} %" in page
    assert "By default 10 %, 1/3, 2/3 and all of a path of one leg, or the ends of the legs." in page
    assert default_profiles((Leg(3.0, 0.0),)) == pytest.approx((0.3, 1.0, 2.0, 3.0))
    assert default_profiles((Leg(3.0, 0.0), Leg(1.0, 0.0))) == (3.0, 1.0)


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
        for block in pages.blocks("docs/extending.md", "python"):
            exec(block, {})
    (told,) = pages.blocks("docs/extending.md", "text")
    number = r"-?\d+\.\d+"
    assert re.sub(number, "", output.getvalue()) == re.sub(number, "", told)
    for line, printed in zip(told.splitlines(), output.getvalue().splitlines(), strict=True):
        (rotation, stress), (w, s12) = ([float(n) for n in re.findall(number, it)] for it in (line, printed))
        assert w == pytest.approx(rotation, rel=5e-3, abs=1e-4)
        assert s12 == pytest.approx(stress, rel=2e-3)
