"""Exponential and logarithm without branches, so that loops over lanes that call them become vector instructions.

A compiler turns a loop into vector instructions only where it sees all that happens in it: a call into the system's
mathematical library stops it, and Intel's vector library does not load with numba's wheels. Both functions are within
two units of the last place of the exact value (tests/test_elementary.py).
"""

from __future__ import annotations

from math import factorial

import numpy as np

from cosserat_fx.compiled import inline

_TO_INTEGER = 1.5 * 2.0**52
"""Added to a number, it leaves the nearest integer in the last bits of the sum."""
_MANTISSA_BITS = 52
_LOG2_E = 1.4426950408889634
# ln 2 in two parts, the first with so few digits that its products with exponents are exact.
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_SMALLEST, _LARGEST = -708.0, 709.0
_SQRT_HALF_BITS = int(np.sqrt(0.5).view(np.int64))
_TAYLOR = tuple(1.0 / factorial(k) for k in range(14))


@inline
def exponential(x: float) -> float:
    """The exponential of x, which is brought into the range where neither overflow nor underflow happens."""
    x = min(max(x, _SMALLEST), _LARGEST)
    shifted = x * _LOG2_E + _TO_INTEGER
    k = shifted - _TO_INTEGER
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    p = _TAYLOR[13]
    p = p * r + _TAYLOR[12]
    p = p * r + _TAYLOR[11]
    p = p * r + _TAYLOR[10]
    p = p * r + _TAYLOR[9]
    p = p * r + _TAYLOR[8]
    p = p * r + _TAYLOR[7]
    p = p * r + _TAYLOR[6]
    p = p * r + _TAYLOR[5]
    p = p * r + _TAYLOR[4]
    p = p * r + _TAYLOR[3]
    p = p * r + _TAYLOR[2]
    p = p * r * r + r + 1.0
    bits = np.float64(p).view(np.int64) + (np.float64(shifted).view(np.int64) << _MANTISSA_BITS)
    return np.int64(bits).view(np.float64)


@inline
def logarithm(x: float) -> float:
    """Natural logarithm of a positive normal number."""
    bits = np.float64(x).view(np.int64)
    exponent = (bits - _SQRT_HALF_BITS) >> _MANTISSA_BITS
    mantissa = np.int64(bits - (exponent << _MANTISSA_BITS)).view(np.float64)  # from sqrt(1/2) to sqrt(2)
    f = (mantissa - 1.0) / (mantissa + 1.0)
    s = f * f
    p = 2.0 / 21.0
    p = p * s + 2.0 / 19.0
    p = p * s + 2.0 / 17.0
    p = p * s + 2.0 / 15.0
    p = p * s + 2.0 / 13.0
    p = p * s + 2.0 / 11.0
    p = p * s + 2.0 / 9.0
    p = p * s + 2.0 / 7.0
    p = p * s + 2.0 / 5.0
    p = p * s + 2.0 / 3.0
    k = float(exponent)
    return k * _LN2_HIGH + (k * _LN2_LOW + (2.0 * f + f * s * p))
