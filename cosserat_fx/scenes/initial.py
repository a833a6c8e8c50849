"""The table of the initial state: stress, void ratio, and how the void ratio differs from place to place."""

from math import hypot
from typing import Annotated, Final, Self

from annotated_types import MaxLen
from pydantic import BeforeValidator, Field, model_validator

from cosserat_fx.material import AdmissibilityError, Material
from cosserat_fx.scenes.schema import File, Length, Position, Stress, Table, list_as_tuple

MAX_ZONES: Final = 10_000
"""Number of zones that a scene may have."""

_SHAPES: Final = "x and/or y, centre with radius, or region"


class Zone(Table):
    """A part of the body with a void ratio of its own; of zones that overlap the last one wins.

    It is a rectangle (`x`, `y` or both), a circle (`centre` and `radius`), or a named region of a mesh.
    """

    x: Position | None = None
    """First and last x1, m; without it all of them."""
    y: Position | None = None
    """First and last x2, m; without it all of them."""
    centre: Position | None = None
    """Centre of a circle, m."""
    radius: Length | None = Field(default=None, gt=0)
    """Radius of the circle, m."""
    region: str | None = None
    """Name of a group of cells in the mesh file."""
    void_ratio: float = Field(gt=0)
    """Void ratio there, between e_d and e_i at the initial pressure."""

    @model_validator(mode="after")
    def _check_shape(self) -> Self:
        for key, interval in (("x", self.x), ("y", self.y)):
            if interval is not None and not interval[0] < interval[1]:
                raise AdmissibilityError(key, interval, "must be a list of two ascending numbers, or the zone is empty")
        shapes = (("x", "y"), ("centre", "radius"), ("region",))
        given = [key for shape in shapes for key in shape if getattr(self, key) is not None]
        if not given:
            raise AdmissibilityError("", self.model_dump(exclude_none=True), f"must say where: {_SHAPES}")
        shape = next(shape for shape in shapes if given[0] in shape)
        for key in given:
            if key not in shape:
                allowed = f"must be left out where {given[0]} is given: a zone has one shape, {_SHAPES}"
                raise AdmissibilityError(key, getattr(self, key), allowed)
        for key, value, other in (("radius", self.radius, self.centre), ("centre", self.centre, self.radius)):
            if value is None and other is not None:
                raise AdmissibilityError(key, None, "must be given, as a circle has a centre and a radius (m)")
        return self


class RandomField(Table):
    """A Gaussian random field that is added to the void ratio, the same on every mesh."""

    standard_deviation: float = Field(gt=0)
    """Standard deviation of the void ratio."""
    correlation_length_d50: float = Field(gt=0)
    """Correlation length, in mean grain diameters."""
    seed: int = Field(ge=0)
    """Seed; another seed is another realisation."""


class FieldFile(Table):
    """A void ratio that is read from a file."""

    file: File
    """CSV file with the columns x_m, y_m and void_ratio, or mesh file with the data "void_ratio"."""


class Initial(Table):
    """The initial state; couple stresses start at zero."""

    stress: Stress = Field(lt=0)
    """Isotropic stress, Pa, tension positive, hence negative."""
    void_ratio: float = Field(gt=0)
    """Void ratio e_0, between e_d and e_i at the initial pressure; `field` replaces it."""
    zones: Annotated[tuple[Zone, ...], BeforeValidator(list_as_tuple), MaxLen(MAX_ZONES)] = ()
    """Parts with a void ratio of their own; later ones win."""
    random: RandomField | None = None
    """Random field added to the void ratio."""
    field: FieldFile | None = None
    """Void ratio from a file, in place of `void_ratio`."""

    def check_density(self, material: Material) -> None:
        """Refuses void ratios that the law does not know at the initial pressure.

        Raises:
            AdmissibilityError: the void ratio or that of a zone is not between e_d and e_i.
        """
        pressure = -self.stress
        e_i, _, e_d = material.characteristic_void_ratios(pressure)
        given = {"void_ratio": self.void_ratio}
        given |= {f"zones[{index}].void_ratio": zone.void_ratio for index, zone in enumerate(self.zones)}
        for key, value in given.items():
            if not e_d < value < e_i:
                allowed = (
                    f"must be greater than e_d = {e_d:.6g} and less than e_i = {e_i:.6g}, "
                    f"the densest and the loosest state at the initial pressure of {pressure:g} Pa"
                )
                raise AdmissibilityError(f"initial.{key}", value, allowed)

    def check_zones_of_layer(self, height: float) -> None:
        """Refuses zones that are not given by x2 alone, or lie outside a layer.

        Args:
            height: of the layer, m.

        Raises:
            AdmissibilityError: there is such a zone.
        """
        for index, zone in enumerate(self.zones):
            for key in ("x", "centre", "radius", "region"):
                value = getattr(zone, key)
                if value is not None:
                    allowed = "must be left out, as everything in a layer depends on x2 alone: its zones are given by y"
                    raise AdmissibilityError(f"initial.zones[{index}].{key}", value, allowed)
        self._check_within({"y": height})

    def check_zones_of_rectangle(self, width: float, height: float) -> None:
        """Refuses regions, which only meshes have, and zones outside a rectangle.

        Args:
            width, height: of the rectangle, m.

        Raises:
            AdmissibilityError: there is such a zone.
        """
        for index, zone in enumerate(self.zones):
            if zone.region is not None:
                allowed = 'must be left out, as only meshes from files have regions (geometry.kind = "mesh")'
                raise AdmissibilityError(f"initial.zones[{index}].region", zone.region, allowed)
            if zone.centre and zone.radius:
                gaps = [max(-at, 0.0, at - size) for at, size in zip(zone.centre, (width, height), strict=True)]
                if hypot(*gaps) >= zone.radius:
                    allowed = f"must make a circle that reaches into the rectangle, {width:g} by {height:g} m"
                    raise AdmissibilityError(f"initial.zones[{index}].centre", zone.centre, allowed)
        self._check_within({"x": width, "y": height})

    def _check_within(self, sizes: dict[str, float]) -> None:
        """Refuses zones without a point between 0 and the size (m) along each of the axes."""
        for index, zone in enumerate(self.zones):
            for key, size in sizes.items():
                interval = getattr(zone, key)
                if interval is not None and not (interval[0] < size and interval[1] > 0):
                    allowed = f"must reach into the body, which has {key} from 0 to {size:g} m"
                    raise AdmissibilityError(f"initial.zones[{index}].{key}", interval, allowed)
