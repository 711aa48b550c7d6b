"""Band-limited multiple Fourier linear combiner: tones on a fixed grid over the tremor band.

    s'      = s through HIGH_PASS_ORDER first-order high-passes at f_c
    f_i     = f_1 + i (f_N - f_1) / (N - 1)                   i = 0..N-1
    x_i     = (sin, cos)(2 pi f_i t)
    epsilon = s' - sum w_i.x_i
    w_i'    = e^(-T / tau_m) w_i + 2 mu x_i epsilon,  mu = T / tau
    V_i     = W_i (1 + u_i)^HIGH_PASS_ORDER                   w_i as phasor, high-passes undone
    y       = sum Im(V_i e^(i 2 pi f_i (t + h)))              the tones, h ahead

After K. C. Veluvolu and W. T. Ang, *Estimation of Physiological Tremor from Accelerometers for
Real-Time Applications* (2011). No frequency is adapted: what lies between two tones of the grid
is a beat of their weights. Weights are kept as phasors, which are the same numbers (`phasors`).

Two things differ. The combiner gets the position less its slow part, through high-passes whose
effect on each tone of the grid is known and undone exactly: u_i = -i tan(pi f_c T) / tan(pi f_i T),
as in `wflc_flc`. And the weights fade within tau_m: without that the combiner answers with the comb
of its grid, whose tones ring for long each: a lasting tone of the grid comes out whole, what lies
between does not, and of real hands a tenth at best is cancelled a-posteriori. With tau_m as it is,
tones of 8 to 12 Hz come out at 0.55 to 0.85 of their size and within 30 degrees. tau_m = 100 s with
tau = 1 s is the former.

While the position is not valid, nothing is learnt, nothing fades and the tones run on; the motion
is taken to run on with them, so that no step is seen afterwards.

tau, tau_m, f_c, the order of the high-passes and the grid are tuned, by grid search on ten
recordings of hand motion, position known, for the mean of both reductions that the tests name and
for the worst recording.

| symbol | field or constant | meaning |
| --- | --- | --- |
| s | position | tip position, intent and tremor together |
| N | TONES | tones of the grid |
| f_1, f_N | lowest, highest | first and last of the grid |
| f_c | corner | corner of the high-passes |
| f_w | wash_out | corner of a wash-out that the position has been through, undone likewise |
| tau | time_constant | within which the weights would follow a single tone |
| tau_m | memory | within which weights fade |
| h | horizon | how far ahead the tremor is wanted |
| z | phasors | the weights, turned to now |
| y | tremor | tremor at the time t + h |
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.kit import Parameters
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, real
from fmu_src.math import phasors
from fmu_src.tremor.ports import HORIZON, WASH_OUT, CountedMotion, In, Out
from fmu_src.tremor.wflc_flc import high_pass

TONES = 13
"""N; with the grid's ends 0.5 Hz apart."""
HIGH_PASS_ORDER = 3
"""Tuned: of one, two and three the best on the recordings."""


class BmflcParams(Parameters):
    """Grid, adaptation and horizon."""

    lowest = real("Hz", "f_1, lowest frequency of the grid", start=7.0, min=1.0, max=50.0)
    highest = real("Hz", "f_N, highest frequency of the grid", start=13.0, min=1.0, max=50.0)
    time_constant = real(
        "s", "tau, within which the weights follow a tone", start=0.03, min=0.02, max=100.0
    )
    memory = real("s", "tau_m, within which weights fade", start=0.1, min=0.01, max=1000.0)
    corner = real("Hz", "f_c, corner of the high-passes", start=10.0, min=0.5, max=20.0)
    wash_out: Any = WASH_OUT
    horizon: Any = HORIZON


class Factors(Derived):
    """Complex factors of the phasors in a sample, real over imaginary parts."""

    turn = real(None, "e^(i 2 pi f_i T), from one sample to the next", shape=2 * TONES)
    keep = real(None, "e^(-T / tau_m), what a sample leaves of the weights")
    whole = real(None, "(1 + u_i)^HIGH_PASS_ORDER, high-passes undone", shape=2 * TONES)
    ahead = real(None, "the same, wash-out undone and a horizon ahead", shape=2 * TONES)


class BmflcState(CountedMotion):
    """Memories of the filters."""

    motion = real("m", "position less origin", shape=3)
    high = real("m", "memory of the high-passes", shape=(HIGH_PASS_ORDER, 3))
    phasors = real("m", "z, weights turned to now", shape=(2 * TONES, 3))


def derive(p: BmflcParams, T: float) -> Factors:
    """Compute the factors of the phasors."""
    f = p.lowest + ca.DM(np.arange(TONES) / (TONES - 1)) * (p.highest - p.lowest)
    u = ca.tan(np.pi * p.corner * T) / ca.tan(np.pi * f * T)
    whole: phasors.Pair = (ca.DM.ones(TONES), ca.DM.zeros(TONES))
    for _ in range(HIGH_PASS_ORDER):
        whole = phasors.product(whole, (1.0, -u))
    ahead = phasors.product(whole, phasors.wash_out_undone(p.wash_out, f))
    ahead = phasors.product(ahead, phasors.turning(2 * np.pi * f * p.horizon))
    return Factors(
        turn=ca.vertcat(*phasors.turning(2 * np.pi * f * T)),
        keep=ca.exp(-T / p.memory),
        whole=ca.vertcat(*whole),
        ahead=ca.vertcat(*ahead),
    )


def step(
    p: BmflcParams, u: In, x: BmflcState, T: float, derived: Factors
) -> tuple[BmflcState, Out]:
    """Compute one sample. While the position is not valid, the tones run on as they are."""
    turned = phasors.apply(derived.turn, x.phasors)
    gone_on = phasors.total(turned, derived.whole) - phasors.total(x.phasors, derived.whole)
    motion, origin = phasors.count(u.position, u.valid, x.motion + gone_on, x)

    high, passed = high_pass(motion, ca.tan(np.pi * p.corner * T), x.high)
    error = u.valid * (passed - phasors.total(turned))
    learnt = ca.repmat(2 * T / p.time_constant * error.T, TONES, 1)
    following = ca.if_else(u.valid, derived.keep, 1.0) * turned + ca.vertcat(
        learnt, ca.SX(TONES, 3)
    )
    return (
        BmflcState(tracked=u.valid, origin=origin, motion=motion, high=high, phasors=following),
        Out(tremor=phasors.total(following, derived.ahead)),
    )


MODEL = Model.of_step("Bmflc", step, sample_period=1e-3, derive=derive)
