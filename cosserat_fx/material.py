"""The constants of the hypoplastic Cosserat law: admissible values, named sets and what follows from them alone.

Units are SI. Pressures are positive in compression here (p = -sigma_kk/3); stresses elsewhere are positive in tension.
"The paper" is *Interface behavior between a granular body and a rough wall under shearing*; its equations are quoted by
number. What it leaves open (the sign under the power of equation 6, the factor f_b) is derived in the theory page.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from difflib import get_close_matches
from numbers import Real
from types import MappingProxyType
from typing import Final, NamedTuple, Self

import numpy as np

from cosserat_fx.typing import Array


class AdmissibilityError(ValueError):
    """A value that is not allowed.

    Attributes:
        key: name of the offending input.
        value: what was given.
        allowed: what is allowed instead ("must be ...").
    """

    def __init__(self, key: str, value: object, allowed: str) -> None:
        """Keeps the three parts of the message."""
        super().__init__(key, value, allowed)
        self.key = key
        self.value = value
        self.allowed = allowed

    def __str__(self) -> str:
        """Returns the message, "key = value: allowed"."""
        return f"{self.key} = {self.value!r}: {self.allowed}"


class MaterialError(AdmissibilityError):
    """A material constant outside its admissible range, or a material that does not exist."""


class CharacteristicVoidRatios[Number: (float, Array)](NamedTuple):
    """Void ratios bounding and steering the law at a given pressure (paper, equation 6), dimensionless.

    All three have the shape of the pressure they were asked for.
    """

    e_i: Number
    """Maximum void ratio, of the loosest grain skeleton."""
    e_c: Number
    """Critical void ratio, reached under large shearing."""
    e_d: Number
    """Minimum void ratio, of the densest packing."""


class KernelConstants(NamedTuple):
    """What the compiled constitutive kernel needs: a named tuple of floats, which numba takes as a typed argument."""

    e_i0: float
    """Maximum void ratio at zero pressure."""
    e_d0: float
    """Minimum void ratio at zero pressure."""
    e_c0: float
    """Critical void ratio at zero pressure."""
    c_phi: float
    """Factor sin(phi_c)/(3 - sin(phi_c)) of equation 7."""
    h_s: float
    """Solid hardness, Pa."""
    alpha: float
    """Pyknotropy exponent of f_d."""
    beta: float
    """Pyknotropy exponent of f_s."""
    n: float
    """Compression exponent."""
    d50: float
    """Mean grain diameter, m."""
    a_c: float
    """Rotation resistance."""
    h_i: float
    """Bracket in the denominator of f_b."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """The ten constants of the hypoplastic Cosserat law.

    Integers are taken and kept as floats. An instance that exists is admissible.

    Raises:
        MaterialError: a constant is not a finite number or outside the range stated with it, or the bracket `h_i` is
            not positive (which bounds alpha from above).
    """

    e_i0: float
    """Maximum void ratio at zero pressure, dimensionless; e_i0 > e_c0."""
    e_d0: float
    """Minimum void ratio at zero pressure, dimensionless; 0 < e_d0 < e_c0."""
    e_c0: float
    """Critical void ratio at zero pressure, dimensionless; e_d0 < e_c0 < e_i0."""
    phi_c: float
    """Critical friction angle, degrees; 0 < phi_c < 90."""
    h_s: float
    """Solid (granular) hardness, the reference pressure of compression, Pa; h_s > 0."""
    alpha: float
    """Pyknotropy exponent of f_d, which sets peak friction and dilatancy, dimensionless; alpha > 0 and h_i > 0."""
    beta: float
    """Pyknotropy exponent of f_s, which sets the stiffness of dense states, dimensionless; beta >= 0."""
    n: float
    """Exponent of compression, dimensionless; 0 < n < 1."""
    d50: float
    """Mean grain diameter, the internal length of the law, m; d50 > 0."""
    a_c: float
    """Resistance of the grains to rotation, dimensionless; a_c > 0."""

    def __post_init__(self) -> None:
        """Takes every constant as a float and checks it."""
        for field in fields(self):
            object.__setattr__(self, field.name, _finite(field.name, getattr(self, field.name)))
        conditions = {
            "e_d0": (0 < self.e_d0 < self.e_c0, f"must be greater than 0 and less than e_c0 = {self.e_c0:g}"),
            "e_c0": (self.e_c0 < self.e_i0, f"must be less than e_i0 = {self.e_i0:g}"),
            "phi_c": (0 < self.phi_c < 90, "must be greater than 0 and less than 90 (degrees)"),
            "h_s": (self.h_s > 0, "must be greater than 0 (Pa)"),
            "alpha": (self.alpha > 0, "must be greater than 0"),
            "beta": (self.beta >= 0, "must be at least 0"),
            "n": (0 < self.n < 1, "must be greater than 0 and less than 1"),
            "d50": (self.d50 > 0, "must be greater than 0 (m)"),
            "a_c": (self.a_c > 0, "must be greater than 0"),
        }
        for key, (holds, allowed) in conditions.items():
            if not holds:
                raise MaterialError(key, getattr(self, key), allowed)
        if not self.h_i > 0:
            allowed = f"must be less than {self._alpha_limit:g}, or the bracket h_i = {self.h_i:g} is not positive"
            raise MaterialError("alpha", self.alpha, allowed)

    @classmethod
    def named(cls, name: str, **overrides: float) -> Self:
        """Returns a set of `NAMED_SETS`, with any of its constants replaced.

        Args:
            name: key of `NAMED_SETS`.
            overrides: constants by name, in the units of the fields.

        Raises:
            MaterialError: there is no such set, or the resulting constants are not admissible.
            TypeError: an override is not the name of a constant.
        """
        if not isinstance(name, str) or name not in NAMED_SETS:
            allowed = "must be one of " + ", ".join(f'"{known}"' for known in NAMED_SETS)
            nearest = get_close_matches(str(name), NAMED_SETS, n=1)
            raise MaterialError("constants", name, allowed + "".join(f' (did you mean "{it}"?)' for it in nearest))
        return cls(**{field.name: getattr(NAMED_SETS[name], field.name) for field in fields(cls)} | overrides)

    @property
    def c_phi(self) -> float:
        """Factor sin(phi_c)/(3 - sin(phi_c)) in front of equation 7, dimensionless."""
        sine = math.sin(math.radians(self.phi_c))
        return sine / (3 - sine)

    @property
    def a_isotropic(self) -> float:
        """Value a_0 = sqrt(8/3) sin(phi_c)/(3 - sin(phi_c)) of the factor a (equation 7) at isotropic stress."""
        return math.sqrt(8 / 3) * self.c_phi

    @property
    def h_i(self) -> float:
        """Bracket in the denominator of f_b, dimensionless.

        h_i = a_0^2 + 1/3 - ((e_i0 - e_d0)/(e_c0 - e_d0))^alpha a_0/sqrt(3), from the condition that isotropic
        compression starting at e = e_i stays at e = e_i. The stiffness factor f_s is positive only where h_i is.
        """
        a_0 = self.a_isotropic
        try:
            density_factor = math.pow(self._loosest_density_ratio, self.alpha)
        except OverflowError:
            density_factor = math.inf
        return a_0**2 + 1 / 3 - density_factor * a_0 / math.sqrt(3)

    @property
    def _loosest_density_ratio(self) -> float:
        """Ratio (e_i0 - e_d0)/(e_c0 - e_d0) > 1, the base of f_d at e = e_i whatever the pressure."""
        return (self.e_i0 - self.e_d0) / (self.e_c0 - self.e_d0)

    @property
    def _alpha_limit(self) -> float:
        """The alpha at which h_i vanishes."""
        a_0 = self.a_isotropic
        return math.log((a_0**2 + 1 / 3) * math.sqrt(3) / a_0) / math.log(self._loosest_density_ratio)

    def characteristic_void_ratios[Number: (float, Array)](
        self, mean_pressure: Number
    ) -> CharacteristicVoidRatios[Number]:
        """Returns the void ratios e_i, e_c and e_d at a pressure (paper, equation 6).

        e_i/e_i0 = e_c/e_c0 = e_d/e_d0 = exp(-x) with x = (3 p/h_s)^n.

        Args:
            mean_pressure: p = -sigma_kk/3 >= 0, Pa, a number or an array of any shape.

        Raises:
            MaterialError: a pressure is negative or not a number.
        """
        if not np.all(np.greater_equal(mean_pressure, 0)):
            raise MaterialError("mean_pressure", mean_pressure, "must be at least 0 (Pa, compression positive)")
        reduction = np.exp(-((3 * mean_pressure / self.h_s) ** self.n))
        return CharacteristicVoidRatios(self.e_i0 * reduction, self.e_c0 * reduction, self.e_d0 * reduction)

    def stiffness_factor[Number: (float, Array)](self, mean_pressure: Number, void_ratio: Number) -> Number:
        """Returns the factor f_s = (e_i/e)^beta f_b of the rate law, Pa.

        Args:
            mean_pressure: p > 0, Pa, a number or an array.
            void_ratio: e > 0, a number or an array.
        """
        e_i = self.characteristic_void_ratios(mean_pressure).e_i
        f_b = self.h_s / (self.n * self.h_i) * (1 + e_i) / e_i * (3 * mean_pressure / self.h_s) ** (1 - self.n)
        f_s: Number = (e_i / void_ratio) ** self.beta * f_b
        return f_s

    def shear_stiffness(self, mean_pressure: float, void_ratio: Array) -> Array:
        """Returns the stiffness ds12/d(eps12) = f_s a_0^2 of the law's linear part in an isotropic state, Pa."""
        return self.stiffness_factor(np.full_like(void_ratio, mean_pressure), void_ratio) * self.a_isotropic**2

    @property
    def couple_over_shear_stiffness(self) -> float:
        """Stiffness of the couple stress, f_s a_c^2 d50^2, over the shear stiffness in an isotropic state, m2."""
        return (self.a_c * self.d50 / self.a_isotropic) ** 2

    def kernel_parameters(self) -> KernelConstants:
        """Returns the constants in the form in which the compiled kernel takes them."""
        return KernelConstants(
            e_i0=self.e_i0,
            e_d0=self.e_d0,
            e_c0=self.e_c0,
            c_phi=self.c_phi,
            h_s=self.h_s,
            alpha=self.alpha,
            beta=self.beta,
            n=self.n,
            d50=self.d50,
            a_c=self.a_c,
            h_i=self.h_i,
        )


def _finite(key: str, value: object) -> float:
    """Returns a number as a finite float; a truth value is not a number."""
    try:
        if isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    except OverflowError:  # an integer beyond the largest float
        pass
    raise MaterialError(key, value, "must be a finite number")


NAMED_SETS: Final[Mapping[str, Material]] = MappingProxyType(
    {
        "paper-sand": Material(
            e_i0=1.2,
            e_d0=0.51,
            e_c0=0.82,
            phi_c=30.0,
            h_s=190e6,
            alpha=0.11,
            beta=1.05,
            n=0.4,
            d50=0.5e-3,
            a_c=1.0,
        )
    }
)
"""Materials by name. "paper-sand" is the medium sand of the paper's simulations, as printed below its equation 7."""
