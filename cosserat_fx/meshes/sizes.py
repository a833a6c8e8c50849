"""The size of the elements against the thickness of the shear bands that they have to resolve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosserat_fx.geometry import Geometry

BAND = 10.0
"""Thickness of a shear band in mean grain diameters, about; larger elements hold no band."""
RESOLVING = 4.0
"""Size of an element in mean grain diameters above which two of them no longer fit into a band."""
_ROUNDING = 1e-9

_EVEN = 1e-3
"""Relative difference up to which sizes are told as one."""


@dataclass(frozen=True)
class SizeReport:
    """Element sizes (the roots of their areas; lengths in a layer) over the mean grain diameter.

    Attributes:
        smallest, median, largest: of all elements on all ranks.
        warning: what to tell where bands are resolved poorly in places, or None.
        error: why such a mesh is refused, or None.
    """

    smallest: float
    median: float
    largest: float
    warning: str | None = None
    error: str | None = None

    def __str__(self) -> str:
        """One size, or the range of sizes."""
        even = self.largest <= self.smallest * (1 + _EVEN)
        return f"{self.median:.3g} d50" if even else f"{self.smallest:.3g} to {self.largest:.3g} d50"


def size_report(geometry: Geometry, d50: float) -> SizeReport:
    """Compare the elements with the grains. Collective.

    Args:
        geometry: the body.
        d50: mean grain diameter (m).
    """
    sizes = np.concatenate(geometry.mesh.comm.allgather(geometry.cell_sizes())) / d50
    smallest, median, largest = float(sizes.min()), float(np.median(sizes)), float(sizes.max())
    warning = error = None
    if median > BAND * (1 + _ROUNDING):
        error = (
            f"elements must be smaller than a shear band, which is about {BAND:g} d50 = {BAND * d50:g} m thick, but "
            f"half of them measure {median:.3g} d50 = {median * d50:.3g} m or more"
        )
    elif largest > RESOLVING * (1 + _ROUNDING):
        warning = (
            f"the largest element measures {largest:.3g} d50 = {largest * d50:.3g} m; above {RESOLVING:g} d50 a shear "
            "band, where it forms there, is resolved poorly"
        )
    return SizeReport(smallest, median, largest, warning, error)
