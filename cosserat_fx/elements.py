"""Finite elements that a plane body can be made of, by name.

Displacement and rotation are continuous; one quadrature rule serves stresses, tangent and weak form. What each element
is good for was measured, see docs/elements.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cosserat_fx.material import AdmissibilityError

ElementName = Literal["Q1R", "Q1", "Q2Q1", "P1", "P2P1"]
Cell = Literal["interval", "quadrilateral", "triangle"]


@dataclass(frozen=True)
class Element:
    """A pair of spaces with its quadrature.

    Attributes:
        name: what scenes call it.
        cell: shape of its cells.
        order: polynomial degree of the displacement; the rotation is linear.
        degree: of the quadrature rule.
        stabilised: whether the rule misses a mode of deformation.
        words: what it is.
    """

    name: ElementName
    cell: Cell
    order: int
    degree: int
    stabilised: bool
    words: str


ELEMENTS: dict[str, Element] = {
    e.name: e
    for e in (
        Element(
            "Q1R", "quadrilateral", 1, 1, True, "linear displacement and rotation, one point, hourglass resistance"
        ),
        Element("Q1", "quadrilateral", 1, 3, False, "linear displacement and rotation, 2 x 2 points"),
        Element("Q2Q1", "quadrilateral", 2, 5, False, "quadratic displacement, linear rotation, 3 x 3 points"),
        Element("P1", "triangle", 1, 1, False, "linear displacement and rotation, one point"),
        Element("P2P1", "triangle", 2, 2, False, "quadratic displacement, linear rotation, 3 points"),
    )
}
DEFAULT: dict[str, ElementName] = {"quadrilateral": "Q1R", "triangle": "P2P1"}


def choose(name: str, cell: str) -> Element:
    """The element of a name, or the default one of a mesh for the name "auto".

    Raises:
        AdmissibilityError: the element has other cells than the mesh.
    """
    element = ELEMENTS[DEFAULT[cell] if name == "auto" else name]
    if element.cell != cell:
        fitting = ", ".join(f'"{e.name}"' for e in ELEMENTS.values() if e.cell == cell)
        raise AdmissibilityError("solver.element", name, f'must be {fitting} or "auto" on a mesh of {cell}s')
    return element
