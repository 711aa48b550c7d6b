"""WFLC-FLC tremor filter: prefilter, frequency by WFLC, tremor by FLC (A04 5.2.1, Fig. 5.4).

    s'  = elliptic band-pass of s                             `elliptic`
    f   = frequency that the WFLC finds in s'                 `wflc`
    s'' = s through HIGH_PASS_ORDER first-order high-passes at f_c
    e   = s'' - w.x,  w' = w + 2 mu x e                       (5.11, 5.12), x the WFLC's reference
    W   = w' as phasors, by harmonic: w_r + i w_{M+r}
    V   = W (1 + u)^2 (1 + v) (1 + v + v^2)                   high-passes undone at r f
    y   = Im(V e^(i r (phi + 2 pi f h))), summed over r       the tone, h ahead

Changes from A04. There the FLC works on the whole signal; but its width, which it needs to follow
a hand, lets intent pass, so it gets the high-passed signal here. What a high-pass does to a tone of
known frequency is known, and undone exactly: by 1 + u with u = -i tan(pi f_c T) / tan(pi r f T) for
each of ours (bilinear), and by (1 + v) (1 + v + v^2), v = -i f_w / (r f), for a third-order
Butterworth of corner f_w that the position has been through before, as an inertial one has. And the
tone is put out a horizon h ahead, to make up for the delay of the loop.

Positions count from the first one. While they are not valid, nothing is learnt and the tone runs on
as it was; afterwards they count from the last valid one, so that no step is seen.

Time constants, floor and corner are tuned: by random search on ten recordings of hand motion and
on a quasi-sinusoidal 8 to 12 Hz tremor, position known; the FLC's then raised until, with motion
known from inertial sensors only, no recording got worse. A shorter one cancels more in the band of
tremor and disturbs more beside it.

| symbol | field | meaning |
| --- | --- | --- |
| s | position | tip position, intent and tremor together |
| f_c | corner | corner of our high-passes |
| f_w | wash_out | corner of the wash-out that the position has been through |
| h | horizon | how far ahead the tremor is wanted |
| w | weights | Fourier coefficients of the FLC, of s'' |
| phi, x, M | | as in `flc`; the WFLC's |
| y | tremor | tremor at the time t + h |
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.kit import Parameters
from fmu_src.kit.model import Model
from fmu_src.kit.records import real, vector
from fmu_src.math import phasors
from fmu_src.math.elliptic import EllipticState, band_pass
from fmu_src.tremor import flc, ports, wflc
from fmu_src.tremor.ports import HORIZON, WASH_OUT, In

HIGH_PASS_ORDER = 2
"""Tuned: of one, two and three the best on the recordings."""


class WflcFlcParams(Parameters):
    """Adaptation, high-passes and horizon."""

    wflc: Any = wflc.WflcParams
    flc: Any = flc.FlcParams.starting(time_constant=0.08)
    corner = real("Hz", "f_c, corner of the high-passes", start=5.0, min=0.5, max=10.0)
    wash_out: Any = WASH_OUT
    horizon: Any = HORIZON


class WflcFlcState(ports.CountedMotion):
    """Memories of the filters."""

    motion = real("m", "position less origin, held while there is none to trust", shape=3)
    high = real("m", "memory of the high-pass", shape=(HIGH_PASS_ORDER, 3))
    prefilter: Any = EllipticState
    wflc: Any = wflc.WflcState
    weights = real("m", "w, Fourier coefficients of the FLC", shape=(2 * flc.HARMONICS, 3))


class Out(ports.Out):
    """The tremor, and its frequency."""

    frequency = vector("Hz", "f, its frequency")


def estimate(
    p: WflcFlcParams, position: Any, valid: Any, x: WflcFlcState, T: float
) -> tuple[WflcFlcState, Out]:
    """Compute one sample.

    Args:
        p: parameters.
        position: s, (3,) [m].
        valid: 1 to learn from this sample, 0 to let the tone run on as it is.
        x: state.
        T: sample period [s].
    """
    motion, origin = phasors.count(position, valid, x.motion, x)
    prefilter, band = band_pass(motion, x.prefilter, T)
    tuned, regressor = wflc.follow(p.wflc, band, valid, x.wflc, T)
    f = wflc.frequency(p.wflc, tuned)

    high, passed = high_pass(motion, ca.tan(np.pi * p.corner * T), x.high)
    error = valid * (passed - flc.tone(x.weights, regressor))
    weights = flc.adapt(x.weights, regressor, error, p.flc.time_constant, T)

    whole = undo_high_passes(p, weights, f, T)
    ahead = flc.reference(tuned.phase + 2 * np.pi * f * p.horizon)
    following = WflcFlcState(
        tracked=valid,
        origin=origin,
        motion=motion,
        high=high,
        prefilter=prefilter,
        wflc=tuned,
        weights=weights,
    )
    return following, Out(tremor=flc.tone(whole, ahead), frequency=f)


def high_pass(s: Any, c: Any, memory: Any) -> tuple[ca.SX, ca.SX]:
    """Apply first-order high-passes in a row, (1 - z^-1) / ((1 + c) - (1 - c) z^-1) (bilinear).

    Args:
        s: input, (3,) [m].
        c: tan(pi f_c T).
        memory: (HIGH_PASS_ORDER, 3) [m].

    Returns:
        New memory, and the output, (3,) [m].
    """
    rows = []
    for before in ca.vertsplit(memory):
        y = (s + before.T) / (1 + c)
        rows.append(((1 - c) * y - s).T)
        s = y
    return ca.vertcat(*rows), s


def undo_high_passes(p: WflcFlcParams, weights: Any, frequency: Any, T: float) -> ca.SX:
    """Return the weights of the tone as it was before all high-passes, (2 M, 3) [m].

    Args:
        p: corners.
        weights: w, (2 M, 3) [m].
        frequency: f of each axis, (3,) [Hz].
        T: sample period [s].
    """
    M = flc.HARMONICS
    harmonic = ca.vertcat(*(r * frequency.T for r in range(1, M + 1)))
    u = ca.tan(np.pi * p.corner * T) / ca.tan(np.pi * harmonic * T)
    v = p.wash_out / harmonic

    def times(phasor: tuple[Any, Any], real_part: Any, lag: Any) -> tuple[Any, Any]:
        a, b = phasor
        return real_part * a + lag * b, real_part * b - lag * a  # (a + i b) (real_part - i lag)

    phasor = weights[:M, :], weights[M:, :]
    for _ in range(HIGH_PASS_ORDER):
        phasor = times(phasor, 1.0, u)
    phasor = times(times(phasor, 1.0, v), 1 - v**2, v)
    return ca.vertcat(*phasor)


def step(p: WflcFlcParams, u: In, x: WflcFlcState, T: float) -> tuple[WflcFlcState, Out]:
    """Compute one sample."""
    return estimate(p, u.position, u.valid, x, T)


MODEL = Model.of_step("WflcFlc", step, sample_period=1e-3)
