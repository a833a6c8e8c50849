import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest
from hypothesis import given, settings
from scenes import ABSENT, FRACTIONS, LAYER, Mutation, assert_scene_or_clear_refusal, changed_layer, mutations, to_toml

from cosserat_fx.material import Material
from cosserat_fx.scene import LayerScene, SceneError, load_scene, parse_scene
from cosserat_fx.scenes.file import MAX_FILE_SIZE

MEDIUM_ROUGH = """
title = "Plane shearing under a medium rough wall"
[geometry]
kind = "layer"
height = 0.04
cells = 80
[material]
constants = "paper-sand"
d50 = 0.5e-3
[initial]
stress = -100e3
void_ratio = 0.6
[walls.bottom]
rolling = 0.0
[walls.top]
rolling = 0.0125
normal_stress = -100e3
shear_displacement = 0.03
[output]
profiles_at = [0.004, 0.01, 0.02, 0.03]
"""


def parse_layer(tables: Mapping[str, object]) -> LayerScene:
    scene = parse_scene(tables)
    assert isinstance(scene, LayerScene)
    return scene


def load_layer(path: Path, overrides: Sequence[str] = ()) -> LayerScene:
    scene = load_scene(path, overrides)
    assert isinstance(scene, LayerScene)
    return scene


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(MEDIUM_ROUGH)
    return path


def test_the_scene_of_the_design_page_reads_as_written(scene_file: Path) -> None:
    scene = load_layer(scene_file)
    assert scene.title == "Plane shearing under a medium rough wall"
    assert (scene.geometry.kind, scene.geometry.height, scene.geometry.cells) == ("layer", 0.04, 80)
    assert scene.material == Material.named("paper-sand")
    assert (scene.initial.stress, scene.initial.void_ratio) == (-100e3, 0.6)
    assert (scene.walls.bottom.rolling, scene.walls.bottom.shear_displacement) == (0.0, (0.0,))
    assert (scene.walls.top.rolling, scene.walls.top.normal_stress) == (0.0125, -100e3)
    assert scene.legs == ((0.03, 0.0),)
    assert scene.output.profiles_at == (0.004, 0.01, 0.02, 0.03)


def test_what_a_scene_leaves_out_is_filled_in() -> None:
    scene = parse_layer(LAYER)
    assert scene.material == Material.named("paper-sand")
    assert (scene.walls.bottom.rolling, scene.walls.top.rolling, scene.walls.top.constant_height) == (0.0, 0.0, False)
    assert scene.effects.model_dump() == {"polar": True, "finite_strain": "auto", "spin": "macro", "void_ratio": True}
    assert scene.stepping.model_dump() == {
        "first_step": None,
        "max_step": None,
        "min_step": None,
        "tolerance": 0.12,
        "strain": 0.4,
        "max_steps": 100000,
        "max_jumps": 150,
        "branch": None,
    }
    assert (scene.solver.integration_points, scene.solver.petsc) == (1, {})
    assert (scene.output.fields, scene.output.figures) == (True, True)
    assert scene.output.profiles_at == pytest.approx((0.003, 0.01, 0.02, 0.03), rel=1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {
            "title": 'a "quoted" title \\',
            "solver.petsc": {"snes_monitor": True, "snes_max_it": 7, "pc_type": "lu", "snes_divtol": 1e30},
        },
        {"material": {"d50": 5e-3, "phi_c": 35}, "stepping.first_step": 1e-3, "effects.finite_strain": True},
        {"walls.top.shear_displacement": [4e-3, -4e-3, 4e-3], "walls.top.rolling": 0.125},
        {"walls.bottom": FRACTIONS, "walls.top.normal_stress": ABSENT, "walls.top.constant_height": True},
        {"output.profiles_at": []},
    ],
)
def test_a_scene_survives_a_round_trip_through_toml_and_json(changes: dict[str, object], tmp_path: Path) -> None:
    scene = parse_scene(changed_layer(changes))
    path = tmp_path / "again.toml"
    path.write_text(to_toml(scene.as_dict()))
    assert load_scene(path) == scene
    assert parse_scene(json.loads(json.dumps(scene.as_dict()))) == scene


def test_a_scene_is_frozen() -> None:
    with pytest.raises(ValueError, match="frozen"):
        parse_layer(LAYER).geometry.height = 1.0


def test_a_material_given_as_such_is_taken() -> None:
    coarse = Material.named("paper-sand", d50=5e-3)
    assert parse_scene({**LAYER, "material": coarse}).material is coarse


def test_a_whole_number_is_a_number() -> None:
    assert parse_layer(changed_layer({"geometry.height": 1})).geometry.height == 1.0


@pytest.mark.parametrize(
    ("wall", "displacement_factor", "rotation_times_radius"),
    [({}, 1.0, 0.0), ({"rolling": 0.0125}, 1.0, 0.0125), (FRACTIONS, 0.8, 0.15)],
)
def test_walls_move_and_turn_the_particles(
    wall: dict[str, float], displacement_factor: float, rotation_times_radius: float
) -> None:
    bottom = parse_layer(changed_layer({"walls.bottom": wall})).walls.bottom
    assert bottom.displacement_factor == displacement_factor
    assert bottom.rolling_rotation_factor(0.5e-3) == pytest.approx(rotation_times_radius / 0.25e-3)


def test_both_forms_of_a_wall_law_turn_the_particles_alike() -> None:
    by_fractions = parse_layer(changed_layer({"walls.bottom": FRACTIONS})).walls.bottom
    by_ratio = parse_layer(changed_layer({"walls.bottom.rolling": FRACTIONS["f_r"] / FRACTIONS["f_u"]})).walls.bottom
    wall_displacement, d50 = 0.02, 0.5e-3
    particle_displacement = by_fractions.displacement_factor * wall_displacement
    assert by_fractions.rolling_rotation_factor(d50) * wall_displacement == pytest.approx(
        by_ratio.rolling_rotation_factor(d50) * particle_displacement
    )


@pytest.mark.parametrize(
    ("top", "bottom", "legs"),
    [
        (0.03, ABSENT, [(0.03, 0)]),
        ([4e-3, -4e-3, 4e-3], ABSENT, [(4e-3, 0), (-4e-3, 0), (4e-3, 0)]),
        (ABSENT, [0.01, 0.02], [(0, 0.01), (0, 0.02)]),
        (0.01, -0.01, [(0.01, -0.01)]),
        ([0.01, 0.01], [0, -0.01], [(0.01, 0), (0.01, -0.01)]),
    ],
)
def test_legs_pair_the_targets_of_the_walls(top: object, bottom: object, legs: list[tuple[float, float]]) -> None:
    scene = parse_layer(changed_layer({"walls.top.shear_displacement": top, "walls.bottom.shear_displacement": bottom}))
    assert list(scene.legs) == legs
    assert [leg.travel for leg in scene.legs] == [a - b for a, b in legs]
    assert scene.largest_displacement == max(abs(a - b) for a, b in legs)


@pytest.mark.parametrize(
    ("changes", "profiles"),
    [
        ({"walls.top.shear_displacement": -0.03}, [-0.003, -0.01, -0.02, -0.03]),
        ({"walls.bottom.shear_displacement": -0.03}, [0.006, 0.02, 0.04, 0.06]),
        ({"walls.top.shear_displacement": [4e-3, -4e-3, 4e-3]}, [4e-3, -4e-3, 4e-3]),
        ({"walls.bottom.shear_displacement": 0.03}, []),
        (
            {"walls.top.shear_displacement": [0.01, 0.02], "walls.bottom.shear_displacement": [0.0, 0.01]},
            [0.01],
        ),
    ],
)
def test_profiles_are_spread_over_one_leg_or_taken_at_the_ends_of_several(
    changes: dict[str, object], profiles: list[float]
) -> None:
    assert parse_layer(changed_layer(changes)).output.profiles_at == pytest.approx(tuple(profiles), rel=1e-12)


def test_profiles_are_placed_in_turn_on_a_path_that_turns_back() -> None:
    travels = [0.0, 2e-3, 2e-3, -4e-3, 2e-3, 4e-3]
    path = {"walls.top.shear_displacement": [4e-3, -4e-3, 4e-3], "output.profiles_at": travels}
    stations = parse_layer(changed_layer(path)).profile_stations
    assert [(station.leg, station.travel) for station in stations] == list(
        zip([0, 0, 1, 1, 2, 2], travels, strict=True)
    )
    assert [station.fraction for station in stations] == pytest.approx([0, 0.5, 0.25, 1, 0.75, 1])


def test_a_profile_within_rounding_of_the_end_is_at_the_end() -> None:
    walls = {"walls.top.shear_displacement": 0.1, "walls.bottom.shear_displacement": -0.2, "output.profiles_at": 0.3}
    assert 0.1 + 0.2 != 0.3
    assert parse_layer(changed_layer(walls)).profile_stations == ((0, 1.0, 0.3),)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[geometry]\nheight = \n", r"not valid TOML: Invalid value \(at line 2, column 10\)"),
        (b"a = 1\na = 2\n", r"not valid TOML: .*\(at line 2"),
        (b'title = "ok"\n# \xff\n', "must be UTF-8 text, but line 2 is not"),
        (b"a = " + b"[" * 5000, "not valid TOML: nested too deeply"),
        (b"a = " + b"9" * 5000, "not valid TOML: Exceeds the limit"),
        (b"#" * (MAX_FILE_SIZE + 1), "must not be larger than 10000000 bytes"),
        (b"", "geometry is missing: must be a table"),
    ],
    ids=["syntax", "twice", "encoding", "depth", "digits", "size", "empty"],
)
def test_a_file_that_is_no_scene_is_refused(content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=message):
        load_scene(path)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"nowhere\.toml: cannot be read as a scene file: No such file or directory"):
        load_scene(tmp_path / "nowhere.toml")
    with pytest.raises(SceneError, match="cannot be read as a scene file: Is a directory"):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    ("override", "value", "read"),
    [
        ("geometry.cells=640", 640, lambda scene: scene.geometry.cells),
        (" geometry.height = 1e-2 ", 0.01, lambda scene: scene.geometry.height),
        ("material.constants=paper-sand", Material.named("paper-sand"), lambda scene: scene.material),
        ("material.phi_c=35", 35.0, lambda scene: scene.material.phi_c),
        ("walls.bottom.rolling=0.1", 0.1, lambda scene: scene.walls.bottom.rolling),
        ("walls.top.shear_displacement=[0.01, 0.03]", (0.01, 0.03), lambda s: s.walls.top.shear_displacement),
        ("effects.spin=none", "none", lambda scene: scene.effects.spin),
        ("effects.finite_strain=false", False, lambda scene: scene.effects.finite_strain),
        ('title="3"', "3", lambda scene: scene.title),
        ("title=a = b, said [c", "a = b, said [c", lambda scene: scene.title),
        ("title=__import__('os').getcwd()", "__import__('os').getcwd()", lambda scene: scene.title),
        ("title=1\ngeometry.cells = 3", "1\ngeometry.cells = 3", lambda scene: scene.title),
        ("solver.petsc.snes_max_it=7", {"snes_max_it": 7}, lambda scene: scene.solver.petsc),
        ("output={profiles_at = [0.01]}", (0.01,), lambda scene: scene.output.profiles_at),
    ],
)
def test_an_override_sets_one_key(
    override: str, value: object, read: Callable[[LayerScene], object], scene_file: Path
) -> None:
    assert read(load_layer(scene_file, [override])) == value


def test_the_last_of_several_overrides_wins(scene_file: Path) -> None:
    assert load_layer(scene_file, ["geometry.cells=1", "geometry.cells=2"]).geometry.cells == 2


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("geometry.cells", '"geometry.cells": an override must read key.path=value'),
        ("=3", '"=3": an override must read'),
        ("geometry..cells=3", "an override must read"),
        ("title.short=3", 'title.short = "3": cannot be set, as title is not a table'),
        ("geometry.cell=3", "geometry.cell = 3: unknown key, did you mean cells?"),
        ("geometry.cells=many", 'geometry.cells = "many": must be a whole number'),
        ("geometry.height=", 'geometry.height = "": must be a finite number'),
        ("title=\udcff", r'title = "\udcff": must be UTF-8 text'),
    ],
)
def test_a_bad_override_is_refused(override: str, message: str, scene_file: Path) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene(scene_file, [override])
    assert message in str(caught.value)


COMPLETE = parse_scene(
    changed_layer(
        {
            "stepping": {"min_step": 1e-6, "first_step": 1e-5, "max_step": 1e-3},
            "weight.density": 1600.0,
            "initial.zones": [{"y": [0.0, 0.01], "void_ratio": 0.7}],
            "initial.random": {"standard_deviation": 0.01, "correlation_length_d50": 4.0, "seed": 1},
        }
    )
).as_dict()


@settings(max_examples=300, deadline=None)
@given(chosen=mutations(COMPLETE))
def test_whatever_comes_in_a_scene_or_a_clear_refusal_comes_out(chosen: list[Mutation]) -> None:
    assert_scene_or_clear_refusal(COMPLETE, chosen)
