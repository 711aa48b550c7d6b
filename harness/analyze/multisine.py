"""Multisines: what the loop and its parts are probed with, and how their answers are read.

    p(t)   = w(t) sum_k a_k cos(2 pi f_k t + phi_k)        f_k = SPACING k, phi_k random
    Y(f_k) = 2 / N sum_n h_n y_n exp(-i 2 pi f_k t_n)      over WINDOW, a whole number of periods

    w      rises from 0 to 1 in FADE as a raised cosine, so that nothing jumps
    h      Hann's window, scaled to mean 1: lines lie PERIODS bins apart, so that they do not leak
           into each other, and what is left of a slow transient does not leak far

Random phases keep the peaks of the sum low and make the answers of a nonlinear part to two of them
differ (Pintelon and Schoukens, System Identification, 2nd ed. 2012, chapter 4).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from harness.common.types import FloatArray

__all__ = [
    "FREQUENCIES",
    "OMEGA",
    "SPACING",
    "TRANSIENT",
    "WINDOW",
    "ComplexArray",
    "lines_of",
    "multisine",
    "random_phases",
    "within",
]

ComplexArray = NDArray[np.complex128]

SPACING = 0.5
"""Distance of two lines, and the lowest one [Hz]."""
HIGHEST = 20.0
"""Highest line [Hz]."""
FREQUENCIES: FloatArray = SPACING * np.arange(1, round(HIGHEST / SPACING) + 1, dtype=float)
"""Lines (f,) [Hz]."""
OMEGA: FloatArray = 2 * np.pi * FREQUENCIES
"""The same [rad/s]."""
PERIODS = 3
"""Periods of the multisine in a window."""
WINDOW = PERIODS / SPACING
"""Time over which answers are read [s]."""
TRANSIENT = 4.0
"""Time from the start of a probe to the window [s]."""
FADE = 1.0
"""Time in which a probe comes in [s]."""


def within(low: float, high: float) -> NDArray[np.bool_]:
    """Return which lines lie from `low` to `high` [Hz], (f,)."""
    edges = (low - SPACING / 4, high + SPACING / 4)
    return np.asarray(np.digitize(FREQUENCIES, edges) == 1)


def random_phases(seed: int, *stream: int) -> FloatArray:
    """Return phases of the lines, (f,) [rad]; equal numbers give equal phases."""
    generator = np.random.default_rng([seed, *stream])
    return generator.uniform(0.0, 2 * np.pi, len(FREQUENCIES))


def multisine(time: FloatArray, start: float, lines: ComplexArray) -> FloatArray:
    """Return a probe that comes in at `start`.

    Args:
        time: (n,) [s].
        start: [s]; zero before.
        lines: amplitude and phase of each line, (f,).

    Returns:
        (n,) in the unit of the lines.
    """
    turns = np.exp(1j * np.outer(time, OMEGA))
    progress = np.clip((time - start) / FADE, 0.0, 1.0)
    return np.asarray(0.5 * (1.0 - np.cos(np.pi * progress)) * (turns @ lines).real)


def lines_of(time: FloatArray, values: FloatArray) -> ComplexArray:
    """Return lines of signals over the last WINDOW.

    Args:
        time: (n,) [s], equidistant.
        values: (n, columns).

    Returns:
        (f, columns) amplitude and phase, as `multisine` takes them.
    """
    count = round(WINDOW / (time[1] - time[0]))
    weights = signal.windows.hann(count, sym=False)
    weights *= 2.0 / weights.sum()
    turns = np.exp(-1j * np.outer(OMEGA, time[-count:])) * weights
    part = values[-count:]
    return np.asarray(turns @ (part - part.mean(axis=0)))
