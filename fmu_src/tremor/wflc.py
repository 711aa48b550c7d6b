"""Weighted-frequency Fourier linear combiner: a tone whose frequency is found (A04 5.2.1).

    phi'    = phi + 2 pi f T                                  running sum of the frequency
    x_r     = sin(r phi'),  x_{M+r} = cos(r phi')             r = 1..M
    epsilon = s - w.x                                         what the tone does not explain
    g       = sum r (w_r x_{M+r} - w_{M+r} x_r)               d(w.x) / d(phi')
    2 pi f' = 2 pi f + 2 mu_0 epsilon g,  mu_0 = T / (tau_f tau (|w|^2 + a^2))
    w'      = w + 2 mu_1 x epsilon,       mu_1 = T / tau
    y       = w'.x

These are A04's equations for x, epsilon, frequency and weights, numbered (5.7) to (5.10) the second
time, with two changes. The step of the frequency is divided by the tone's power, so that its
speed does not depend on the amplitude: weights that lag a frequency off by d by the phase d tau
make epsilon g average |w|^2 d tau / 2, and with the mu_0 above f settles with tau_f. The floor a
stops f where there is no tone. And f stays within limits, since an LMS frequency may run away.

The input should hold little else than the tone: prefilter it (`elliptic`, `wflc_flc`).

| symbol | field | meaning |
| --- | --- | --- |
| s | position | input, three axes, each with a combiner of its own |
| tau | combiner.time_constant | within which the weights follow the tone |
| tau_f | time_constant | within which the frequency follows |
| a | floor | amplitude below which the frequency hardly moves |
| f | frequency | frequency found |
| phi, w | phase, weights | as in `flc` |
| y | tremor | the tone |
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.kit import Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, real, vector
from fmu_src.tremor import flc


class WflcParams(Parameters):
    """Adaptation of frequency and weights."""

    combiner: Any = flc.FlcParams
    time_constant = real(
        "s", "tau_f, within which the frequency follows", start=0.8, min=0.01, max=100.0
    )
    floor = real("m", "a, amplitude below which f rests", start=5e-6, min=1e-9, max=1e-3)
    initial = real("Hz", "frequency at the first sample", start=10.0, min=1.0, max=50.0)
    lowest = real("Hz", "lower limit of the frequency", start=7.0, min=1.0, max=50.0)
    highest = real("Hz", "upper limit of the frequency", start=13.0, min=1.0, max=50.0)


class In(Inputs):
    """Position that holds the tone."""

    position = vector("m", "s, prefiltered position", within=1.0)


class WflcState(State):
    """Phase, weights and frequency; the frequency as its distance from `initial`."""

    phase = real("rad", "phi, running phase", shape=3)
    detuning = real("Hz", "f less its initial value", shape=3)
    weights = real("m", "w, Fourier coefficients", shape=(2 * flc.HARMONICS, 3))


class Out(flc.Out):
    """The tone, and its frequency."""

    frequency = vector("Hz", "f, its frequency")


def frequency(p: WflcParams, x: WflcState) -> ca.SX:
    """Return the frequency found so far, (3,) [Hz]."""
    return p.initial + x.detuning


def follow(
    p: WflcParams, position: Any, trusted: Any, x: WflcState, T: float
) -> tuple[WflcState, ca.SX]:
    """Adapt by one step.

    Args:
        p: parameters.
        position: s, (3,) [m].
        trusted: 1 to learn from this sample, 0 to let the tone run on as it is.
        x: state.
        T: sample period [s].

    Returns:
        New state, and the reference x at its phase, (2 M, 3).
    """
    M = flc.HARMONICS
    phase = flc.advance(x.phase, frequency(p, x), T)
    regressor = flc.reference(phase)
    w = x.weights
    error = trusted * (position - flc.tone(w, regressor))
    order = ca.DM(range(1, M + 1)).T
    slope = (order @ (w[:M, :] * regressor[M:, :] - w[M:, :] * regressor[:M, :])).T
    power = ca.sum1(w * w).T + p.floor**2
    pull = 2 * T / (p.time_constant * p.combiner.time_constant) * error * slope / power
    detuning = ca.fmin(
        ca.fmax(x.detuning + pull / (2 * np.pi), p.lowest - p.initial), p.highest - p.initial
    )
    weights = flc.adapt(w, regressor, error, p.combiner.time_constant, T)
    return WflcState(phase=phase, detuning=detuning, weights=weights), regressor


def step(p: WflcParams, u: In, x: WflcState, T: float) -> tuple[WflcState, Out]:
    """Compute one sample."""
    following, regressor = follow(p, u.position, 1.0, x, T)
    return following, Out(
        tremor=flc.tone(following.weights, regressor), frequency=frequency(p, following)
    )


MODEL = Model.of_step("Wflc", step, sample_period=1e-3)
