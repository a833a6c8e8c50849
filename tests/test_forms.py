"""The forms alone: layer against plane, deformed meshes, rigid motions, volume, derivatives, an elastic solution."""

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest
import ufl
from body import Body, mesh
from elastic import solve

from cosserat_fx.forms import kinematics
from cosserat_fx.layout import Dimension
from cosserat_fx.typing import Array

ROUNDOFF = 1e-13
KINDS = [
    pytest.param(polar, finite, id=f"{'polar' if polar else 'classical'}-{'finite' if finite else 'small'}")
    for polar, finite in product((True, False), repeat=2)
]


def rng() -> np.random.Generator:
    return np.random.default_rng(20)


def order(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of the errors over the sizes in logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def close(a: Array, b: Array, scale: float | None = None) -> bool:
    """Whether arrays agree to roundoff, by default with respect to their largest entry."""
    return float(np.abs(a - b).max()) < ROUNDOFF * (np.abs(b).max() if scale is None else scale)


# -- a plane whose fields do not depend on x1 is a layer ---------------------------------------------------------------


def driven(body: Body) -> list[tuple[str, tuple[int, int]]]:
    """Names of the inputs of the constitutive update."""
    table = body.layout
    return [(k, c) for k, cs in (("e", table.strain), ("k", table.curvature), ("w", table.spin)) for c in cs]


@pytest.mark.parametrize("columns", [1, 3])
@pytest.mark.parametrize("degree", [1, 3], ids=["1-point", "2-point"])
@pytest.mark.parametrize(("polar", "finite"), KINDS)
def test_plane_forms_on_a_strip_sum_to_the_forms_of_a_layer(
    polar: bool, finite: bool, degree: int, columns: int
) -> None:
    """Fields and stresses are random over x2 and constant over x1; so are virtual fields that are summed over a row.

    What belongs to the strain 11 and the curvature 31, which a layer has not, is random, too, and must not matter.
    """
    height, cells, width, random = 0.8, 4, 0.7, rng()
    layer = Body(mesh("layer", (cells,), (height,)), "layer", polar=polar, finite=finite, degree=degree)
    strip = mesh("plane", (columns, cells), (width, height))
    plane = Body(strip, "plane", polar=polar, finite=finite, degree=degree)
    row = (layer.field[:, None] == plane.field) & np.isclose(layer.position, plane.position[:, 1])
    assert np.all(row.sum(axis=0) == 1)
    assert np.all(row.sum(axis=1) == columns + 1)

    layer.deform(random, 0.4 * height / cells)
    plane.unknown.x.array[:] = row.T @ layer.unknown.x.array
    plane.committed.x.array[:] = row.T @ layer.committed.x.array
    level = np.argmax(np.isclose(plane.points[:, 1:], layer.points.T), axis=1)
    assert np.all(np.isclose(plane.points[:, 1], layer.points[level, 0]))
    of_plane, rows = driven(plane), len(plane.layout.strain_slots)
    common = [of_plane.index(name) for name in driven(layer)]
    forces = random.normal(size=(len(layer.points), len(plane.layout.forces)))
    tangent = random.normal(size=(len(layer.points), rows, len(of_plane)))
    assert layer.layout.forces == plane.layout.forces
    plane.fill(plane.forces, forces[level])
    plane.fill(plane.tangent, tangent[level])
    layer.fill(layer.forces, forces)
    layer.fill(layer.tangent, tangent[:, [k for k in common if k < rows]][:, :, common])

    inputs = layer.increments()[level]
    assert close(plane.increments()[:, common], inputs)
    assert np.abs(np.delete(plane.increments(), common, axis=1)).max() < ROUNDOFF
    assert close(row @ plane.residual() / width, layer.residual())
    assert close(row @ plane.jacobian() @ row.T / width, layer.jacobian())


# -- finite strain and small strain, polar and classical ---------------------------------------------------------------

MESHES: dict[Dimension, tuple[tuple[int, ...], tuple[float, ...]]] = {
    "layer": ((4,), (0.8,)),
    "plane": ((2, 3), (0.5, 0.9)),
    "solid": ((2, 1, 2), (1.0, 0.6, 1.2)),
}


def few_cells(dimension: Dimension, *, polar: bool, finite: bool, spin: str = "macro", degree: int = 3) -> Body:
    return Body(mesh(dimension, *MESHES[dimension]), dimension, polar=polar, finite=finite, spin=spin, degree=degree)


def nodal(body: Body, values: Array, letter: str) -> Array:
    """(nodes, 3) displacements ("u") or rotations ("w") in a vector of unknowns, nought where the body has none."""
    nodes = np.count_nonzero(body.field == "u1")
    names = [f"{letter}{i}" for i in (1, 2, 3)]
    return np.stack([values[body.field == name] if name in body.field else np.zeros(nodes) for name in names], axis=1)


def places(body: Body) -> Array:
    """(nodes, 3) coordinates in the undeformed body."""
    at = body.position[body.field == "u1"]
    return np.pad(at, ((0, 0), (0, 3 - at.shape[1])))


@pytest.mark.parametrize("polar", [True, False], ids=["polar", "classical"])
@pytest.mark.parametrize("dimension", MESHES)
def test_finite_strain_is_small_strain_on_the_deformed_mesh(dimension: Dimension, polar: bool) -> None:
    """The work at the end of the step, the increments half-way."""
    finite = few_cells(dimension, polar=polar, finite=True)
    finite.deform(rng(), 0.06)
    finite.load(rng())
    for at, result in ((1.0, Body.residual), (0.5, Body.increments)):
        there = few_cells(dimension, polar=polar, finite=False)
        start, end = finite.committed.x.array, finite.unknown.x.array
        there.move_mesh((1 - at) * start + at * end)
        there.committed.x.array[:], there.unknown.x.array[:] = start, end
        there.forces.x.array[:] = finite.forces.x.array
        assert close(result(finite), result(there))


@pytest.mark.parametrize("dimension", MESHES)
def test_a_classical_body_is_a_polar_one_with_symmetric_stress(dimension: Dimension) -> None:
    """The virtual displacements of a polar body do the same work as those of a classical one, which has no others."""
    random = rng()
    classical, polar = (few_cells(dimension, polar=polar, finite=True) for polar in (False, True))
    classical.deform(random, 0.06)
    for name in np.unique(classical.field):
        here, there = classical.field == name, polar.field == name
        assert np.array_equal(classical.position[here], polar.position[there])
        polar.unknown.x.array[there] = classical.unknown.x.array[here]
    stress = random.normal(size=(len(classical.points), len(classical.layout.stress)))
    both = np.zeros((len(stress), len(polar.layout.forces)))
    both[:, : len(polar.layout.stress)] = stress[:, [classical.layout.stress_index(*at) for at in polar.layout.stress]]
    classical.fill(classical.forces, stress)
    polar.fill(polar.forces, both)
    assert close(nodal(polar, polar.residual(), "u"), nodal(classical, classical.residual(), "u"))


# -- rigid motions -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("polar", "finite"), KINDS)
@pytest.mark.parametrize("dimension", MESHES)
def test_a_rigid_translation_strains_nothing(dimension: Dimension, polar: bool, finite: bool) -> None:
    """It starts from any deformation and is longer than the body."""
    moved = few_cells(dimension, polar=polar, finite=finite)
    moved.deform(rng(), 0.06)
    translation = {"u1": 3.0, "u2": -2.0, "u3": 1.0}
    moved.unknown.x.array[:] = moved.committed.x.array + [translation.get(name, 0.0) for name in moved.field]
    assert np.abs(moved.increments()).max() < 3.0 / 0.2 * ROUNDOFF


def cross(axis: Array) -> Array:
    """Matrix of the vector product with an axis."""
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation(axis: Array, angle: float) -> Array:
    """Rodrigues' matrix."""
    k = cross(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)


def turn(body: Body, values: Array, axis: Array, angle: float) -> None:
    """Displacements and rotations of a rigid rotation about the origin."""
    displacement = places(body) @ (rotation(axis, angle) - np.eye(3)).T
    for i in range(3):
        if f"u{i + 1}" in body.field:
            values[body.field == f"u{i + 1}"] = displacement[:, i]
        values[body.field == f"w{i + 1}"] = angle * axis[i]


@pytest.mark.parametrize(
    ("dimension", "axis"), [("plane", (0.0, 0.0, 1.0)), ("solid", (2 / 7, -6 / 7, 3 / 7))], ids=["plane", "solid"]
)
def test_strain_left_by_a_finite_rigid_rotation_is_of_third_order(
    dimension: Dimension, axis: tuple[float, float, float]
) -> None:
    """On the mid-step configuration the gradient of a rotation by t is 2 tan(t/2) times the axis' cross product.

    With R = Q R_n it is 2 (Q - I)(Q + I)^-1, the Cayley transform of Q doubled. The Cosserat rotation adds -t times the
    same product, and 2 tan(t/2) - t = t^3/12 + O(t^5): in the plane a turn to the left leaves eps21 = -eps12 = t^3/12.
    That is also by how much the two spins differ.
    """
    n, angles, left = np.array(axis), [0.4, 0.2, 0.1, 0.05], []
    bodies = [few_cells(dimension, polar=True, finite=True, spin=spin, degree=1) for spin in ("macro", "cosserat")]
    for angle in angles:
        macro = 2 * np.tan(angle / 2)
        for turned, increment in zip(bodies, (macro, angle), strict=True):
            turn(turned, turned.committed.x.array, n, 0.9)
            turn(turned, turned.unknown.x.array, n, 0.9 + angle)
            expected = {"e": (macro - angle) * cross(n), "k": np.zeros((3, 3)), "w": increment * cross(n)}
            inputs = turned.increments()
            assert close(inputs, np.array([expected[kind][at] for kind, at in driven(turned)]), scale=1.0)
        left.append(np.abs(inputs[:, : len(turned.layout.strain)]).max())
    assert order(angles, left) == pytest.approx(3.0, abs=0.02)
    assert left[-1] == pytest.approx(angles[-1] ** 3 / 12 * max(abs(n)), rel=1e-3)


@pytest.mark.parametrize("dimension", ["plane", "solid"])
def test_a_classical_body_is_not_strained_by_a_rigid_rotation(dimension: Dimension) -> None:
    turned = few_cells(dimension, polar=False, finite=True, degree=1)
    turn(turned, turned.unknown.x.array, np.array([0.0, 0.0, 1.0]), 0.8)
    strain = turned.increments()[:, : len(turned.layout.strain)]
    assert np.abs(strain).max() < ROUNDOFF


@pytest.mark.parametrize(("polar", "finite"), KINDS)
@pytest.mark.parametrize("dimension", MESHES)
def test_internal_forces_balance_in_force_and_moment(dimension: Dimension, polar: bool, finite: bool) -> None:
    """Virtual rigid motions of the body as it lies do no work."""
    loaded = few_cells(dimension, polar=polar, finite=finite, degree=1)
    loaded.deform(rng(), 0.06)
    loaded.load(rng())
    work = loaded.residual()
    force, couple = nodal(loaded, work, "u"), nodal(loaded, work, "w")
    place = places(loaded) + (nodal(loaded, loaded.unknown.x.array, "u") if finite else 0.0)
    total, moment = force.sum(axis=0), (np.cross(place, force) + couple).sum(axis=0)
    turns = {"layer": [], "plane": [2], "solid": [0, 1, 2]}[dimension]
    assert np.abs([*total, *moment[turns]]).max() < ROUNDOFF * np.abs(work).sum()


# -- volume ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dimension", ["layer", "plane"])
def test_volume_follows_the_trace_of_the_strain(dimension: Dimension) -> None:
    """On the mid-step configuration J - J_n = J_m tr(d_eps) exactly.

    The ratio J/J_n is exp(tr(d_eps)), which the law's void ratio takes it for, to third order in the increment.
    """
    strained = few_cells(dimension, polar=True, finite=True, degree=1)
    strained.deform(rng(), 0.06)
    start, whole = strained.committed.x.array, strained.unknown.x.array - strained.committed.x.array
    (u, _), (u_n, _) = strained.split(strained.unknown), strained.split(strained.committed)
    volumes = ufl.as_vector(
        [
            kinematics.determinant(kinematics.deformation_gradient(field, dimension, finite=True), dimension)
            for field in (u_n, (u_n + u) / 2, u)
        ]
    )
    parts, errors = [0.04, 0.02, 0.01, 0.005], []
    normal = [i == j for i, j in strained.layout.strain]
    for part in parts:
        strained.unknown.x.array[:] = start + part * whole
        before, middle, after = strained.at_points(volumes).T
        trace = strained.increments()[:, : len(normal)][:, normal].sum(axis=1)
        assert close(after - before, middle * trace, scale=1.0)
        errors.append(float(np.abs(after / before / np.exp(trace) - 1).max()))
    assert order(parts, errors) == pytest.approx(3.0, abs=0.05)


# -- the linearised work -----------------------------------------------------------------------------------------------

LINEARISATIONS = [
    pytest.param(True, True, "macro", id="polar-finite-macro"),
    pytest.param(True, True, "cosserat", id="polar-finite-cosserat"),
    pytest.param(False, True, "macro", id="classical-finite-macro"),
    pytest.param(True, False, "macro", id="polar-small-macro"),
    pytest.param(False, False, "none", id="classical-small-none"),
]


@pytest.mark.parametrize(("polar", "finite", "spin"), LINEARISATIONS)
@pytest.mark.parametrize("dimension", ["layer", "plane"])
def test_linearised_work_is_the_derivative_of_the_work(
    dimension: Dimension, polar: bool, finite: bool, spin: str
) -> None:
    """Stresses that grow with all increments by a random matrix: the remainder is of second order, or nought."""
    random = rng()
    hypoelastic = few_cells(dimension, polar=polar, finite=finite, spin=spin)
    hypoelastic.deform(random, 0.06)
    table, points = hypoelastic.layout, len(hypoelastic.points)
    moduli = random.normal(size=(points, len(table.strain_slots), table.n_inputs))
    initial = random.normal(size=(points, len(table.forces)))
    hypoelastic.fill(hypoelastic.tangent, moduli)
    x = hypoelastic.unknown.x.array

    def residual() -> Array:
        forces = initial.copy()
        forces[:, table.strain_slots] += np.einsum("pij,pj->pi", moduli, hypoelastic.increments())
        hypoelastic.fill(hypoelastic.forces, forces)
        return hypoelastic.residual()

    here, at = x.copy(), residual()
    direction = random.uniform(-0.06, 0.06, len(x))
    slope = hypoelastic.jacobian() @ direction
    parts, remainders = [0.1 / 2**k for k in range(6)], []
    for part in parts:
        x[:] = here + part * direction
        remainders.append(float(np.linalg.norm(residual() - at - part * slope)))
    if finite:
        assert order(parts, remainders) == pytest.approx(2.0, abs=0.05)
    else:
        assert max(remainders) < ROUNDOFF * np.linalg.norm(slope)


# -- a manufactured solution -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dimension", "degree", "cells"),
    [
        pytest.param("layer", 1, (8, 16, 32, 64), id="layer-1-point"),
        pytest.param("layer", 3, (8, 16, 32, 64), id="layer-2-point"),
        pytest.param("plane", 3, (6, 12, 24), id="plane-2x2-points"),
    ],
)
def test_an_elastic_solution_converges(dimension: Dimension, degree: int, cells: tuple[int, ...]) -> None:
    """Second order in L2 and first order in H1, for the displacement and for the rotation."""
    dim = 1 if dimension == "layer" else 2
    errors = np.array(
        [
            solve(Body(mesh(dimension, (n,) * dim, (1.0,) * dim), dimension, polar=True, finite=False, degree=degree))
            for n in cells
        ]
    )
    orders = [order([1 / n for n in cells], error) for error in errors.T.tolist()]
    assert orders == pytest.approx([2.0, 2.0, 1.0, 1.0], abs=0.05)
