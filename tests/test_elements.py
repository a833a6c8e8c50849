"""The elements: convergence on good and bad meshes, patch tests, free modes, resistance to hourglass modes, work."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ufl
from body import Body
from elastic import BETA, GAMMA, MU, MU_C, Fields, solve, stiffness
from meshes import Mesh, square, write_msh
from planes import (
    BIAXIAL,
    D50,
    PRESSURE,
    Shape,
    build,
    elastic_body,
    even,
    kind,
    on_file,
    scattered,
    stress,
    to_dolfinx,
    visits,
    zigzag,
)
from points import update
from ufl.core.expr import Expr

from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.conditions import Field, Prescribed
from cosserat_fx.elements import ELEMENTS, Element
from cosserat_fx.forms import stabilization
from cosserat_fx.material import Material
from cosserat_fx.meshes import file as meshfile
from cosserat_fx.newton import NewtonSolver
from cosserat_fx.problem import Problem
from cosserat_fx.stepping import StepControl, Stepper
from cosserat_fx.typing import Array
from cosserat_fx.weakform import Numerics

HOURGLASS = 0.005
ROUNDOFF = 1e-11
SAND = Material.named("paper-sand", d50=D50)

each_element = pytest.mark.parametrize("element", ELEMENTS.values(), ids=ELEMENTS)
polar_or_not = pytest.mark.parametrize("polar", [True, False], ids=["polar", "classical"])


def resistance(element: Element) -> float:
    """Factor of the resistance to hourglass modes that an element has by default."""
    return HOURGLASS if element.stabilised else 0.0


# -- convergence -------------------------------------------------------------------------------------------------------


def orders(element: Element, shape: Callable[[int], Shape], *, polar: bool, hourglass: float) -> list[float]:
    """Orders of the errors of u and w in L2 and then of their gradients, by least squares in logarithms."""
    cells = (6, 12, 24) if element.order == 1 else (4, 8, 16)
    errors = [solve(elastic_body(element, n, shape, polar=polar), hourglass) for n in cells]
    return [float(slope) for slope in -np.polyfit(np.log(cells), np.log(errors), 1)[0]]


@each_element
@polar_or_not
@pytest.mark.parametrize(("shape", "tolerance"), [(even, 0.1), (scattered, 0.15)], ids=["even", "scattered"])
def test_elastic_solutions_converge(
    element: Element, polar: bool, shape: Callable[[int], Shape], tolerance: float
) -> None:
    """One order more for a quadratic displacement, but for its own error where the rotation is linear.

    That one of the rotation is of second order, and so are the stresses that it leaves to the displacement to balance.
    """
    found = orders(element, shape, polar=polar, hourglass=resistance(element))
    p = element.order
    expected = [2.0, 2.0, p, 1.0] if polar else [p + 1.0, p]
    assert np.all(np.array(found) > np.array(expected) - tolerance)


def test_a_mesh_in_the_pattern_of_hourglasses_asks_for_more_resistance() -> None:
    """What one point leaves out of the work of such cells drives their hourglass mode.

    Without resistance its gradient does not vanish with the size of the cells; the displacements still converge.
    """
    element = ELEMENTS["Q1R"]
    free, held = (orders(element, zigzag, polar=True, hourglass=c) for c in (0.0, 0.2))
    assert free[2] < 0.5
    assert min(free[:2]) > 1.5
    assert np.all(np.array(held) > [1.9, 1.9, 0.9, 0.9])


# -- patch tests -------------------------------------------------------------------------------------------------------


def constant_strain(x: Expr, y: Expr) -> tuple[Expr, Expr, Expr]:
    """All four strains differ."""
    return 0.3 + 0.7 * x - 0.4 * y, 0.2 - 0.9 * x + 0.5 * y, ufl.as_ufl(0.25)


def constant_curvature(x: Expr, y: Expr) -> tuple[Expr, Expr, Expr]:
    """Rotations without displacements: the force stresses are linear and antisymmetric."""
    return ufl.as_ufl(0.0), ufl.as_ufl(0.0), 0.3 + 0.7 * x - 0.4 * y


def pure_bending(x: Expr, y: Expr) -> tuple[Expr, Expr, Expr]:
    """Particles turn with the cross-sections: of the strains only the normal one along x1 is not nought."""
    return -0.8 * x * y, 0.4 * x**2, 0.8 * x


PATCHES = [
    *((name, constant_strain) for name in ELEMENTS),
    *((name, constant_curvature) for name in ELEMENTS if name != "Q1R"),
    *((name, pure_bending) for name in ("Q2Q1", "P2P1")),
]


@pytest.mark.parametrize(("name", "fields"), PATCHES, ids=[f"{name}-{fields.__name__}" for name, fields in PATCHES])
@pytest.mark.parametrize("shape", [scattered, zigzag])
def test_patch_tests_are_passed_on_distorted_meshes(name: str, fields: Fields, shape: Callable[[int], Shape]) -> None:
    element = ELEMENTS[name]
    patch = elastic_body(element, 4, shape)
    assert solve(patch, resistance(element), fields=fields, degree=element.degree) == pytest.approx(0, abs=ROUNDOFF)


@each_element
def test_classical_patch_tests_are_passed(element: Element) -> None:
    patch = elastic_body(element, 4, scattered, polar=False)
    errors = solve(patch, resistance(element), fields=constant_strain, degree=element.degree)
    assert errors == pytest.approx(0, abs=ROUNDOFF)


def test_one_point_holds_a_constant_curvature_on_even_cells() -> None:
    """On others it integrates linear stresses at a wrong place."""
    element = ELEMENTS["Q1R"]
    errors = [
        solve(elastic_body(element, 4, shape), HOURGLASS, fields=constant_curvature, degree=element.degree).max()
        for shape in (even, scattered)
    ]
    assert errors[0] < ROUNDOFF
    assert errors[1] > 1e-3


# -- free modes --------------------------------------------------------------------------------------------------------


def free_modes(body: Body, hourglass: float) -> int:
    """Number of motions that meet no resistance."""
    sizes = np.linalg.eigvalsh(stiffness(body, hourglass).toarray())
    return int(np.sum(np.abs(sizes) < 1e-10 * sizes[-1]))


@each_element
@polar_or_not
@pytest.mark.parametrize("n", [1, 3])
def test_nothing_but_rigid_motions_is_free(element: Element, polar: bool, n: int) -> None:
    """Two translations and the rotation, which takes the particles along."""
    assert free_modes(elastic_body(element, n, scattered, polar=polar), resistance(element)) == 3


@polar_or_not
@pytest.mark.parametrize("n", [1, 3])
def test_one_point_without_resistance_leaves_one_more_mode_per_field(polar: bool, n: int) -> None:
    """Corners that go to and fro in turn, whatever the shape of the cells."""
    body = elastic_body(ELEMENTS["Q1R"], n, scattered, polar=polar)
    fields = np.unique(body.field)
    assert free_modes(body, 0.0) == 3 + len(fields)
    number = np.rint(n * body.position)
    for field in fields:
        pattern = np.where(body.field == field, (-1.0) ** number.sum(axis=1), 0.0)
        assert np.abs(stiffness(body, 0.0) @ pattern).max() < 1e-12
        assert pattern @ stiffness(body, HOURGLASS) @ pattern > 0


# -- resistance to hourglass modes -------------------------------------------------------------------------------------


def one_cell(corners: Array) -> Mesh:
    """A quadrilateral of corners around, in m."""
    sides = {"bottom": [0, 1], "right": [1, 2], "top": [2, 3], "left": [3, 0]}
    lines = {name: np.array([ends]) for name, ends in sides.items()}
    return Mesh(np.asarray(corners, dtype=float), np.arange(4)[None, :], lines, {"all": np.array([0])})


def amplitude(corners: Array, values: Array) -> float:
    """Of the hourglass mode in values at corners around (Flanagan and Belytschko 1981).

    It is the alternating sum of the values less that of the linear field with their gradient at the centre.
    """
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    along = np.array([[-1, 1, 1, -1], [-1, -1, 1, 1]]) / 2
    gradient = np.linalg.solve(along @ corners, along @ values)
    return float(signs @ (values - corners @ gradient))


QUADRILATERAL = np.array([[0.1, 0.0], [1.3, 0.2], [1.1, 1.4], [-0.2, 0.8]])


def test_hourglass_energy_of_any_quadrilateral_is_that_of_its_amplitudes() -> None:
    """c/24 (G (g1^2 + g2^2) + M g3^2) for random values at the corners."""
    body = Body(to_dolfinx(one_cell(QUADRILATERAL)), "plane", polar=True, finite=False)
    shear, couple = MU + MU_C, GAMMA + BETA
    x = body.unknown.x.array
    x[:] = np.random.default_rng(4).uniform(-1, 1, len(x))
    u, w = body.split(body.unknown)
    stiff, curved = (dolfinx.fem.Constant(body.mesh, c * HOURGLASS) for c in (shear, couple))
    dx = ufl.dx(body.mesh, metadata={"quadrature_degree": 1})
    twice = dolfinx.fem.assemble_scalar(dolfinx.fem.form(stabilization.hourglass_work(u, w, u, w, stiff, curved, dx)))

    def mode(field: str) -> float:
        here = np.flatnonzero(body.field == field)
        at = np.linalg.norm(body.position[here] - QUADRILATERAL[:, None], axis=2).argmin(axis=1)
        return amplitude(QUADRILATERAL, x[here[at]])

    expected = HOURGLASS / 24 * (shear * (mode("u1") ** 2 + mode("u2") ** 2) + couple * mode("w3") ** 2)
    assert twice / 2 == pytest.approx(expected, rel=1e-12)


SIDES = {name: {"u1": 0.0, "u2": 0.0} for name in ("bottom", "top", "left", "right")}


def test_hourglass_energy_of_a_problem_on_a_parallelogram(tmp_path: Path) -> None:
    """Alternating values have a amplitude of four times their own there, whatever its shape and size.

    G is the initial shear stiffness f_s a^2 of the theory page's numbers, and M = G (a_c d50/a)^2.
    """
    size, along, up = 5e-3, np.array([1.0, 0.2]), np.array([-0.3, 0.9])
    corners = np.array([np.zeros(2), along, along + up, up])
    scene = {"boundaries": SIDES | {"top": {"u1": 0.0, "u2": 1e-5}}, "solver": {"hourglass": 0.02}}
    problem = build(on_file(tmp_path / "cell.msh", one_cell(corners), size) | scene).problem
    shear = 153.594675e6 * 0.3265986**2
    stiffnesses = {"u1": shear, "u2": shear, "w": shear * (D50 / 0.3265986) ** 2}
    for name, stiff in stiffnesses.items():
        part = problem.fields[name]  # type: ignore[index]
        parity = np.rint(np.linalg.solve(np.stack([along, up], axis=1), part.coordinates.T / size)).sum(axis=0)
        for value in (1e-3, 2e-3, -2e-3):
            problem.unknown.x.array[:] = 0.0
            problem.unknown.x.array[part.dofs] = value * (-1) ** parity
            assert problem.hourglass_energy() == pytest.approx(0.02 / 24 * stiff * (4 * value) ** 2, rel=1e-6)


# -- the same elements in a problem ------------------------------------------------------------------------------------

DISPLACEMENTS: tuple[Field, ...] = ("u1", "u2")
GRADIENT = np.array([[0.3, 0.5], [0.5, -1.0]])
"""Of a displacement without rotation, times the travel, 1/m; all its stages commute, so none of them turns."""


def linear(side: str, field: Field, row: Array) -> Prescribed:
    """A displacement of so much per length and travel."""
    return Prescribed(side, field, lambda travel: (travel,), lambda at: (at @ row)[:, None])


@each_element
@polar_or_not
def test_sand_deforms_evenly_on_a_distorted_mesh(element: Element, polar: bool, tmp_path: Path) -> None:
    """Linear displacements of all sides: one state everywhere, which is that of the law alone, and no hourglasses."""
    file = write_msh(tmp_path / "square.msh", square(3, 3, kind(element), scattered(3)))
    numerics = Numerics(polar=polar, order=element.order, degree=element.degree, hourglass=resistance(element))
    conditions = [
        linear(side, field, row) for side in SIDES for field, row in zip(DISPLACEMENTS, GRADIENT, strict=True)
    ]
    body = meshfile.read(file, MPI.COMM_SELF, scale=D50)
    problem = Problem(body, SAND, conditions, stress=-PRESSURE, void_ratio=0.6, numerics=numerics)
    sizes, steps = [0.01, 0.015, 0.0225], []
    for step in Stepper(problem, NewtonSolver(problem), [0.0, sum(sizes)], [], StepControl(0.01, tolerance=1.0)):
        steps.append(step.size)
    forces, void_ratio = problem.state.forces_n[problem.state.points], problem.state.e_n[problem.state.points]
    expected = np.array([[-PRESSURE if i == j else 0.0 for i, j in problem.layout.forces]])
    density, travel = np.array([0.6]), 0.0
    for size in steps:
        increment = size * GRADIENT @ np.linalg.inv(np.eye(2) + (travel + size / 2) * GRADIENT)
        assert np.allclose(increment, increment.T, rtol=1e-12)
        driven = np.zeros((1, problem.layout.n_inputs))
        driven[0, : len(problem.layout.strain)] = [increment[at] for at in problem.layout.strain]
        point = update(problem.layout, driven, expected, density, adapt=True, tolerance=1e-3, material=SAND)
        expected, density, travel = point.forces, point.void_ratio, travel + size
    assert len(steps) >= 3
    scales = np.array([1.0] * len(problem.layout.stress) + [1 / D50] * len(problem.layout.couple))
    assert np.abs((forces - expected) * scales).max() < 1e-6 * PRESSURE
    assert void_ratio == pytest.approx(density[0], abs=1e-7)
    stiff = SAND.shear_stiffness(PRESSURE, np.array([0.6]))[0]
    assert abs(problem.hourglass_energy()) < 1e-12 * stiff * D50**2


WIDTH = 0.02
LOCALLY_EXACT = {"solver.local_tolerance": 1e-7}


def test_internal_work_is_that_of_the_forces_at_the_boundaries() -> None:
    """Step by step the mean of the forces before and after times the displacement, with that of the pressure beside."""
    body = build(BIAXIAL)
    work, before = 0.0, None
    for _, problem in visits(body):
        acting = problem.boundary_forces()
        forces = np.array([[acting[side][name] for name in ("force1", "force2")] for side in SIDES])
        moves = np.array([[problem.boundary_mean(side, field) for field in DISPLACEMENTS] for side in SIDES])
        if before is not None:
            work += np.sum((before[0] + forces) / 2 * (moves - before[1]))
        before = forces, moves
    assert problem.internal_work == pytest.approx(work, rel=1e-9)
    assert problem.internal_work > 0


def test_internal_work_of_an_even_compression_is_that_of_its_stress() -> None:
    """Sum of sigma : d_eps V, all half-way through each step, but for a remainder of second order in the step."""
    remainders = []
    for size in (1e-4, 5e-5, 2.5e-5):
        body = build(BIAXIAL | {"stepping.first_step": size, "stepping.max_step": size, **LOCALLY_EXACT})
        body.stepper.control = replace(body.stepper.control, tolerance=1.0)
        work, before = 0.0, None
        for _, problem in visits(body):
            width = WIDTH + problem.boundary_mean("right", "u1") - problem.boundary_mean("left", "u1")
            height = WIDTH + problem.boundary_mean("top", "u2")
            after = np.array([width, height]), np.array([stress(problem, i, i).mean() for i in (0, 1)])
            if before is not None:
                middle = (before[0] + after[0]) / 2
                work += np.sum((before[1] + after[1]) / 2 * (after[0] - before[0]) / middle) * np.prod(middle)
            before = after
        remainders.append(problem.internal_work / work - 1)
    assert np.log2(np.abs(remainders[:-1]) / np.abs(remainders[1:])) == pytest.approx([2.0, 2.0], abs=0.1)
    assert abs(remainders[0]) < 1e-3
