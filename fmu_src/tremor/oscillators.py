"""Intent and a bank of oscillators in one state-space filter: the tremor in a motion.

    v    = (place, speed, acceleration) of the intent, v' = A v + noise
    z_i  = oscillator of frequency f_i, z_i' = e^((i 2 pi f_i - 1 / tau_m) T) z_i + noise q_i
    s    = first of v + sum Re z_i + noise
    q_i  = q (exp(-((f_i - f_q) / b)^2 / 2) + q_0),  b = b_1 below f_q, b_2 above
    v, z = expected + gain (s - expected)
    W_i  = 1 / (1 + |(f_i^2 - f_a f_b) / (f_i (f_b - f_a))|^8)
    y    = sum W_i Re(e^((i 2 pi f_i - 1 / tau_m) h) z_i)     the tremor, h ahead

The oscillators fade and are driven by noise, so each is a narrow band, and their sum is a motion
with a spectrum of its own: a bump where hands shake. They reach beyond the tremor's band on either
side: what moves there is neither slow intent nor tremor, and is not put out (W). The intent is an
integrated random walk of the third order whose speed and acceleration fade within tau_v. The gain
is that of the Kalman filter in its steady state, computed when the model is
(`phasors.steady_gain`); the horizon is the oscillators' own motion, without approximation.

A filter whose spectrum is broad puts out what can be told of a tremor, which is less than all of
it: tones of 8 to 12 Hz come out at 0.6 to 0.85 of their size and within 25 degrees. `wflc_flc`
cancels a tone better and hands worse.

While the position is not valid, nothing is learnt and the model runs on; afterwards positions count
from where the model then is, so that no step is seen.

q, f_q, b_1, b_2, q_0, tau_m, the intent's noise and tau_v, f_a and f_b are tuned: by random search
on ten recordings of hand motion, position known, for the mean over a horizon of 0 and 4 ms of both
reductions that the tests name and for the worst recording, with the intent of 1 mm at 1 Hz
disturbed by 0.9 % at most. Tuned likewise on a random five of them, the filter reaches 34.8 %
a-posteriori and 56.8 % in the band on the other five, instead of 37.1 % and 55.5 %.

| symbol | field or constant | meaning |
| --- | --- | --- |
| s | position | tip position, intent and tremor together |
| f_i | FREQUENCIES | of the oscillators |
| tau_m | MEMORY | within which they fade |
| q | TREMOR_NOISE | density of their noise at its highest |
| f_q, b_1, b_2, q_0 | CENTRE, WIDTHS, FLOOR | its spectrum |
| tau_v | INTENT_MEMORY | within which the intent comes to rest |
| f_a, f_b | BAND | what is put out |
| f_w | wash_out | wash-out that the position has been through, undone for each oscillator |
| h | horizon | how far ahead the tremor is wanted |
| v | intent | place, speed, acceleration |
| z | phasors | oscillators, now |
| y | tremor | tremor at the time t + h |
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, real
from fmu_src.math import phasors
from fmu_src.tremor.intent_and_tones import IntentAndTones
from fmu_src.tremor.ports import CountedMotion, In, Out, Surroundings

FREQUENCIES = np.arange(3.0, 20.1, 0.75)
"""f_i [Hz]."""
TONES = len(FREQUENCIES)
ORDER = 3
"""Order of the intent: place, speed, acceleration."""
MEMORY = 0.67
"""tau_m [s]; tuned."""
TREMOR_NOISE = 1570.0
"""q [1/s], that of the position being 1; tuned."""
CENTRE = 8.3
"""f_q [Hz]; tuned."""
WIDTHS = (2.2, 2.7)
"""b_1, b_2 [Hz]; tuned."""
FLOOR = 0.007
"""q_0; tuned."""
INTENT_MEMORY = 0.084
"""tau_v [s]; tuned."""
INTENT_NOISE = 1.55e11
"""Density of the jerk's noise [1/s5], that of the position being 1; tuned."""
BAND = (5.75, 16.5)
"""f_a, f_b [Hz]; tuned."""


def _spectrum() -> np.ndarray:
    """Return q_i, (TONES,) [1/s]."""
    width = np.where(FREQUENCIES < CENTRE, *WIDTHS)
    return TREMOR_NOISE * (np.exp(-(((FREQUENCIES - CENTRE) / width) ** 2) / 2) + FLOOR)


FILTER = IntentAndTones(FREQUENCIES, MEMORY, _spectrum(), ORDER, INTENT_MEMORY, INTENT_NOISE)


class Factors(Derived):
    """Complex factors, real over imaginary parts."""

    ahead = real(None, "from the phasors to the tremor at t + h", shape=2 * TONES)


class OscillatorState(CountedMotion):
    """Intent and oscillators."""

    place = real("m", "first of v, place of the intent", shape=3)
    speed = real("m/s", "second of v, its speed", shape=3)
    acceleration = real("m/s2", "third of v, its acceleration", shape=3)
    phasors = real("m", "z, oscillators", shape=(2 * TONES, 3))


def share() -> np.ndarray:
    """Return W, the share of each oscillator that is tremor, (TONES,)."""
    low, high = BAND
    beside = (FREQUENCIES**2 - low * high) / (FREQUENCIES * (high - low))
    return 1 / (1 + beside**8)


def derive(p: Surroundings, T: float) -> Factors:
    """Compute the factors of the phasors."""
    return factors(p.horizon, partial(phasors.wash_out_undone, p.wash_out))


def factors(horizon: Any, undo: Callable[[Any], phasors.Pair]) -> Factors:
    """Compute the factors of the phasors, with what the motion has been through.

    Args:
        horizon: h [s].
        undo: factor that undoes that at frequencies, (TONES,) [Hz].
    """
    parts = phasors.read_out(FREQUENCIES, 1 / MEMORY, horizon, undo)
    return Factors(ahead=ca.vertcat(*(ca.DM(share()) * part for part in parts)))


def estimate(
    derived: Factors, position: Any, valid: Any, x: OscillatorState, T: float
) -> tuple[OscillatorState, Out]:
    """Compute one sample.

    Args:
        derived: what `derive` makes of the parameters.
        position: s, (3,) [m].
        valid: 1 to learn from this sample, 0 to let the model run on.
        x: state.
        T: sample period [s].
    """
    following = FILTER.advance(position, valid, x, T)
    return following, Out(tremor=phasors.total(following.phasors, derived.ahead))


def step(
    p: Surroundings, u: In, x: OscillatorState, T: float, derived: Factors
) -> tuple[OscillatorState, Out]:
    """Compute one sample."""
    return estimate(derived, u.position, u.valid, x, T)


MODEL = Model.of_step("IntentOscillators", step, sample_period=1e-3, derive=derive)
