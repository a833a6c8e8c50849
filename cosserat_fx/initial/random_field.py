"""A stationary Gaussian random field in the plane that is a function of position alone."""

from __future__ import annotations

from math import pi

import numpy as np

from cosserat_fx.typing import Array

MODES = 1024
"""Plane waves that are superposed."""
_BLOCK = 4096
"""Points that are evaluated together, which bounds the memory to some tens of megabytes."""


class RandomField:
    """A Gaussian field of zero mean and given standard deviation s, correlated over the correlation length l.

    Two points at a distance r have the covariance s^2 exp(-(r/l)^2). The field is a sum of M plane waves,

        f(x) = s sqrt(1/M) sum_m R_m cos(k_m . x + p_m),

    whose wave vectors are distributed as the spectral density of this covariance, a normal distribution of variance
    2/l^2 in each direction: |k| = (2/l) sqrt(-ln(1 - U)) with U uniform in (0, 1), in any direction (Shinozuka and
    Deodatis, Appl. Mech. Rev. 44 (1991), 191-204). R_m has the Rayleigh distribution and p_m is uniform, so that, the
    wave vectors given, f is exactly Gaussian. U and the direction are stratified (one in each of M equal parts), which
    brings the covariance of each set of wave vectors close to that of all of them.

    The numbers are made from the raw 64-bit output of PCG64, which NumPy guarantees not to change: one seed is one
    field on every mesh, machine and number of ranks.
    """

    def __init__(self, standard_deviation: float, correlation_length: float, seed: int) -> None:
        """Draw the waves.

        Args:
            standard_deviation: s.
            correlation_length: l (m).
            seed: a non-negative integer.
        """
        raw = np.random.PCG64(seed).random_raw(5 * MODES).reshape(5, MODES)
        radial, angular, order, size, phase = (raw >> np.uint64(11)) * 2.0**-53  # in [0, 1)
        strata = np.arange(MODES)
        length = 2.0 / correlation_length * np.sqrt(-np.log1p(-(strata + radial) / MODES))
        angle = pi * (np.argsort(order, kind="stable") + angular) / MODES  # k and -k are the same wave
        self._waves: Array = length * np.stack([np.cos(angle), np.sin(angle)])
        self._amplitudes: Array = standard_deviation * np.sqrt(-2.0 * np.log1p(-size) / MODES)
        self._phases: Array = 2.0 * pi * phase

    def __call__(self, points: Array) -> Array:
        """Values at points.

        Args:
            points: (m, 2) coordinates (m).

        Returns:
            (m,) values.
        """
        values = np.empty(len(points))
        for start in range(0, len(points), _BLOCK):
            block = slice(start, start + _BLOCK)
            values[block] = np.cos(points[block] @ self._waves + self._phases) @ self._amplitudes
        return values
