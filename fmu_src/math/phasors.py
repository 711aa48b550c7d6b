"""Bank of phasors: what the filters with many fixed frequencies share.

A tone of frequency f_i is the real part of a phasor z_i that turns by 2 pi f_i T with every sample.
A Fourier combiner's weights are the same number seen from a reference that turns along:

    a sin phi + b cos phi = Re((b - i a) e^(i phi)),  z = (b - i a) e^(i phi)

so an LMS step w' = w + 2 mu x epsilon is z' = z + 2 mu epsilon, and no sine is computed while a
filter runs. Phasors of N tones and three axes are stored as (2 N, 3): N rows of real parts over N
rows of imaginary parts. Complex numbers elsewhere are pairs (real part, imaginary part).

| symbol | name | meaning |
| --- | --- | --- |
| z_i | phasors | of the tones, now |
| f_i | frequencies | of the tones |
| f_w | wash_out | corner of the wash-out that the position has been through |
| h | horizon | how far ahead the tremor is wanted |
"""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from scipy import linalg

Pair = tuple[Any, Any]
"""Real and imaginary part."""


def product(a: Pair, b: Pair) -> Pair:
    """Product of complex numbers, element by element."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def turning(angle: Any) -> Pair:
    """e^(i angle)."""
    return ca.cos(angle), ca.sin(angle)


def wash_out_undone(wash_out: Any, frequencies: Any) -> Pair:
    """(1 + v) (1 + v + v^2), v = -i f_w / f: a third-order Butterworth high-pass undone at f.

    Args:
        wash_out: f_w [Hz], 0 if there is none.
        frequencies: f, (N,) [Hz].
    """
    lag = wash_out / frequencies
    return product((1.0, -lag), (1 - lag**2, -lag))


def apply(factor: Any, phasors: Any) -> Any:
    """Each tone's phasor multiplied by its complex factor.

    Args:
        factor: (2 N,), real parts over imaginary parts.
        phasors: (2 N, 3) [m].

    Returns:
        (2 N, 3) [m].
    """
    N = phasors.shape[0] // 2
    three = [ca.repmat(part, 1, 3) for part in (factor[:N], factor[N:])]
    return ca.vertcat(*product((three[0], three[1]), (phasors[:N, :], phasors[N:, :])))


def total(phasors: Any, factor: Any = None) -> Any:
    """Sum of the tones of each axis, Re(sum of factor_i z_i), (3,) [m].

    Args:
        phasors: (2 N, 3) [m].
        factor: (2 N,), real parts over imaginary parts; 1 if left out.
    """
    N = phasors.shape[0] // 2
    if factor is None:
        return ca.sum1(phasors[:N, :]).T
    return (factor[:N].T @ phasors[:N, :] - factor[N:].T @ phasors[N:, :]).T


def count(position: Any, valid: Any, expected: Any, last: Any) -> tuple[ca.SX, ca.SX]:
    """Motion of one sample, counted so that neither a start nor a gap is seen as a step.

    While the position is not valid, motion goes on as expected; the first valid position after
    that is taken to be the expected one, and motion counts from there.

    Args:
        position: (3,) [m].
        valid: whether it can be trusted.
        expected: motion that the filter expects now, (3,) [m].
        last: the state, with `tracked` (whether the last position was valid) and `origin`.

    Returns:
        Motion and origin, (3,) [m] each.
    """
    origin = ca.if_else(last.tracked, last.origin, position - expected)
    return ca.if_else(valid, position - origin, expected), origin


def intent_transition(order: int, memory: float, T: float) -> np.ndarray:
    """Slow intent from one sample to the next: place, speed and, in the third order, acceleration.

    All but the place fade within `memory`, so that an intent that nobody observes comes to rest.

    Args:
        order: 2 or 3.
        memory: [s].
        T: sample period [s].
    """
    keep = np.exp(-T / memory)
    if order == 2:
        return np.array([[1.0, T], [0.0, keep]])
    return np.array([[1.0, T, T**2 / 2], [0.0, keep, T], [0.0, 0.0, keep]])


def intent_noise(order: int, T: float) -> np.ndarray:
    """Covariance of what a highest derivative, white with unit density, adds in one sample."""
    factorials = np.cumprod([1.0, *range(1, order + 1)])
    added = np.array([T**n / factorials[n] for n in range(order, 0, -1)])
    return np.outer(added, added) / T


def steady_gain(
    intent: np.ndarray,
    intent_noise: np.ndarray,
    phasor: np.ndarray,
    phasor_noise: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Gain of the Kalman filter for intent plus tones, in the steady state.

        x' = A x + n,  s = first of the intent + Re(sum of z_i) + noise of variance 1

    The covariance of a linear filter does not depend on the data, and seen from the phasors neither
    on time: what it settles at solves an algebraic Riccati equation. Computers differ in the ninth
    digit; six are kept, so that, as a rule, all build the same FMU.

    Args:
        intent: its transition, (n, n).
        intent_noise: covariance of what is added to it in one sample, (n, n).
        phasor: complex factor of each tone from one sample to the next, (N,).
        phasor_noise: variance of what is added to each part of each phasor, (N,).

    Returns:
        Gain of the intent, (n,), and of the phasors, (2 N,), real parts over imaginary parts.
    """
    n, N = len(intent), len(phasor)
    A, Q = np.zeros((2, n + 2 * N, n + 2 * N))
    A[:n, :n], Q[:n, :n] = intent, intent_noise
    A[n:, n:] = np.block(
        [
            [np.diag(phasor.real), -np.diag(phasor.imag)],
            [np.diag(phasor.imag), np.diag(phasor.real)],
        ]
    )
    Q[n:, n:] = np.diag(np.tile(phasor_noise, 2))
    C = np.zeros((1, n + 2 * N))
    C[0, 0] = 1.0
    C[0, n : n + N] = 1.0
    P = linalg.solve_discrete_are(A.T, C.T, Q, np.eye(1))
    gain = (P @ C.T / (C @ P @ C.T + 1.0)).ravel()
    gain = np.array([float(f"{value:.6g}") for value in gain])
    return gain[:n], gain[n:]


def read_out(
    frequencies: Sequence[float] | np.ndarray,
    decay: float,
    horizon: Any,
    undo: Callable[[Any], Pair],
) -> Pair:
    """Factor that takes each tone a horizon ahead and undoes what the motion has been through.

    Args:
        frequencies: f, (N,) [Hz].
        decay: rate at which the tones fade [1/s].
        horizon: h [s].
        undo: factor that undoes that at frequencies, (N,) [Hz].
    """
    f = ca.DM(np.asarray(frequencies))
    fading = ca.exp(-decay * horizon)
    real_part, imaginary = product(turning(2 * np.pi * f * horizon), undo(f))
    return fading * real_part, fading * imaginary
