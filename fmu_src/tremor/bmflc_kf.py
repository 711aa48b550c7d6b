"""Band-limited multiple Fourier linear combiner with Kalman adaptation, beside a slow intent.

    v       = (place, speed) of the intent, v' = A v + noise
    z_i     = phasor of the tone f_i, z_i' = e^((i 2 pi f_i - 1 / tau_m) T) z_i + noise
    s       = first of v + sum Re z_i + noise
    epsilon = s - what is expected
    v, z_i  = expected + gain epsilon
    y       = sum Re(e^((i 2 pi f_i - 1 / tau_m) h) z_i)      the tones, h ahead

After Y. Wang, K. C. Veluvolu and M. Lee, *Time-Frequency Analysis of Band-Limited EEG with BMFLC
and Kalman Filter for BCI Applications* (2013), whose coefficients are on random walks. A random
walk of coefficients is one of the phasors (`phasors`). Here the coefficients also fade within
tau_m, a process of Gauss and Markov; and the intent is estimated together with them, an integrated
random walk whose speed fades, so that nothing needs to be filtered before. No axis knows of the
others.

The noise of all tones is alike, and the data do not enter the covariance: the gain is that of its
steady state, computed when the model is (`phasors.steady_gain`), relative to a noise of variance 1.

While the position is not valid, nothing is learnt and the model runs on; afterwards positions count
from where the model then is, so that no step is seen.

The densities of the noise and the times within which tones and intent fade are tuned, by random
search on ten recordings of hand motion, position known, with the intent of 1 mm at 1 Hz disturbed
by 1 % at most. Coefficients that do not fade (tau_m endless, tuned likewise) cancel a tone of the
grid without remainder, but hardly one between two of the grid, and of real hands 10 points less; as
they are, tones of 8 to 12 Hz come out at 0.5 to 0.8 of their size and within 25 degrees.

| symbol | field or constant | meaning |
| --- | --- | --- |
| s | position | tip position, intent and tremor together |
| f_i | FREQUENCIES | grid |
| tau_m | MEMORY | within which tones fade |
| f_w | wash_out | corner of a wash-out that the position has been through, undone for each tone |
| h | horizon | how far ahead the tremor is wanted |
| v | intent | place and speed |
| z | phasors | tones, now |
| y | tremor | tremor at the time t + h |
"""

from functools import partial

import casadi as ca
import numpy as np

from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, real
from fmu_src.math import phasors
from fmu_src.tremor.intent_and_tones import IntentAndTones
from fmu_src.tremor.ports import CountedMotion, In, Out, Surroundings

FREQUENCIES = np.arange(6.0, 14.1, 0.5)
"""f_i [Hz]."""
TONES = len(FREQUENCIES)
ORDER = 2
"""Order of the intent: place and speed."""
MEMORY = 0.8
"""tau_m [s]; tuned."""
TREMOR_NOISE = 60.0
"""Density of each part of each phasor's noise [1/s], that of the position being 1; tuned."""
INTENT_MEMORY = 0.23
"""Time within which the intent's speed fades [s]; tuned."""
INTENT_NOISE = 2.25e7
"""Density of the acceleration's noise [1/s3], that of the position being 1; tuned."""


FILTER = IntentAndTones(
    FREQUENCIES, MEMORY, np.full(TONES, TREMOR_NOISE), ORDER, INTENT_MEMORY, INTENT_NOISE
)


class Factors(Derived):
    """Complex factors, real over imaginary parts."""

    ahead = real(None, "from the phasors to the tremor at t + h", shape=2 * TONES)


class BmflcKfState(CountedMotion):
    """Intent and tones."""

    place = real("m", "first of v, place of the intent", shape=3)
    speed = real("m/s", "second of v, its speed", shape=3)
    phasors = real("m", "z, tones", shape=(2 * TONES, 3))


def derive(p: Surroundings, T: float) -> Factors:
    """Compute the factors of the phasors."""
    undo = partial(phasors.wash_out_undone, p.wash_out)
    return Factors(ahead=ca.vertcat(*phasors.read_out(FREQUENCIES, 1 / MEMORY, p.horizon, undo)))


def step(
    p: Surroundings, u: In, x: BmflcKfState, T: float, derived: Factors
) -> tuple[BmflcKfState, Out]:
    """Compute one sample."""
    following = FILTER.advance(u.position, u.valid, x, T)
    return following, Out(tremor=phasors.total(following.phasors, derived.ahead))


MODEL = Model.of_step("BmflcKf", step, sample_period=1e-3, derive=derive)
