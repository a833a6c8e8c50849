"""The tables of a scene of a plane-strain body: rectangle or mesh, conditions on its boundaries and points, output.

x1 points to the right, x2 up, the rotation w turns about x3. Units are SI and stresses are positive in tension; a
pressure is positive in compression.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, Self

from annotated_types import Ge, Le
from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, create_model, model_validator
from pydantic_core import InitErrorDetails

from cosserat_fx.elements import ElementName
from cosserat_fx.material import AdmissibilityError
from cosserat_fx.scenes.histories import (
    CoupleHistory,
    DisplacementHistory,
    PressureHistory,
    RotationHistory,
    TractionHistory,
)
from cosserat_fx.scenes.registry import registered
from cosserat_fx.scenes.schema import (
    MAX_CELLS,
    MAX_LIST,
    Displacements,
    File,
    Length,
    Output,
    Position,
    Solver,
    Table,
    Unit,
    WallLaw,
    list_as_tuple,
)

RECTANGLE_BOUNDARIES: Final = {"bottom": "u2", "top": "u2", "left": "u1", "right": "u1"}
"""The boundaries of a rectangle, with the displacement that is normal to each."""

Cells = Annotated[int, Ge(1), Le(MAX_CELLS)]
Ratio = Annotated[float, Ge(1)]


class HorizontalGrading(Table):
    """Widths of cells that differ, in a geometric sequence."""

    fine: Literal["left", "right", "centre", "ends"]
    """Where the narrow cells are."""
    ratio: Ratio
    """Largest width over smallest."""


class VerticalGrading(Table):
    """Heights of cells that differ, in a geometric sequence."""

    fine: Literal["bottom", "top", "centre", "ends"]
    """Where the low cells are."""
    ratio: Ratio
    """Largest height over smallest."""


class Grading(Table):
    """How cell sizes differ over a rectangle."""

    x: HorizontalGrading | None = None
    """Along x1; without it all cells are of one width."""
    y: VerticalGrading | None = None
    """Along x2; without it all cells are of one height."""


class RectangleGeometry(Table):
    """A rectangle with the origin at its lower left corner and the boundaries bottom, top, left and right."""

    kind: Literal["rectangle"]
    width: Length = Field(gt=0)
    """Width of the undeformed rectangle, m."""
    height: Length = Field(gt=0)
    """Height of the undeformed rectangle, m."""
    cells: Annotated[tuple[Cells, Cells], BeforeValidator(list_as_tuple)]
    """Number of quadrilaterals along x1 and x2."""
    grading: Grading = Grading()

    @model_validator(mode="after")
    def _check_number_of_cells(self) -> Self:
        if self.cells[0] * self.cells[1] > MAX_CELLS:
            raise AdmissibilityError("cells", self.cells, f"must make at most {MAX_CELLS} cells in all")
        return self


class MeshGeometry(Table):
    """A mesh from a file; its named groups are the boundaries and regions."""

    kind: Literal["mesh"]
    file: File
    """Gmsh file or any other that meshio reads, relative to the scene's folder."""
    scale: Annotated[float, Unit("m per unit of the file")] = Field(default=1.0, gt=0)
    """Length of the file's unit, m."""


class BoundaryWall(WallLaw):
    """A rough wall along a boundary, which moves as a rigid body without turning."""

    u1: DisplacementHistory = 0.0
    """Displacement of the wall along x1, m."""
    u2: DisplacementHistory = 0.0
    """Displacement of the wall along x2, m."""
    pressure: PressureHistory | None = None
    """Pressure, Pa, under which the displacement normal to the wall is free."""
    free: bool = False
    """Whether the displacement along the wall is free, and the particles roll with their own."""


class Boundary(Table):
    """What happens on a named boundary; where nothing is given it is free of traction.

    Beside these keys it takes those that `cosserat_fx.extensions` was told of.
    """

    model_config = ConfigDict(extra="allow")  # what is let in decides _validate_extensions

    u1: DisplacementHistory | None = None
    """Prescribed displacement along x1, m."""
    u2: DisplacementHistory | None = None
    """Prescribed displacement along x2, m."""
    w: RotationHistory | None = None
    """Prescribed rotation of the grains, rad, from x1 to x2."""
    t1: TractionHistory | None = None
    """Dead traction along x1 per reference area, Pa."""
    t2: TractionHistory | None = None
    """Dead traction along x2 per reference area, Pa."""
    couple: CoupleHistory | None = None
    """Couple traction per reference area, N/m."""
    pressure: PressureHistory | None = None
    """Pressure normal to the deformed boundary, Pa, compression positive."""
    symmetry: bool = False
    """Whether the boundary is a plane of symmetry: no normal displacement, no rotation."""
    rotational_resistance: Annotated[float, Unit("N/m per rad")] | None = Field(default=None, ge=0)
    """Stiffness c of a couple traction -c w, N/m per rad."""
    wall: BoundaryWall | None = None
    """A rough wall."""

    @property
    def extensions(self) -> Mapping[str, Table]:
        """Tables of the keys that were registered, by key."""
        return self.model_extra or {}

    @classmethod
    def known_keys(cls) -> dict[str, Any]:
        """Returns the annotation of each key, those registered included."""
        return super().known_keys() | dict(registered())

    @model_validator(mode="before")
    @classmethod
    def _validate_extensions(cls, table: object) -> object:
        """Validates the registered keys and refuses the unknown ones."""
        if not isinstance(table, dict):
            return table
        extras = {key: value for key, value in table.items() if key not in cls.model_fields}
        if not extras:
            return table
        unknown = [
            InitErrorDetails(type="extra_forbidden", loc=(key,), input=value)
            for key, value in extras.items()
            if key not in registered()
        ]
        if unknown:
            raise ValidationError.from_exception_data(cls.__name__, unknown)
        types: dict[str, Any] = {key: (registered()[key], ...) for key in extras}
        known = create_model("Extensions", __base__=Table, **types).model_validate(extras)
        return table | {key: getattr(known, key) for key in extras}

    @model_validator(mode="after")
    def _check_one_condition_each(self) -> Self:
        for key, others, reason in _CONTRADICTIONS:
            value = getattr(self, key)
            given = [other for other in others or type(self).model_fields if other != key and self._gives(other)]
            if self._gives(key) and given:
                raise AdmissibilityError(key, value, f"must be left out where {' and '.join(given)} is given, {reason}")
        if self._gives("pressure") and self.u1 is not None and self.u2 is not None:
            allowed = "must be left out where u1 and u2 are given, as nothing is left for it to move"
            raise AdmissibilityError("pressure", self.pressure, allowed)
        return self

    def _gives(self, key: str) -> bool:
        return all(getattr(self, key) is not nothing for nothing in (None, False))


_EVERYTHING: Final[tuple[str, ...]] = ()
_CONTRADICTIONS: Final = (
    ("wall", _EVERYTHING, "as a wall says all there is to say about its boundary"),
    ("symmetry", _EVERYTHING, "as symmetry says all there is to say about its boundary"),
    ("t1", ("u1",), "as a boundary has a displacement or a traction in each direction"),
    ("t2", ("u2",), "as a boundary has a displacement or a traction in each direction"),
    ("pressure", ("t1", "t2"), "as both load the boundary"),
    ("couple", ("w",), "as a boundary has a rotation or a couple"),
    ("rotational_resistance", ("w",), "as a boundary has a rotation or a couple"),
)


class Point(Table):
    """What is prescribed at the node nearest to a place."""

    at: Position
    """Coordinates in the undeformed body, m."""
    u1: DisplacementHistory | None = None
    """Prescribed displacement along x1, m."""
    u2: DisplacementHistory | None = None
    """Prescribed displacement along x2, m."""
    w: RotationHistory | None = None
    """Prescribed rotation of the grains, rad."""

    @model_validator(mode="after")
    def _check_something_is_prescribed(self) -> Self:
        if self.u1 is None and self.u2 is None and self.w is None:
            raise AdmissibilityError("u1", None, "must be given unless u2 or w is, or the point does nothing")
        return self


class PlaneSolver(Solver):
    """Elements and solution of the equations."""

    element: Literal["auto", ElementName] = "auto"
    """Element of displacement and rotation."""
    hourglass: float = Field(default=0.005, ge=0)
    """Factor of the stiffness that holds the hourglass modes of one-point elements."""


class Column(Table):
    """A column of the history that the user wants."""

    boundary: str
    """Name of the boundary."""
    quantity: Literal["force1", "force2", "couple", "u1", "u2", "w"]
    """Force (N per m of thickness), couple (N) on the body there, or mean displacement (m) or rotation (rad)."""
    factor: float = 1.0
    """What the quantity is multiplied by."""


class PlaneOutput(Output):
    """What the run of a plane body writes."""

    fields_at: Displacements | None = None
    """Travels at which fields are written, ascending, m."""
    frames: int = Field(default=40, ge=0, le=MAX_LIST)
    """About so many snapshots, evenly over the path, for ParaView and the animation."""
    animation: bool = True
    """Whether to draw an animation."""
    columns: dict[str, Column] = Field(default_factory=dict)
    """Additional columns of the history, in this order."""
