"""Only the effects a scene calls for: what is off leaves nothing behind, and the run is audited for it."""

from pathlib import Path
from typing import Any

import numpy as np
import pages
import pytest
from layers import difference
from planes import BASE, BIAXIAL, PRESSURE
from scenes import change

from cosserat_fx import audit
from cosserat_fx._compat import MPI
from cosserat_fx.audit import Audit
from cosserat_fx.bodies import Body, build
from cosserat_fx.conditions import Field
from cosserat_fx.effects import Effect, effects
from cosserat_fx.kernel_time import IN_KERNEL, kernel_shares, seconds_per_substep
from cosserat_fx.numerics import LARGE_DISPLACEMENT
from cosserat_fx.results import Run, read_run
from cosserat_fx.run import run
from cosserat_fx.scene import parse_scene

NAMES = [
    *("dimension", "polar", "finite strain", "spin", "evolving void ratio"),
    *("weight", "interface sliding", "hourglass stabilisation"),
]
LAYER: dict[str, Any] = {
    "geometry": {"height": 0.04, "cells": 20},
    "initial": {"stress": -PRESSURE, "void_ratio": 0.6},
    "walls": {"top": {"normal_stress": -PRESSURE, "shear_displacement": 0.01}},
    "output": {"figures": False, "fields": False},
}
PLANE = change(BASE, BIAXIAL | {"geometry.cells": [8, 8], "effects": {}, "output": {"figures": False, "fields": False}})
"""A square of 2 cm, compressed by 5 %."""
SCENES = {"layer": LAYER, "plane": PLANE}
KINDS = tuple(SCENES)
OFF: dict[str, dict[str, object]] = {
    "polar": {"effects.polar": False},
    "finite strain": {"effects.finite_strain": False},
    "spin": {"effects.spin": "none"},
    "evolving void ratio": {"effects.void_ratio": False},
}


def body(kind: str, changes: dict[str, object] | None = None) -> Body:
    return build(parse_scene(change(SCENES[kind], changes or {})), MPI.COMM_SELF)


def of(listed: list[Effect], name: str) -> Effect:
    [effect] = [effect for effect in listed if effect.name == name]
    return effect


def coefficients(it: Body) -> int:
    """How many functions the form of the internal work reads."""
    return int(it.problem._form.internal.ufcx_form.num_coefficients)


# -- the list ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("off", [{}, *OFF.values(), {"effects.polar": False, "effects.finite_strain": False}])
def test_every_effect_gives_its_reason_and_the_shares_add_up(kind: str, off: dict[str, object]) -> None:
    it = body(kind, off)
    listed, sizes = effects(it), it.problem.sizes
    assert [effect.name for effect in listed] == NAMES
    assert all(effect.reason for effect in listed)
    assert sum(effect.unknowns for effect in listed) == sizes["unknowns"]
    memory = sum(effect.bytes_per_point for effect in listed if effect.name != "hourglass stabilisation")
    assert memory == sizes["bytes_per_quadrature_point"]
    for effect in listed:
        assert effect.is_on or (effect.unknowns, effect.bytes_per_point) == (0, 0)


def test_the_bytes_of_a_point_are_those_of_the_arrays() -> None:
    state = body("plane").problem.state
    arrays = {id(a): a for a in vars(state).values() if isinstance(a, np.ndarray) and len(a) == len(state.e_n)}
    arrays = {key: a for key, a in arrays.items() if a is not state.points and a is not state.coordinates}
    arrays = {key: a for key, a in arrays.items() if a is not state.cells}
    assert sum(a.nbytes for a in arrays.values()) == state.bytes_per_point * len(state.e_n)


@pytest.mark.parametrize("kind", KINDS)
def test_large_displacements_are_taken_as_finite(kind: str) -> None:
    """A displacement just below and just above the bound, over the smallest extent of the body."""
    key, extent = {"layer": ("walls.top.shear_displacement", 0.04), "plane": ("boundaries.top.u2", 0.02)}[kind]
    for factor, choice in ((0.99, "off"), (1.01, "on")):
        listed = effects(body(kind, {key: factor * LARGE_DISPLACEMENT * extent}))
        assert of(listed, "finite strain").choice == choice
        assert f"{100 * factor * LARGE_DISPLACEMENT:.3g} %" in of(listed, "finite strain").reason


def test_weight_is_on_where_there_is_a_density() -> None:
    for kind in KINDS:
        weight = of(effects(body(kind, {"weight.density": 1600.0})), "weight")
        assert weight.is_on
        assert "1600 kg/m3" in weight.reason


@pytest.mark.parametrize(
    ("element", "hourglass", "choice", "word"),
    [("auto", 0.005, "on", "Q1R"), ("Q1R", 0.0, "off", "solver.hourglass = 0"), ("Q1", 0.005, "off", "Q1 ")],
)
def test_stabilisation_goes_with_the_element(element: str, hourglass: float, choice: str, word: str) -> None:
    listed = effects(body("plane", {"solver.element": element, "solver.hourglass": hourglass}))
    assert of(listed, "hourglass stabilisation").choice == choice
    assert word in of(listed, "hourglass stabilisation").reason


# -- what is off leaves nothing ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_a_classical_body_has_no_rotation_and_no_couple_stress(kind: str) -> None:
    polar, classical = body(kind).problem, body(kind, OFF["polar"]).problem
    assert 3 * classical.sizes["unknowns"] == 2 * polar.sizes["unknowns"]
    assert "w" not in classical.fields
    assert classical.layout.couple == classical.layout.curvature == ()
    assert len(classical.layout.forces) == 4
    assert classical.state.forces_n.shape[1] == 4


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("off", ["spin", "finite strain"])
def test_without_objective_rates_the_kernel_has_no_spin_among_its_inputs(kind: str, off: str) -> None:
    with_spin, without = body(kind).problem, body(kind, OFF[off]).problem
    assert without.layout.n_inputs == with_spin.layout.n_inputs - 1
    assert with_spin.state.tangent.x.array.size - without.state.tangent.x.array.size == len(without.state.e_n) * len(
        without.layout.strain_slots
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_frozen_void_ratio_has_no_trial_value(kind: str) -> None:
    evolving, frozen = body(kind).problem, body(kind, OFF["evolving void ratio"]).problem
    assert frozen.state.e is frozen.state.e_n
    saved = evolving.sizes["bytes_per_quadrature_point"] - frozen.sizes["bytes_per_quadrature_point"]
    assert saved == frozen.state.e_n.itemsize


@pytest.mark.parametrize("kind", KINDS)
def test_the_form_of_small_strain_reads_no_displacement(kind: str) -> None:
    """With elements that need no stabilisation, which would read it."""
    element: dict[str, object] = {"solver.element": "Q1"} if kind == "plane" else {}
    assert (coefficients(body(kind, element)), coefficients(body(kind, element | OFF["finite strain"]))) == (2, 1)


def test_without_stabilisation_the_form_has_no_term_and_no_coefficient_for_it() -> None:
    on, off = body("plane"), body("plane", {"solver.hourglass": 0.0})
    assert on.problem._form.stabilisation is not None
    assert off.problem._form.stabilisation is None
    assert (coefficients(on), coefficients(off)) == (3, 2)


@pytest.mark.parametrize("kind", KINDS)
def test_without_weight_there_is_no_load_in_the_body(kind: str) -> None:
    heavy, light = body(kind, {"weight.density": 1600.0}).problem, body(kind).problem
    assert None in heavy._form.external
    assert None not in light._form.external
    assert len(heavy._form.loads) == len(light._form.loads) + 1


# -- shares of the kernel's time ---------------------------------------------------------------------------------------


def test_the_effects_in_the_kernel_have_shares_of_its_time() -> None:
    """The stress of a classical continuum has fewer components, whose equations are solved faster."""
    it = body("layer")
    listed = kernel_shares(effects(it), it)
    shares = {effect.name: effect.kernel_time for effect in listed if effect.kernel_time is not None}
    assert shares.keys() == set(IN_KERNEL)
    assert all(0 <= share < 1 for share in shares.values())
    assert shares["polar"] > 0
    assert 1e-8 < seconds_per_substep(it) < 1e-3


def test_only_what_is_on_has_a_share() -> None:
    it = body("layer", OFF["polar"])
    assert of(kernel_shares(effects(it), it), "polar").kernel_time is None


# -- the audit ---------------------------------------------------------------------------------------------------------


def walk(kind: str, folder: Path, changes: dict[str, object]) -> Run:
    run(parse_scene(change(SCENES[kind], changes)), folder)
    return read_run(folder)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_said_about_a_run_with_all_effects(kind: str, tmp_path: Path) -> None:
    done = walk(kind, tmp_path / "run", {"effects.finite_strain": True})
    assert done.summary["status"] == "done"
    assert done.summary["warnings"] == []


def test_turning_without_objective_rates_is_told(tmp_path: Path) -> None:
    """In simple shear by gamma the material turns by atan(gamma/2), the mean of a layer by that of its mean strain."""
    off = OFF["spin"]
    [warning] = walk("layer", tmp_path / "far", {**off, "walls.top.shear_displacement": 0.04}).summary["warnings"]
    assert warning.startswith("spin was off, but the material turned by up to ")
    angle = float(warning.removeprefix("spin was off, but the material turned by up to ").split()[0])
    assert np.arctan(0.5) < angle < np.pi / 2
    fair = walk(
        "layer", tmp_path / "near", {**off, "walls.top.shear_displacement": 0.001, "effects.finite_strain": True}
    )
    assert fair.summary["warnings"] == []


@pytest.mark.parametrize(("angle", "told"), [(0.2, True), (0.1, False)])
def test_turning_under_small_strain_is_told(angle: float, told: bool) -> None:
    """A body that has been turned as a whole, without any strain that would tell."""
    it = body("plane", OFF["finite strain"])
    turn = np.array([[np.cos(angle) - 1, -np.sin(angle)], [np.sin(angle), np.cos(angle) - 1]])
    fields: tuple[Field, Field] = ("u1", "u2")
    for field, row in zip(fields, turn, strict=True):
        part = it.problem.fields[field]
        it.problem.committed.x.array[part.dofs] = part.coordinates @ row
    watch = Audit(it)
    watch.observe({"max_shear_strain": 0.0, "internal_work_J_per_m": 0.0, "hourglass_energy_J_per_m": 0.0})
    start = f"finite strain was off, but the material turned by up to {angle:.3g} rad"
    assert [it.startswith(start) for it in watch.warnings({})] == [True] * told


@pytest.mark.parametrize("kind", KINDS)
def test_a_frozen_void_ratio_that_mattered_is_told(kind: str, tmp_path: Path) -> None:
    """Dilation to near the critical state matters as much as the warning says; before it there is nothing to tell."""
    key, far, near = {
        "layer": ("walls.top.shear_displacement", 0.01, 5e-4),
        "plane": ("boundaries.top.u2", -6e-3, -4e-4),
    }[kind]
    frozen = walk(kind, tmp_path / "far", {**OFF["evolving void ratio"], key: far})
    [warning] = [it for it in frozen.summary["warnings"] if it.startswith("the void ratio was frozen")]
    assert float(warning.split(" by up to ")[1].split(" %")[0]) > 100 * audit.FAIR_DENSITY_FACTOR
    assert walk(kind, tmp_path / "near", {**OFF["evolving void ratio"], key: near}).summary["warnings"] == []


def test_a_fairly_frozen_void_ratio_changes_little(tmp_path: Path) -> None:
    short: dict[str, object] = {"walls.top.shear_displacement": 5e-4}
    frozen = walk("layer", tmp_path / "frozen", short | OFF["evolving void ratio"])
    evolving = walk("layer", tmp_path / "evolving", short)
    end = difference(frozen.history["shear_stress_Pa"][-1:], evolving.history["shear_stress_Pa"][-1:])
    assert 0 < end < audit.FAIR_DENSITY_FACTOR


def test_a_classical_band_is_one_cell_and_told(tmp_path: Path) -> None:
    """From one weak cell, half as large on a mesh twice as fine; with polar effects the band is the same on both."""
    thickness: dict[bool, list[float]] = {True: [], False: []}
    for polar in thickness:
        for cells in (20, 40):
            weak = {"initial.zones": [{"y": [0.02, 0.02 + 0.04 / cells], "void_ratio": 0.65}], "geometry.cells": cells}
            options: dict[str, object] = {"effects.polar": polar, "stepping.branch": "primary"}
            summary = walk("layer", tmp_path / f"{cells}_{polar}", options | weak).summary
            told = [
                it for it in summary["warnings"] if it.startswith("polar effects were off, but the strain localised")
            ]
            assert len(told) == (not polar)
            assert polar or "or 1 cell(s)" in told[0]
            thickness[polar].append(summary["band"]["thickness_m"])
    assert thickness[False] == pytest.approx([0.002, 0.001], rel=0.02)
    assert thickness[True][0] == pytest.approx(thickness[True][1], rel=0.15)


def test_a_classical_layer_that_shears_evenly_is_not_told_off(tmp_path: Path) -> None:
    even = walk("layer", tmp_path / "even", {"effects.polar": False, "stepping.branch": "primary"})
    assert even.summary["band"]["touches"] == "both"
    assert not any("polar" in warning for warning in even.summary["warnings"])


def test_small_strain_in_a_plane_is_audited(tmp_path: Path) -> None:
    squeezed = walk("plane", tmp_path / "run", {**OFF["finite strain"], "boundaries.top.u2": -0.004})
    assert squeezed.history["max_shear_strain"][-1] > audit.FAIR_SMALL_STRAIN
    assert any(it.startswith("finite strain was off, but the shear strain") for it in squeezed.summary["warnings"])


# -- documentation -----------------------------------------------------------------------------------------------------


def test_what_the_scene_page_says_about_the_audit() -> None:
    page = pages.words("docs/scene.md")
    for words in (
        f"warns if shear strains exceeded {100 * audit.FAIR_SMALL_STRAIN:g} %",
        f"turned by more than {audit.FAIR_ROTATION:g} rad",
        f"as it does in simple shear by {100 * audit.FAIR_SMALL_STRAIN:g} %",
        f"the density factor f_d by more than {100 * audit.FAIR_DENSITY_FACTOR:g} %",
        f"a band of up to {audit.BAND_IN_CELLS:g} cells",
    ):
        assert words in page


@pytest.mark.parametrize(("energy", "told"), [(0.04, []), (0.06, ["holds 6 % of the internal work"])])
def test_hourglass_modes_that_hold_much_of_the_work_are_told(energy: float, told: list[str]) -> None:
    watch = Audit(body("plane"))
    watch.observe({"max_shear_strain": 0.1, "internal_work_J_per_m": 1.0, "hourglass_energy_J_per_m": energy})
    assert [word in warning for word, warning in zip(told, watch.warnings({}), strict=True)] == [True] * len(told)
