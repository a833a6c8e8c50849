"""What one run of a plane body with one element on one mesh comes to."""

from __future__ import annotations

import gc
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any
from unittest.mock import patch

import basix.ufl
import numpy as np
from element_meshes import Pattern, alternating_part, write_rectangle

from cosserat_fx import elements, plane, weakform
from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.elements import ELEMENTS, Element
from cosserat_fx.output.plane_bands import NoBandError, measure_band
from cosserat_fx.output.plane_fields import PlaneState
from cosserat_fx.output.plane_observation import PlaneObserver
from cosserat_fx.scene import PlaneScene, load_scene, parse_scene
from cosserat_fx.scenes.plane import RectangleGeometry
from cosserat_fx.stepping import StepControl, Stepper, SteppingError

HERE = Path(__file__).resolve().parent
SMALLEST = 1 / 64
"""A step that fails at this part of its size ends the run."""
PATIENCE = 3
"""How many times as many steps as without a failure a run may take."""


@dataclass(frozen=True)
class Case:
    """A scene to compare elements in.

    Attributes:
        file: the scene.
        step: size of all steps (m).
        top_force: the force on the top that counts, "force1" or "force2"; over the width it is a stress.
        band: whether there is a shear band to measure.
        keys: of the scene that are replaced.
    """

    file: Path
    step: float
    top_force: str = "force2"
    band: bool = False
    keys: tuple[str, ...] = ()


CASES: Mapping[str, Case] = {
    "biaxial": Case(HERE.parent / "demos" / "biaxial.toml", 0.25e-3, band=True),
    "platens": Case(HERE / "scenes" / "platens.toml", 0.1e-3),
    "core": Case(HERE / "scenes" / "core.toml", 0.2e-3),
    "platens, 15 %": Case(HERE / "scenes" / "platens.toml", 0.2e-3, keys=("boundaries.top.wall.u2=-0.003",)),
    "shear": Case(HERE / "scenes" / "shear.toml", 0.2e-3, top_force="force1"),
}
TRIALS: dict[str, Element] = {
    "P2P1, 1 point": replace(ELEMENTS["P2P1"], degree=1),
    "P2P1, 6 points": replace(ELEMENTS["P2P1"], degree=4),
    "Q2Q1, 4 points": replace(ELEMENTS["Q2Q1"], degree=3),
    "P1 with bubble": replace(ELEMENTS["P1"], degree=2),
}
"""Elements that the program does not offer: other numbers of points, and a displacement with a bubble in each cell."""


@dataclass(frozen=True)
class ElementRun:
    """What one run came to.

    Attributes:
        study: which comparison it belongs to.
        case: name of the scene.
        element: its name.
        pattern: of the mesh.
        side: of the mesh's squares over d50.
        distortion: by how much of this side corners were moved at most, and with which seed.
        hourglass: factor of the resistance, None where the element has none.
        cells, unknowns, points: how many.
        stress: of the top at the end of the path, compression or shear along the motion positive, nan where the run
            failed (Pa).
        thickness: of the band, nan where there is none (m).
        inclination: of the band to the horizontal (degrees).
        sawtooth: largest part of the rotation that alternates from node to node (degrees); nan on distorted meshes.
        hourglass_share: energy of the resistance over the internal work (%).
        steps, iterations, cutbacks, passages: totals.
        seconds: processor time of the loop over the steps, the median of the repeats.
        end: travel reached (m).
        failure: why it stopped there, empty where it was the end of the path.
        state: the body at the end.
    """

    study: str
    case: str
    element: str
    pattern: Pattern
    side: float
    distortion: str
    hourglass: float | None
    cells: int
    unknowns: int
    points: int
    stress: float
    thickness: float
    inclination: float
    sawtooth: float
    hourglass_share: float
    steps: int
    iterations: int
    cutbacks: int
    passages: int
    seconds: float
    end: float
    failure: str
    state: PlaneState = field(repr=False)

    def __str__(self) -> str:
        """One line for the log."""
        mesh = f"{self.element:14s} {self.pattern:9s} {self.side:5.4g} {self.distortion:9s}"
        found = f"{1e-3 * self.stress:9.3f} kPa, band {1e3 * self.thickness:6.3f} mm, sawtooth {self.sawtooth:.3g} deg"
        effort = f"{self.steps} steps, {self.iterations} iterations, {self.cutbacks} cutbacks, {self.seconds:.1f} s"
        return f"{self.study:12s} {self.case:13s} {mesh} {found}, {effort} {self.failure}"


def measure(
    study: str,
    name: str,
    element: str,
    *,
    pattern: Pattern = "squares",
    side: float = 2.5,
    distortion: float = 0.0,
    seed: int = 0,
    hourglass: float | None = None,
    repeats: int = 1,
) -> ElementRun:
    """Run a scene with an element on a mesh, all steps of one size where none fails.

    Args:
        study: kept with the result.
        name: of the case.
        element: one of the program's or of the trials.
        pattern: of the mesh.
        side: of the mesh's squares over d50.
        distortion: by how much of this side inner corners are moved at most.
        seed: of these moves.
        hourglass: factor of the resistance, the scene's own if None.
        repeats: how often to run.
    """
    case = CASES[name]
    with TemporaryDirectory() as folder, _offered(element):
        scene = _scene(case, element, pattern, side, distortion, seed, hourglass, Path(folder))
        runs = [_walk(scene, case, _squares(case, side)) for _ in range(repeats)]
    seconds = median(run.pop("seconds") for run in runs)
    return ElementRun(
        study,
        name,
        element,
        pattern,
        side,
        f"{100 * distortion:g} %, {seed}" if distortion else "",
        scene.solver.hourglass if (TRIALS | ELEMENTS)[element].stabilised else None,
        seconds=seconds,
        **runs[0] | ({"sawtooth": math.nan} if distortion else {}),
    )


@contextmanager
def _offered(element: str) -> Iterator[None]:
    """Lets the program choose a trial for the while."""
    spaces = _enriched if "bubble" in element else weakform.element
    with patch.dict(elements.ELEMENTS, TRIALS), patch.object(weakform, "element", spaces):
        yield


def _enriched(mesh: dolfinx.mesh.Mesh, *, polar: bool, order: int) -> Any:
    """Linear displacement with a bubble in every triangle, and linear rotation."""
    assert polar
    cell = mesh.basix_cell()
    linear, bubble = basix.ufl.element("Lagrange", cell, order), basix.ufl.element("Bubble", cell, 3)
    displacement = basix.ufl.blocked_element(basix.ufl.enriched_element([linear, bubble]), shape=(2,))
    return basix.ufl.mixed_element([displacement, linear])


def _squares(case: Case, side: float) -> tuple[int, int]:
    """Numbers of squares along both axes of a case's rectangle.

    Args:
        case: whose scene has one.
        side: of the squares over d50.
    """
    scene = load_scene(case.file)
    assert isinstance(scene.geometry, RectangleGeometry)
    length = side * scene.material.d50
    return round(scene.geometry.width / length), round(scene.geometry.height / length)


def _scene(
    case: Case,
    element: str,
    pattern: Pattern,
    side: float,
    distortion: float,
    seed: int,
    hourglass: float | None,
    folder: Path,
) -> PlaneScene:
    """The case's scene on the mesh asked for, which is written to a file where it is not the rectangle's own."""
    tables = load_scene(case.file, case.keys).as_dict()
    rectangle = tables["geometry"]
    cells = _squares(case, side)
    if pattern == "squares" and not distortion:
        rectangle["cells"] = list(cells)
    else:
        file = folder / "mesh.msh"
        size = rectangle["width"], rectangle["height"]
        write_rectangle(file, size, cells, pattern, distortion=distortion, seed=seed)
        tables["geometry"] = {"kind": "mesh", "file": str(file)}
    if hourglass is not None:
        tables["solver"]["hourglass"] = hourglass
    scene = parse_scene(tables)
    assert isinstance(scene, PlaneScene)
    return scene.model_copy(update={"solver": scene.solver.model_copy(update={"element": element})})


def _walk(scene: PlaneScene, case: Case, squares: tuple[int, int]) -> dict[str, Any]:
    """Go along the path and measure.

    Returns:
        Values of the attributes of :class:`ElementRun` that follow from the walk.
    """
    body = plane.build(scene, MPI.COMM_SELF)
    smallest = SMALLEST * case.step
    problem, corners = body.problem, body.path.corners
    most = round(PATIENCE * corners[-1] / case.step)
    control = StepControl(
        *(case.step, case.step, smallest), tolerance=math.inf, strain=math.inf, growth=2.0, max_steps=most
    )
    stepper, steps, failure = Stepper(problem, body.stepper.solver, corners, [], control), [], ""
    start = process_time()
    try:
        for step in stepper:
            steps.append(step)
    except SteppingError as stopped:
        failure = str(stopped)
    seconds = process_time() - start
    observer = PlaneObserver(problem, list(scene.boundaries), {}, start=body.path.start)
    state = observer.state(observer.travel(steps[-1]))
    assert state is not None
    assert state.rotation is not None
    width = float(np.ptp(problem.geometry.extent()[:, 0]))
    force = problem.boundary_forces()["top"][case.top_force]
    sizes = problem.sizes
    sawtooth = np.degrees(np.abs(alternating_part(state.rotation, squares)).max())
    found = {
        **_band(body, state, case),
        "cells": sizes["cells"],
        "unknowns": sizes["unknowns"],
        "points": sizes["quadrature_points"],
        "stress": math.nan if failure else abs(force) / width,
        "sawtooth": float(sawtooth),
        "hourglass_share": 100 * problem.hourglass_energy() / problem.internal_work,
        "steps": len(steps),
        "iterations": sum(step.iterations for step in steps),
        "cutbacks": sum(step.cutbacks for step in steps),
        "passages": sum(step.passages for step in steps),
        "seconds": seconds,
        "end": state.travel,
        "failure": failure,
        "state": state,
    }
    body.stepper.solver.snes.destroy()  # or its callbacks keep the problem, and with it MPI communicators
    del body, stepper, problem, observer
    gc.collect()
    return found


def _band(body: plane.Plane, state: PlaneState, case: Case) -> dict[str, float]:
    """Thickness (m) and inclination (degrees) of the band, nan where there is none."""
    geometry, d50 = body.problem.geometry, body.scene.material.d50
    facets = {name: geometry.facets(name)[0] for name in geometry.boundaries}
    try:
        band = measure_band(state, facets, d50=d50) if case.band else None
    except NoBandError:
        band = None
    if band is None:
        return {"thickness": math.nan, "inclination": math.nan}
    return {"thickness": band.thickness_m, "inclination": band.inclination_deg}
