"""How the constitutive kernel is compiled from the functions of several modules and kept on disk."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, cast

import numpy as np
from numba import njit

from cosserat_fx.typing import IntArray

_INLINED = (
    "dense.py",
    "elementary.py",
    "hypoplasticity.py",
    "integration.py",
    "material.py",
    "rows.py",
    "stages.py",
    "tables.py",
    "update.py",
)


def inline[Function: Callable[..., Any]](function: Function) -> Function:
    """Decorator: compile a function into each of its compiled callers, where the callers' constants fold."""
    return cast(Function, njit(forceinline=True, error_model="numpy")(function))


def kernel[Function: Callable[..., Any]](function: Function) -> Function:
    """Decorator: compile a function once, for all of its compiled callers."""
    return cast(Function, njit(error_model="numpy")(function))


@cache
def fingerprint() -> IntArray:
    """Digest of the modules that are compiled into the kernel beside its own.

    Numba keeps the kernel on disk until the file that defines it changes, whatever happens to the modules whose
    functions it took in. Among the constants of the kernel, this digest makes their changes count too.
    """
    here = Path(__file__).parent
    digest = sha256(b"".join((here / name).read_bytes() for name in _INLINED)).digest()
    return np.frombuffer(digest, dtype=np.int32)
