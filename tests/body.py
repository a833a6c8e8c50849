"""Bodies whose stresses and tangent are given, so that the weak forms can be tested without a constitutive law."""

from functools import cached_property

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from ufl.core.expr import Expr

from cosserat_fx._compat import MPI, dolfinx, evaluate
from cosserat_fx.forms import balance, kinematics
from cosserat_fx.layout import Dimension, layout
from cosserat_fx.typing import Array
from cosserat_fx.weakform import element


def mesh(dimension: Dimension, cells: tuple[int, ...], size: tuple[float, ...]) -> dolfinx.mesh.Mesh:
    """An interval of x2 for a layer, quadrilaterals for a plane, hexahedra for a solid; one corner at the origin."""
    if dimension == "layer":
        return dolfinx.mesh.create_interval(MPI.COMM_SELF, cells[0], [0.0, size[0]])
    corners = [np.zeros(len(size)), np.array(size)]
    if dimension == "plane":
        kind = dolfinx.mesh.CellType.quadrilateral
        return dolfinx.mesh.create_rectangle(MPI.COMM_SELF, corners, list(cells), cell_type=kind)
    return dolfinx.mesh.create_box(MPI.COMM_SELF, corners, list(cells), cell_type=dolfinx.mesh.CellType.hexahedron)


class Body:
    """Finite elements on a mesh with quadrature functions for the forces and the tangent, on one rank.

    Attributes:
        layout: components and their order.
        unknown, committed: the fields at the end and at the start of the step.
        step: the increments in between, 3x3 tensors.
        forces: quadrature function of stresses and couple stresses.
        tangent: quadrature function of the derivatives of the driven ones.
        field: (n,) name of the field that each degree of freedom belongs to, "u1" to "w3".
        position: (n, gdim) coordinates of each degree of freedom in the mesh as it was at first.
    """

    def __init__(
        self,
        mesh: dolfinx.mesh.Mesh,
        dimension: Dimension,
        *,
        polar: bool,
        finite: bool,
        spin: str = "macro",
        degree: int = 1,
        order: int = 1,
    ) -> None:
        self.mesh, self.dimension, self.finite = mesh, dimension, finite
        self.layout = layout(dimension, polar=polar)
        self.space = dolfinx.fem.functionspace(mesh, element(mesh, polar=polar, order=order))
        self.unknown = dolfinx.fem.Function(self.space)
        self.committed = dolfinx.fem.Function(self.space)
        self._tabulate_dofs()

        (u, w), (u_n, w_n) = self.split(self.unknown), self.split(self.committed)
        self.step = kinematics.increments(u, u_n, w, w_n, dimension, finite=finite, spin=spin)
        self._increments = kinematics.pack(
            (self.step.strain, self.layout.strain),
            (self.step.curvature, self.layout.curvature),
            (self.step.spin, self.layout.spin),
        )
        self.volume = kinematics.determinant(kinematics.deformation_gradient(u, dimension, finite=finite), dimension)
        v, q = self.split(ufl.TestFunction(self.space))
        strain, curvature = kinematics.virtual_strain(v, q, u, dimension, finite=finite)
        self._virtual = kinematics.pack((strain, self.layout.strain), (curvature, self.layout.curvature))

        self._rule_points = basix.make_quadrature(mesh.basix_cell(), degree)[0]
        self._dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": degree, "quadrature_scheme": "default"})
        self.forces = self._quadrature_function(degree, (len(self.layout.forces),))
        self.tangent = self._quadrature_function(degree, (len(self.layout.strain_slots), self.layout.n_inputs))

    def split(self, function: Expr) -> tuple[Expr, Expr | None]:
        """Displacement and rotation."""
        return ufl.split(function) if self.layout.polar else (function, None)

    def _tabulate_dofs(self) -> None:
        spaces = {}
        displacement = self.space.sub(0) if self.layout.polar else self.space
        for i in range(displacement.num_sub_spaces):
            spaces[f"u{i + 1}"] = displacement.sub(i)
        if self.layout.polar:
            rotation = self.space.sub(1)
            spaces |= {f"w{i + 1}": rotation.sub(i) for i in range(rotation.num_sub_spaces)} or {"w3": rotation}
        size, gdim = len(self.unknown.x.array), self.mesh.geometry.dim
        self.field: npt.NDArray[np.str_] = np.full(size, "??")
        self.position: Array = np.full((size, gdim), np.nan)
        for name, space in spaces.items():
            collapsed, parent = space.collapse()
            dofs = np.asarray(parent).reshape(-1)
            self.field[dofs] = name
            self.position[dofs] = collapsed.tabulate_dof_coordinates()[:, :gdim]

    def _quadrature_function(self, degree: int, shape: tuple[int, ...]) -> dolfinx.fem.Function:
        pointwise = basix.ufl.quadrature_element(self.mesh.basix_cell(), value_shape=shape, degree=degree)
        return dolfinx.fem.Function(dolfinx.fem.functionspace(self.mesh, pointwise))

    # -- values at the quadrature points, (points, ...), cell by cell ------------------------------------------------

    def fill(self, function: dolfinx.fem.Function, values: Array) -> None:
        """Write the values of a quadrature function."""
        rows = function.function_space.dofmap.list.reshape(-1)
        function.x.array.reshape(len(rows), -1)[rows] = values.reshape(len(rows), -1)

    def at_points(self, vector: Expr) -> Array:
        """The values of a vector."""
        return self._evaluate(dolfinx.fem.Expression(vector, self._rule_points), len(vector))

    def _evaluate(self, expression: dolfinx.fem.Expression, size: int) -> Array:
        cells = np.arange(self.mesh.topology.index_map(self.mesh.topology.dim).size_local, dtype=np.int32)
        values = np.zeros((len(cells) * len(self._rule_points), size))
        evaluate(expression, self.mesh, cells, values)
        return values

    @property
    def points(self) -> Array:
        """Coordinates of the points in the mesh as it is."""
        return self.at_points(ufl.SpatialCoordinate(self.mesh))

    @cached_property
    def _increments_expression(self) -> dolfinx.fem.Expression:
        return dolfinx.fem.Expression(self._increments, self._rule_points)

    def increments(self) -> Array:
        """The layout's increments of strain, curvature and spin."""
        return self._evaluate(self._increments_expression, self.layout.n_inputs)

    # -- forms -------------------------------------------------------------------------------------------------------

    def work(self, forces: Expr) -> ufl.Form:
        """Internal work of any forces."""
        slots, weights = self.layout.strain_slots, self.layout.weights
        return balance.internal_work(forces, slots, weights, self._virtual, self.volume, self._dx)

    @cached_property
    def _residual_form(self) -> dolfinx.fem.Form:
        return dolfinx.fem.form(self.work(self.forces))

    @cached_property
    def _jacobian_form(self) -> dolfinx.fem.Form:
        form = balance.linearised_work(
            self.work(self.forces),
            self.unknown,
            ufl.TrialFunction(self.space),
            self.tangent,
            self._increments,
            self.layout.strain_slots,
            self.layout.weights,
            self._virtual,
            self.volume,
            self._dx,
        )
        return dolfinx.fem.form(form)

    def residual(self) -> Array:
        """Internal work of the forces, assembled."""
        return np.array(dolfinx.fem.assemble_vector(self._residual_form).array)

    def jacobian(self) -> Array:
        """Linearised work of the forces and the tangent, assembled, as a dense matrix."""
        return np.asarray(dolfinx.fem.assemble_matrix(self._jacobian_form).to_dense())

    # -- random states -----------------------------------------------------------------------------------------------

    def deform(self, rng: np.random.Generator, size: float) -> None:
        """Give both fields random nodal displacements up to a size, and random rotations."""
        for function in (self.committed, self.unknown):
            values = rng.uniform(-1, 1, len(self.field))
            function.x.array[:] = np.where(np.char.startswith(self.field, "u"), size, 1.0) * values

    def load(self, rng: np.random.Generator) -> None:
        """Give the points random forces and tangents."""
        for function in (self.forces, self.tangent):
            function.x.array[:] = rng.normal(size=len(function.x.array))

    def move_mesh(self, displacement: Array) -> None:
        """Move the nodes of the mesh as the displacements in a vector of unknowns say.

        In a layer u2 alone moves a node; the forms of a layer do not depend on x1.
        """
        gdim = self.mesh.geometry.dim
        nodes = self.mesh.geometry.x
        at = nodes[:, :gdim].copy()
        for axis, name in enumerate(("u2",) if gdim == 1 else ("u1", "u2", "u3")[:gdim]):
            dofs = np.flatnonzero(self.field == name)
            distance = np.linalg.norm(at[:, None] - self.position[dofs], axis=2)
            nodes[:, axis] += displacement[dofs[distance.argmin(axis=1)]]
