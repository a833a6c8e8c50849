"""The matrix of a form: DOLFINx fills rows of its own, which PETSc shares where one process holds all of them."""

from __future__ import annotations

from collections.abc import Sequence

from cosserat_fx._compat import PETSc, dolfinx


class FormMatrix:
    """A PETSc matrix with the sparsity of a bilinear form, and the way to fill it.

    PETSc looks up the place of every entry that is added to it. DOLFINx's own matrix has shorter ways to the same
    places; with several processes the rows at their interfaces would have to be sent, which PETSc does.

    Attributes:
        petsc: the matrix.
    """

    def __init__(self, form: dolfinx.fem.Form) -> None:
        """Make an empty matrix.

        Args:
            form: bilinear.
        """
        self._form = form
        self._rows: dolfinx.la.MatrixCSR | None = None
        if form.mesh.comm.size > 1:
            self.petsc: PETSc.Mat = dolfinx.fem.petsc.create_matrix(form)
            return
        self._rows = rows = dolfinx.fem.create_matrix(form, dolfinx.la.BlockMode.expanded)
        starts, columns = (part.astype(PETSc.IntType, copy=False) for part in (rows.indptr, rows.indices))
        size = 2 * (len(starts) - 1,)
        self.petsc = PETSc.Mat().createAIJWithArrays(size, (starts, columns, rows.data), comm=form.mesh.comm)
        block = form.function_spaces[0].dofmap.index_map_bs  # multigrid keeps the components of a node together
        self.petsc.setBlockSizes(block, block)

    def assemble(self, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Assemble the form, with unit rows and zero columns at prescribed entries.

        Args:
            bcs: what is prescribed.
        """
        if self._rows is None:
            self.petsc.zeroEntries()
            dolfinx.fem.petsc.assemble_matrix(self.petsc, self._form, bcs=bcs)
            self.petsc.assemble()
            return
        self._rows.data[:] = 0.0
        dolfinx.fem.assemble_matrix(self._rows, self._form, bcs=bcs)
        self.petsc.stateIncrease()
