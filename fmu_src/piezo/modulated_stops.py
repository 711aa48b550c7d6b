"""Stop operators modulated by the voltage, with creep and lead: stroke of a piezo stack.

    a    = v / V                                        voltage as a share of the span
    H_i  = max(v - r_i, min(v + r_i, H_i))              play, i = 1..N           (A04 7.1)
    E_i  = (v - H_i) / V                                stop: what the play leaves over
    b    = p_1 a + p_2 a^2 + p_3 a^3 - sum ((1 - a) f_i + a g_i) E_i
    c_j <- e^(-T/tau_j) c_j + (1 - e^(-T/tau_j)) a'     creep, a' one sample ago
    z    = b + sum k_j c_j + lead (p_1 / T) (a - a')

A Prandtl-Ishlinskii operator in terms of its stops: v less plays is stops, so that the weights of
the plays stand in p_1 and in f, g. What is added is that a stop may weigh more at one end of the
range than at the other (f_i at 0, g_i at V), which a stack's loops ask for as much as for curved
loading; the smooth saturation p takes the place of A04's dead zones (7.7). Creep is a sum of first
order lags in the manner of Krejci and Kuhnen (2001), driven by the voltage. The stroke is that at
the end of the sample that the voltage is held for, and `lead` is what it is ahead of the rest of
the equation there (behind, where it is negative). Zero stroke is that of a stack without voltage
and memory. A new stack, whose first loading is no stop operator's, settles some other way off it;
one cycle over the whole range wipes that out.

The inverse (`inverse_modulated_stops`) exists where z rises with v whatever the memory, for which
the slope

    p'(a) + lead p_1 / T - sum ((1 - a) f_i + a g_i) - sum |g_i - f_i| r_i / V

is a lower bound; and where thresholds rise.

| symbol | field | meaning |
| --- | --- | --- |
| v, z | volts, stroke | voltage held over the sample, stroke at its end |
| V | span | voltage of a = 1 |
| p | polynomial | stroke of loading without hysteresis, by powers of a |
| r_i | thresholds | half widths of the plays, rising |
| f_i, g_i | weights_low, weights_high | weights of the stops at a = 0 and a = 1 |
| k_j, tau_j | creep, creep_time | share and time of creep |
| H_i | plays | memory of the stack |
| c_j | crept | share of the span that has been crept through |
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, Inputs, condition, real
from fmu_src.math.pairwise import pairwise_sum
from fmu_src.piezo.prandtl_ishlinskii import UNDEFINED

STOPS = 12
"""N; a smaller order is one with weights of 0."""
CREEP_TIMES = (3e-3, 30e-3, 0.3, 3.0, 30.0)
"""A decade each [s]."""
LAGS = len(CREEP_TIMES)
SMALLEST_SLOPE = 0.01
"""Least slope, in nominal strokes per volt, for which the operator counts as invertible."""
NOMINAL = design.STACK_STROKE / design.STACK_VOLTS
"""Stroke per volt by the data sheet [m/V]."""


POLYNOMIAL = (2.247e-5, -5.96e-7, -5.173e-7)
THRESHOLDS = (0.9382, 2.844, 5.441, 8.621, 12.32, 16.49, 21.11, 26.14, 31.55, 37.35, 43.5, 50.0)
WEIGHTS_LOW = (
    1.111e-6, 2.108e-6, 1.235e-6, 1.871e-6, 1.302e-6, 1.952e-6,
    1.8e-6, 1.43e-6, 2.03e-6, 4.783e-7, 2.951e-6, 0.0,
)  # fmt: skip
WEIGHTS_HIGH = (
    5.006e-7, 1.243e-6, 1.059e-6, 2.046e-6, 3.66e-7, 1.37e-6,
    1.272e-6, 9.747e-7, 1.837e-6, 9.381e-7, 2.533e-6, 6.739e-7,
)  # fmt: skip
CREEP = (1.405e-7, 4.443e-7, 3.851e-7, 2.521e-7, 2.822e-7)
LEAD = 9.307e-5


class Stops(Parameters):
    """Parameters of one stack.

    Starts are what `steadytip identify hysteresis` makes of its own excitation, recorded with
    0.07 um rms of sensor noise from a stack that it knows nothing else of; the mean of six
    recordings.
    """

    span = real("V", "V, voltage of a = 1", start=design.STACK_VOLTS, min=0.1, max=1000.0)
    polynomial = real(
        "m", "p, loading by powers of a, from 1", shape=3, start=POLYNOMIAL, within=1e-2
    )
    thresholds = real(
        "V",
        "r, half widths of the plays, rising",
        shape=STOPS,
        start=THRESHOLDS,
        min=0.0,
        max=1000.0,
    )
    weights_low = real(
        "m", "f, weights of the stops at a = 0", shape=STOPS, start=WEIGHTS_LOW, min=0.0, max=1e-2
    )
    weights_high = real(
        "m", "g, weights of the stops at a = 1", shape=STOPS, start=WEIGHTS_HIGH, min=0.0, max=1e-2
    )
    creep = real("m", "k, weights of creep", shape=LAGS, start=CREEP, within=1e-2)
    creep_time = real("s", "tau", shape=LAGS, start=CREEP_TIMES, min=1e-3, max=1e5)
    lead = real("s", "lead of the stroke at the end of a sample", start=LEAD, within=1.0)


class In(Inputs):
    """Drive."""

    volts = real("V", "v, voltage held over the sample", within=500.0)


class Memory(State):
    """Memory of a stack."""

    plays = real("V", "H, outputs of the plays", shape=STOPS)
    crept = real(None, "c, share of the span crept through", shape=LAGS)
    volts = real("V", "voltage of the sample before")


class Out(Outputs):
    """Response."""

    stroke = real("m", "z, stroke at the end of the sample")


class Constants(Derived):
    """Constants of the operator, computed from the parameters."""

    left = real(None, "what is left of creep's distance after a sample", shape=LAGS)
    steepness = real("m", "lead p_1 / T", start=0.0)
    share = real("1/V", "1 / V, which divides by the span")
    low_sum = real("m", "sum of f")
    high_sum = real("m", "sum of g")
    smallest_slope = real("m/V", "lower bound of the slope of stroke over voltage")
    defined = condition("whether the operator has an inverse", UNDEFINED)


def derive(p: Stops, T: float) -> Constants:
    """Compute the transition of creep, and whether there is an inverse."""
    steepness = p.lead * p.polynomial[0] / T
    bend = ca.dot(ca.fabs(p.weights_high - p.weights_low), p.thresholds) / p.span
    slopes = [
        p.polynomial[0] + a * (2 * p.polynomial[1] + a * 3 * p.polynomial[2])
        - (1 - a) * ca.sum1(p.weights_low) - a * ca.sum1(p.weights_high)
        for a in np.linspace(0.0, 1.0, 11)
    ]  # fmt: skip
    smallest = (ca.mmin(ca.vertcat(*slopes)) + steepness - bend) / p.span
    rising = ca.logic_and(p.thresholds[0] > 0, ca.mmin(p.thresholds[1:] - p.thresholds[:-1]) > 0)
    # A lag that is more than half of what moves at once makes the inverse swing, then grow.
    steady = smallest * p.span > -2 * steepness
    enough = smallest >= SMALLEST_SLOPE * NOMINAL * design.STACK_VOLTS / p.span
    return Constants(
        left=ca.exp(-T / p.creep_time),
        steepness=steepness,
        share=1 / p.span,
        low_sum=ca.sum1(p.weights_low),
        high_sum=ca.sum1(p.weights_high),
        smallest_slope=smallest,
        defined=ca.logic_and(ca.logic_and(rising, steady), enough),
    )


def remember(p: Stops, derived: Constants, volts: Any, x: Memory) -> Memory:
    """Return the memory after a voltage has been held for a sample."""
    return Memory(
        plays=ca.fmax(volts - p.thresholds, ca.fmin(volts + p.thresholds, x.plays)),
        crept=creep(p, derived, x),
        volts=volts,
    )


def resting(p: Stops, volts: Any) -> Memory:
    """Return the memory of a stack that has gone from 0 V to a voltage and rested there."""
    plays = ca.fmax(volts - p.thresholds, ca.fmin(volts + p.thresholds, 0.0))
    return Memory(plays=plays, crept=ca.repmat(volts / p.span, LAGS, 1), volts=volts)


def creep(p: Stops, derived: Constants, x: Memory) -> ca.SX:
    """Return the creep at the end of a sample, which its voltage does not move yet, (LAGS,)."""
    aim = x.volts * derived.share
    return aim + (x.crept - aim) * derived.left


def settled(p: Stops, derived: Constants, x: Memory) -> ca.SX:
    """Return the part of the stroke that does not depend on the voltage of this sample [m]."""
    crept = pairwise_sum(p.creep * creep(p, derived, x))
    return crept - derived.steepness * (x.volts * derived.share)


def loading(p: Stops, a: Any) -> ca.SX:
    """Return the stroke without hysteresis, creep and lead at a share of the span [m]."""
    return a * (p.polynomial[0] + a * (p.polynomial[1] + a * p.polynomial[2]))


def step(p: Stops, u: In, x: Memory, T: float, derived: Constants) -> tuple[Memory, Out]:
    """Compute one sample."""
    following = remember(p, derived, u.volts, x)
    a = u.volts * derived.share
    left = u.volts - following.plays
    low, high = pairwise_sum(p.weights_low * left), pairwise_sum(p.weights_high * left)
    held = ((1 - a) * low + a * high) * derived.share
    stroke = settled(p, derived, x) + derived.steepness * a + loading(p, a) - held
    return following, Out(stroke=stroke)


MODEL = Model.of_step("ModulatedStops", step, sample_period=1e-3, derive=derive)
