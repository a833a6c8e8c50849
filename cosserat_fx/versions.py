"""Versions of everything that a result depends on."""

from __future__ import annotations

import platform

import basix
import ffcx
import mpi4py
import numba
import numpy as np
import petsc4py
import ufl

import cosserat_fx
from cosserat_fx._compat import MPI, PETSc, dolfinx


def versions() -> dict[str, str]:
    """Name and version of this package, of what it computes with, and of the MPI and PETSc libraries below."""
    modules = (dolfinx, ufl, basix, ffcx, petsc4py, mpi4py, numba, np)
    return {
        "cosserat_fx": cosserat_fx.__version__,
        "python": platform.python_version(),
        **{module.__name__: module.__version__ for module in modules},
        "petsc": ".".join(str(part) for part in PETSc.Sys.getVersion()),
        "mpi": MPI.Get_library_version().strip("\x00 ").splitlines()[0],
    }
