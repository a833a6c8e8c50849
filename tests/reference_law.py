"""The rate law of the theory page in full 3 x 3 tensors, written from that page alone to judge the compiled kernel.

Every function takes leading batch dimensions and complex numbers (for derivatives by complex step). Nothing is shared
with the package but the ten constants of a `Material`. SI units, tension positive, second index the derivative.
"""

from dataclasses import dataclass
from math import radians, sin, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from cosserat_fx.material import Material

Tensor = npt.NDArray[Any]
"""Real or complex; (..., 3, 3) for tensors and (...) for scalars."""

UNIT = np.eye(3)


@dataclass(frozen=True)
class Increment:
    """Strain, curvature (1/m) and spin increment, each (..., 3, 3)."""

    strain: Tensor
    curvature: Tensor
    spin: Tensor


@dataclass(frozen=True)
class State:
    """Stress (Pa) and couple stress (N/m), each (..., 3, 3), and void ratio (...)."""

    stress: Tensor
    couple: Tensor
    void_ratio: Tensor


def trace(tensor: Tensor) -> Tensor:
    return np.trace(tensor, axis1=-2, axis2=-1)


def contract(first: Tensor, second: Tensor) -> Tensor:
    return np.sum(first * second, axis=(-2, -1))


def _scale(factor: Tensor, tensor: Tensor) -> Tensor:
    return np.asarray(factor)[..., None, None] * tensor


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
    return sine / (3 - sine) * (np.sqrt((8 / 3 - 3 * (j2 + j3)) / (1 - 3 * ratio)) - np.sqrt(j2))


def barotropy(stress_trace: Tensor, c: Material) -> Tensor:
    """f_b (Pa)."""
    e_i, _, _ = characteristic_void_ratios(stress_trace, c)
    sine = sin(radians(c.phi_c))
    a_0 = sqrt(8 / 3) * sine / (3 - sine)
    h_i = a_0**2 + 1 / 3 - ((c.e_i0 - c.e_d0) / (c.e_c0 - c.e_d0)) ** c.alpha * a_0 / sqrt(3)
    return c.h_s / (c.n * h_i) * (1 + e_i) / e_i * (-stress_trace / c.h_s) ** (1 - c.n)


def factors(stress_trace: Tensor, void_ratio: Tensor, c: Material) -> tuple[Tensor, Tensor]:
    """f_s (Pa) and f_d."""
    e_i, e_c, e_d = characteristic_void_ratios(stress_trace, c)
    f_s = (e_i / void_ratio) ** c.beta * barotropy(stress_trace, c)
    return f_s, ((void_ratio - e_d) / (e_c - e_d)) ** c.alpha


def rate(state: State, speed: Increment, c: Material) -> State:
    """Rates of stress, couple stress and void ratio under the rates of strain, curvature and spin."""
    sigma_kk = trace(state.stress)
    s, m = _scale(1 / sigma_kk, state.stress), _scale(1 / (c.d50 * sigma_kk), state.couple)
    d, k, w = speed.strain, c.d50 * speed.curvature, speed.spin
    f_s, f_d = factors(sigma_kk, state.void_ratio, c)
    a = critical_factor(s, c)
    norm = np.sqrt(contract(d, d) + contract(k, k))
    power = contract(s, d) + contract(m, k)
    stress = _scale(a**2, d) + _scale(power, s) + _scale(f_d * a * norm, s + s - UNIT / 3)
    couple = c.a_c**2 * k + _scale(power + 2 * f_d * c.a_c * norm, m)
    return State(
        stress=_scale(f_s, stress) + w @ state.stress - state.stress @ w,
        couple=_scale(f_s * c.d50, couple) + w @ state.couple - state.couple @ w,
        void_ratio=(1 + state.void_ratio) * trace(d),
    )


def integrate(state: State, increment: Increment, c: Material, *, void_ratio: bool = True) -> State:
    """One state carried over an increment applied at a constant rate, with an error far below that of the kernel.

    Raises:
        ArithmeticError: the law has no solution over the whole increment, or the integration failed.
    """
    pressure, length = -np.trace(state.stress) / 3, c.d50

    def pack(y: State) -> Tensor:
        return np.concatenate(
            [y.stress.reshape(-1, 9) / pressure, y.couple.reshape(-1, 9) / (pressure * length), [[y.void_ratio]]],
            axis=1,
        )[0]

    def unpack(x: Tensor) -> State:
        return State(pressure * x[:9].reshape(3, 3), pressure * length * x[9:18].reshape(3, 3), x[18])

    def f(_: float, x: Tensor) -> Tensor:
        slope = rate(unpack(x), increment, c)
        return pack(slope if void_ratio else State(slope.stress, slope.couple, np.zeros(())))

    with np.errstate(invalid="raise"):
        try:
            solution = solve_ivp(f, (0, 1), pack(state), method="Radau", rtol=1e-10, atol=1e-12)
        except FloatingPointError as error:
            raise ArithmeticError("the state left the law's domain") from error
    if not solution.success:
        raise ArithmeticError(solution.message)
    return unpack(solution.y[:, -1])


def discrete(
    state: State, increment: Increment, c: Material, *, substeps: int, void_ratio: bool = True, like: Tensor | None = None
) -> tuple[State, Tensor]:
    """A batch of states carried over increments by the kernel's scheme, solved by a Newton method of its own.

    Two-stage SDIRK with gamma = 1 - 1/sqrt(2), equal substeps, the void ratio in closed form. Complex increments give
    the derivatives of the result.

    Args:
        state: (m, ...) start.
        increment: (m, ...) increment.
        c: the constants.
        substeps: their number.
        void_ratio: whether it evolves.
        like: stages of a nearby solution to start Newton's method from, as returned.

    Returns:
        The end and the stages (substeps, 2, m, 18), stresses and couple stresses over d50 (Pa).

    Raises:
        ArithmeticError: Newton's method did not converge.
    """
    gamma = 1 - 1 / sqrt(2)
    volume = trace(increment.strain)
    m = len(volume)

    def void_ratio_at(time: float) -> Tensor:
        return (1 + state.void_ratio) * np.exp(time * volume) - 1 if void_ratio else state.void_ratio + 0 * volume

    def f(x: Tensor, time: float) -> Tensor:
        here = State(x[..., :9].reshape(*x.shape[:-1], 3, 3), c.d50 * x[..., 9:].reshape(*x.shape[:-1], 3, 3), void_ratio_at(time))
        slope = rate(here, increment, c)
        return np.concatenate(
            [slope.stress.reshape(x.shape[:-1] + (9,)), slope.couple.reshape(x.shape[:-1] + (9,)) / c.d50], axis=-1
        )

    def residual(x: Tensor, base: Tensor, time: float) -> Tensor:
        with np.errstate(invalid="ignore"):
            return x - base - gamma / substeps * f(x, time)

    def solve_stage(base: Tensor, guess: Tensor, time: float) -> Tensor:
        x, r = guess, residual(guess, base, time)
        for _ in range(40):
            size = np.abs(np.real(x[:, 0] + x[:, 4] + x[:, 8]))
            # A perturbation far larger than that of a complex increment, far smaller than any rounding.
            perturbed = np.real(x) + 1e-30j * size[:, None] * np.eye(18)[:, None, :]
            jacobian = np.moveaxis(np.imag(residual(perturbed, np.real(base), time)) / (1e-30 * size[:, None]), 0, -1)
            usable = np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(r).all(axis=1)
            jacobian[~usable], r[~usable] = np.eye(18), np.nan
            correction = np.linalg.solve(jacobian, r[..., None])[..., 0]
            share = np.ones((m, 1))
            for _ in range(12):
                r = residual(x - share * correction, base, time)
                outside = ~np.isfinite(r).all(axis=1)
                if not (outside & usable).any():
                    break
                share[outside] /= 2
            x = x - share * correction
            small = np.abs(correction).max(axis=1) < 1e-13 * size
            if np.all(small | ~usable):
                break
        x[~small] = np.nan
        return x

    y = np.concatenate([state.stress.reshape(m, 9), state.couple.reshape(m, 9) / c.d50], axis=1)
    stages = []
    for step in range(substeps):
        guesses = (y, None) if like is None else like[step]
        first = solve_stage(y, guesses[0], (step + gamma) / substeps)
        base = y + (1 - gamma) / gamma * (first - y)
        second = solve_stage(base, first if guesses[1] is None else guesses[1], (step + 1) / substeps)
        stages.append(np.stack([first, second]))
        y = second
    end = State(y[:, :9].reshape(m, 3, 3), c.d50 * y[:, 9:].reshape(m, 3, 3), void_ratio_at(1.0))
    return end, np.stack(stages)
