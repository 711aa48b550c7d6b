"""Fourier linear combiner: amplitude and phase of a tone of known frequency (A04 5.2.1).

    phi'    = phi + 2 pi f T                                  running sum of the frequency
    x_r     = sin(r phi'),  x_{M+r} = cos(r phi')             r = 1..M         (5.2)
    epsilon = s - w.x                                                          (5.3)
    w'      = w + 2 mu x epsilon,  mu = T / tau                                (5.4)
    y       = w'.x

A04 has tau = 1 / (2 mu) samples (5.5). The squares of x average one half, so the weights, and with
them amplitude and phase, settle with 1 / mu samples: that is the tau used here.

| symbol | field | meaning |
| --- | --- | --- |
| s | position | input, three axes, each with a combiner of its own |
| f | frequency | frequency of the tone |
| tau | time_constant | within which the weights follow amplitude and phase |
| phi | phase | phase of the fundamental, in [0, 2 pi) |
| w | weights | row r-1: sine of harmonic r, row M+r-1: its cosine; a column for each axis |
| M | HARMONICS | harmonics in the model |
| y | tremor | the tone |
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, real, vector

HARMONICS = 1
"""M. The second harmonic of an 8 to 12 Hz tremor lies beyond what hands show above their noise."""


class FlcParams(Parameters):
    """Adaptation of the weights."""

    time_constant = real(
        "s", "tau, within which the weights follow the tone", start=0.1, min=0.01, max=100.0
    )


class Params(Parameters):
    """Tone and adaptation."""

    frequency = real("Hz", "f, frequency of the tone", start=10.0, min=0.1, max=100.0, shape=3)
    combiner = FlcParams


class In(Inputs):
    """Position that holds the tone."""

    position = vector("m", "s, position that holds the tone", within=1.0)


class X(State):
    """Phase and weights."""

    phase = real("rad", "phi, running phase", shape=3)
    weights = real("m", "w, Fourier coefficients", shape=(2 * HARMONICS, 3))


class Out(Outputs):
    """The tone."""

    tremor = vector("m", "y, the tone in the position")


def advance(phase: Any, frequency: Any, T: float) -> ca.SX:
    """Return the phase one sample later, (3,) [rad]; in [0, 2 pi) it never loses digits."""
    phase = phase + 2 * np.pi * frequency * T
    return phase - 2 * np.pi * ca.floor(phase / (2 * np.pi))


def reference(phase: Any) -> ca.SX:
    """Return the reference x (5.2) at a phase of each axis, (2 M, 3)."""
    harmonics = ca.vertcat(*(r * phase.T for r in range(1, HARMONICS + 1)))
    return ca.vertcat(ca.sin(harmonics), ca.cos(harmonics))


def tone(weights: Any, x: Any) -> Any:
    """Sum the truncated Fourier series w.x of each axis (5.1), (3,) [m]."""
    return ca.sum1(weights * x).T


def adapt(weights: Any, x: Any, error: Any, time_constant: Any, T: float) -> ca.SX:
    """Return the weights after one LMS step (5.4), (2 M, 3) [m].

    Args:
        weights: w, (2 M, 3) [m].
        x: reference, (2 M, 3).
        error: epsilon of each axis, (3,) [m].
        time_constant: tau [s].
        T: sample period [s].
    """
    return weights + 2 * T / time_constant * x * ca.repmat(error.T, 2 * HARMONICS, 1)


def step(p: Params, u: In, x: X, T: float) -> tuple[X, Out]:
    """Compute one sample."""
    phase = advance(x.phase, p.frequency, T)
    regressor = reference(phase)
    error = u.position - tone(x.weights, regressor)
    weights = adapt(x.weights, regressor, error, p.combiner.time_constant, T)
    return X(phase=phase, weights=weights), Out(tremor=tone(weights, regressor))


MODEL = Model.of_step("Flc", step, sample_period=1e-3)
