"""The rate law of the theory page in full 3 x 3 tensors, written from that page alone to judge the compiled kernel.

Every function takes leading batch dimensions and, but for `integrate`, complex numbers (derivatives by complex step).
Nothing is shared with the package but the ten constants of a `Material`. SI units, tension positive, the second index
of a strain or curvature is the derivative.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import radians, sin, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from cosserat_fx.material import Material

Tensor = npt.NDArray[Any]
"""Real or complex, (..., 3, 3) or, for scalars, (...)."""

UNIT = np.eye(3)
GAMMA = 1 - 1 / sqrt(2)


@dataclass(frozen=True)
class Increment:
    """Increments, or rates, of strain, curvature (1/m) and spin."""

    strain: Tensor
    curvature: Tensor
    spin: Tensor


@dataclass(frozen=True)
class State:
    """Stress (Pa), couple stress (N/m) and void ratio, or their rates."""

    stress: Tensor
    couple: Tensor
    void_ratio: Tensor


def trace(tensor: Tensor) -> Tensor:
    return np.asarray(np.trace(tensor, axis1=-2, axis2=-1))


def contract(first: Tensor, second: Tensor) -> Tensor:
    return np.asarray(np.sum(first * second, axis=(-2, -1)))


def scaled(factor: Tensor, tensor: Tensor) -> Tensor:
    return np.asarray(np.asarray(factor)[..., None, None] * tensor)


def characteristic_void_ratios(stress_trace: Tensor, c: Material) -> tuple[Tensor, Tensor, Tensor]:
    """e_i, e_c, e_d."""
    shrink = np.exp(-((-stress_trace / c.h_s) ** c.n))
    return c.e_i0 * shrink, c.e_c0 * shrink, c.e_d0 * shrink


def critical_factor(s: Tensor, c: Material) -> Tensor:
    """a(s) of the normalised stress s = sigma/sigma_kk."""
    deviator = s - UNIT / 3
    symmetric = (deviator + np.swapaxes(deviator, -1, -2)) / 2
    square = symmetric @ symmetric
    j2, j3 = trace(square), contract(square, symmetric)
    ratio = np.where(j2 == 0, 0, j3 / np.where(j2 == 0, 1, j2))
    sine = sin(radians(c.phi_c))
    return np.asarray(sine / (3 - sine) * (np.sqrt((8 / 3 - 3 * (j2 + j3)) / (1 - 3 * ratio)) - np.sqrt(j2)))


def barotropy(stress_trace: Tensor, c: Material) -> Tensor:
    """f_b (Pa)."""
    e_i, _, _ = characteristic_void_ratios(stress_trace, c)
    sine = sin(radians(c.phi_c))
    a_0 = sqrt(8 / 3) * sine / (3 - sine)
    h_i = a_0**2 + 1 / 3 - ((c.e_i0 - c.e_d0) / (c.e_c0 - c.e_d0)) ** c.alpha * a_0 / sqrt(3)
    return np.asarray(c.h_s / (c.n * h_i) * (1 + e_i) / e_i * (-stress_trace / c.h_s) ** (1 - c.n))


def factors(stress_trace: Tensor, void_ratio: Tensor, c: Material) -> tuple[Tensor, Tensor]:
    """f_s (Pa) and f_d."""
    e_i, e_c, e_d = characteristic_void_ratios(stress_trace, c)
    f_s = (e_i / void_ratio) ** c.beta * barotropy(stress_trace, c)
    return f_s, ((void_ratio - e_d) / (e_c - e_d)) ** c.alpha


def rate(state: State, speed: Increment, c: Material) -> State:
    """Rates of stress, couple stress and void ratio under the rates of strain, curvature and spin."""
    sigma_kk = trace(state.stress)
    s, m = scaled(1 / sigma_kk, state.stress), scaled(1 / (c.d50 * sigma_kk), state.couple)
    d, k, w = speed.strain, c.d50 * speed.curvature, speed.spin
    f_s, f_d = factors(sigma_kk, state.void_ratio, c)
    a = critical_factor(s, c)
    norm = np.sqrt(contract(d, d) + contract(k, k))
    power = contract(s, d) + contract(m, k)
    stress = scaled(a**2, d) + scaled(power, s) + scaled(f_d * a * norm, s + s - UNIT / 3)
    couple = c.a_c**2 * k + scaled(power + 2 * f_d * c.a_c * norm, m)
    return State(
        stress=scaled(f_s, stress) + w @ state.stress - state.stress @ w,
        couple=scaled(f_s * c.d50, couple) + w @ state.couple - state.couple @ w,
        void_ratio=(1 + state.void_ratio) * trace(d),
    )


def integrate(state: State, increment: Increment, c: Material, *, evolving: bool = True) -> State:
    """One state carried over an increment applied at a constant rate, to ten digits.

    Args:
        state: start, without batch dimensions.
        increment: likewise.
        c: the constants.
        evolving: whether the void ratio evolves.

    Raises:
        ArithmeticError: the law has no solution over the whole increment.
    """
    pressure = -float(trace(state.stress)) / 3
    scale = np.r_[np.full(9, pressure), np.full(9, pressure * c.d50), 1.0]

    def pack(y: State) -> Tensor:
        return np.asarray(np.concatenate([y.stress.ravel(), y.couple.ravel(), [y.void_ratio]]) / scale)

    def unpack(x: Tensor) -> State:
        y = x * scale
        return State(y[:9].reshape(3, 3), y[9:18].reshape(3, 3), y[18])

    def slope(_: float, x: Tensor) -> Tensor:
        packed = pack(rate(unpack(x), increment, c))
        packed[18] *= evolving
        return packed

    with np.errstate(invalid="raise", over="raise"):
        solution = solve_ivp(slope, (0, 1), pack(state), method="Radau", rtol=1e-10, atol=1e-12)
    if not solution.success:
        raise ArithmeticError(solution.message)
    return unpack(solution.y[:, -1])


def discrete(
    state: State, increment: Increment, c: Material, *, substeps: int, evolving: bool = True, like: Tensor | None = None
) -> tuple[State, Tensor]:
    """A batch of states carried over increments by the kernel's scheme, the stages solved by Newton's method.

    Two-stage SDIRK, substeps that end at (k/K)^2, the void ratio in closed form.

    Args:
        state: (m, ...) start.
        increment: (m, ...) increment; imaginary parts, below 1e-40, give the derivatives of the result.
        c: the constants.
        substeps: their number K.
        evolving: whether the void ratio evolves.
        like: stages of the same increment's real part, as returned, to start Newton's method from.

    Returns:
        The end and the stages (K, 2, m, 18), stresses and couple stresses over d50 (Pa); NaN where the stages have no
        solution or none was found.
    """
    volume = trace(increment.strain)
    m = len(volume)

    def tensors(x: Tensor, time: float) -> State:
        void_ratio = (1 + state.void_ratio) * np.exp(evolving * time * volume) - 1
        shape = (*x.shape[:-1], 3, 3)
        return State(x[..., :9].reshape(shape), c.d50 * x[..., 9:].reshape(shape), void_ratio)

    def slope(x: Tensor, time: float) -> Tensor:
        y = rate(tensors(x, time), increment, c)
        shape = (*x.shape[:-1], 9)
        return np.concatenate([y.stress.reshape(shape), y.couple.reshape(shape) / c.d50], axis=-1)

    def stage(base: Tensor, guess: Tensor, time: float, h: float) -> Tensor:
        return _newton(lambda x: x - base - GAMMA * h * slope(x, time), guess)

    y = np.concatenate([state.stress.reshape(m, 9), state.couple.reshape(m, 9) / c.d50], axis=1)
    stages = []
    for step in range(substeps):
        begin = (step / substeps) ** 2
        h = ((step + 1) / substeps) ** 2 - begin
        first = stage(y, y if like is None else like[step, 0], begin + GAMMA * h, h)
        base = y + (1 - GAMMA) / GAMMA * (first - y)
        y = stage(base, first if like is None else like[step, 1], begin + h, h)
        stages.append(np.stack([first, y]))
    return tensors(y, 1.0), np.stack(stages)


def _newton(residual: Callable[[Tensor], Tensor], guess: Tensor) -> Tensor:
    """Zeros (m, 18) of a residual by Newton's method, with corrections halved where they leave the law's domain."""
    x = guess
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        r = residual(x)
        for _ in range(40):
            # A perturbation far above that of a complex increment and far below any rounding.
            size = np.abs(np.real(x[:, 0] + x[:, 4] + x[:, 8]))
            perturbed = np.real(x) + 1e-30j * size[:, None] * np.eye(18)[:, None, :]
            jacobian = np.moveaxis(np.imag(residual(perturbed)) / (1e-30 * size[:, None]), 0, -1)
            stuck = ~np.isfinite(jacobian).all(axis=(1, 2)) | (np.linalg.slogdet(jacobian)[0] == 0)
            jacobian[stuck], r[stuck] = np.eye(18), np.nan
            correction = np.linalg.solve(jacobian, r[..., None])[..., 0]
            share = np.ones((len(x), 1))
            for _ in range(12):
                r = residual(x - share * correction)
                outside = ~np.isfinite(r).all(axis=1) & ~stuck
                if not outside.any():
                    break
                share[outside] /= 2
            x = x - share * correction
            done = np.abs(correction).max(axis=1) < 1e-9 * size
            if np.all(done | stuck):
                break
    return np.where(done[:, None], x, np.nan)
