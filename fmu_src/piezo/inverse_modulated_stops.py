"""Step-wise exact inverse of modulated stops: voltage that gives a stroke at the next sample.

    v    : z(v; memory) = y / gain                       solved exactly at every sample
    y    = demand, a horizon h ahead                     `demand`
    z    = modulated stops                               the operator of `modulated_stops`

For a given memory the operator is a cubic between break points H_i -+ r_i, and it rises. So the
values at all break points are laid out by running sums, the two that enclose y are picked, and the
cubic between them is solved by Newton's method from a place it cannot leave: no search that could
end early. The memory that is carried is the operator's own, moved by the voltage really sent; it
never parts from the stack's for a voltage limit or a change of the gain.

Gain adaptation, for an instrument that measures its stroke: where `adaptation_time` is not 0 and
`measured_valid`, with both signals above CORNER,

    gain <- gain (1 + (T / tau) (m - d) d / mean(d^2))

follows a drift of the stack's gain, slowly enough to see nothing of sensor noise.

| symbol | field | meaning |
| --- | --- | --- |
| d | stroke | stroke wanted, now |
| h T | horizon | how far ahead of the demand the voltage has to be |
| m | measured | stroke measured, now |
| tau | adaptation_time | time of the adaptation |
| gain | gain | stack's gain over that of the operator |
| v | volts | voltage to send |
| H_i, r_i, f_i, g_i, p | operator.* | as in `modulated_stops` |
"""

import math
from typing import Any

import casadi as ca

from fmu_src.kit import Derived, Inputs, Model, Outputs, Parameters, State, boolean, real
from fmu_src.piezo import demand, modulated_stops
from fmu_src.piezo.inverse_prandtl_ishlinskii import Range
from fmu_src.piezo.modulated_stops import Constants, Memory, Stops, settled

SAMPLE_PERIOD = 1e-3
NEWTON_STEPS = 5
"""The cubic bends by some percent between two break points; each step squares what is left."""
TOLERANCE = 0.1e-9
"""Stroke by which a solution may miss the demand before it counts as limited [m]."""
CORNER = 2.0
"""Of the high-pass ahead of the adaptation [Hz]: below tremor, above creep."""
LARGEST_GAIN = 1.5
"""Of the adaptation, and the reciprocal of the smallest."""
SMALLEST_POWER = (0.05e-6) ** 2
"""Least mean square of the demand that the adaptation counts with [m2]: a rest teaches nothing."""


class Params(Parameters):
    """The operator to invert, the amplifier, how far to look ahead, and adaptation."""

    operator: Any = Stops
    amplifier: Any = Range
    horizon = demand.horizon(SAMPLE_PERIOD)
    adaptation_time = real("s", "tau, time of the gain's adaptation; 0: none", min=0.0, max=1e4)


class In(Inputs):
    """What is wanted, and what is seen of it."""

    stroke = real("m", "d, stroke wanted", min=-1e-3, max=1e-3)
    measured = real("m", "m, stroke measured", min=-1e-3, max=1e-3)
    measured_valid = boolean("whether `measured` can be learnt from", start=False)


class X(State):
    """Memory of the stack, of the demand, and of the adaptation."""

    stack: Any = Memory
    demand: Any = demand.Demand
    gain = real(None, "gain of the stack over that of the operator", start=1.0, min=0.1, max=10.0)
    demand_mean = real("m", "demand below the corner")
    measured_mean = real("m", "measured stroke below the corner")
    power = real("m2", "mean square of the demand above the corner")


class Out(Outputs):
    """What to send."""

    volts = real("V", "v, voltage to send")
    limited = boolean("whether the voltage had to be limited")
    gain = real(None, "gain of the stack over that of the operator", start=1.0)


class Precomputed(Derived):
    """What follows from the parameters."""

    operator: Any = Constants


def solve(p: Stops, derived: Constants, amplifier: Range, stroke: Any, x: Memory) -> ca.SX:
    """Voltage at which the operator gives a stroke, within the amplifier's range [V].

    Args:
        p: the operator.
        derived: what follows from its parameters.
        amplifier: range of the voltage.
        stroke: stroke wanted at the end of the sample [m].
        x: memory of the stack.
    """
    wanted = stroke - settled(p, derived, x)
    r, plays = p.thresholds / p.span, x.plays / p.span
    lowest, highest = amplifier.lowest / p.span, amplifier.highest / p.span

    def value(a: Any, low: Any, low_slope: Any, high: Any, high_slope: Any) -> Any:
        """Stroke at a, where the stops sum up to low + low_slope a, and high + high_slope a."""
        held = (1 - a) * (low + low_slope * a) + a * (high + high_slope * a)
        return modulated_stops.loading(p, a) + derived.steepness * a - held

    def at_corners(side: float) -> tuple[Any, Any]:
        """Break points on one side of the memory, and the strokes there.

        Those of wider plays lie farther out, so that at the i-th one the stops up to i are at
        their ends, and the others still run with the voltage.
        """
        a = plays + side * r
        sums = []
        for weights in (p.weights_low, p.weights_high):
            ended = ca.cumsum(weights * r)
            running = ca.sum1(weights) - ca.cumsum(weights)
            behind = ca.dot(weights, plays) - ca.cumsum(weights * plays)
            sums += [side * ended - behind, running]
        return a, value(a, *sums)

    bottom: Any = lowest
    top: Any = highest
    for side in (-1.0, 1.0):
        corners, strokes = at_corners(side)
        bottom = ca.fmax(bottom, ca.mmax(ca.if_else(strokes <= wanted, corners, lowest)))
        top = ca.fmin(top, ca.mmin(ca.if_else(strokes >= wanted, corners, highest)))
    top = ca.fmax(top, bottom)

    middle = (bottom + top) / 2
    ended = ca.fabs(middle - plays) > r
    still = ca.if_else(ended, ca.sign(middle - plays) * r, -plays)
    low, high = ca.dot(p.weights_low, still), ca.dot(p.weights_high, still)
    low_slope = ca.sum1(ca.if_else(ended, 0.0, p.weights_low))
    high_slope = ca.sum1(ca.if_else(ended, 0.0, p.weights_high))
    # The stroke by powers of a between the two.
    cubic = p.polynomial[2]
    square = p.polynomial[1] + low_slope - high_slope
    linear = p.polynomial[0] + derived.steepness + low - low_slope - high
    least = modulated_stops.SMALLEST_SLOPE * modulated_stops.NOMINAL * p.span
    a = ca.fmin(ca.fmax(x.volts / p.span, bottom), top)
    for _ in range(NEWTON_STEPS):
        miss = a * (linear + a * (square + a * cubic)) - low - wanted
        slope = linear + a * (2 * square + a * 3 * cubic)
        a = ca.fmin(ca.fmax(a - miss / ca.fmax(slope, least), bottom), top)
    return a * p.span


def drive(
    p: Stops, derived: Constants, amplifier: Range, stroke: Any, x: Memory
) -> tuple[ca.SX, ca.SX, Memory]:
    """Voltage that gives a stroke at the end of the sample.

    Args:
        p: the operator.
        derived: what follows from its parameters.
        amplifier: range of the voltage.
        stroke: stroke wanted [m].
        x: memory of the stack.

    Returns:
        Voltage within the range [V], whether it had to be limited, and the memory after it has
        been sent.
    """
    volts = solve(p, derived, amplifier, stroke, x)
    following, out = modulated_stops.step(
        p, modulated_stops.In(volts=volts), x, SAMPLE_PERIOD, derived
    )
    return volts, ca.fabs(out.stroke - stroke) > TOLERANCE, following


def derive(p: Params, T: float) -> Precomputed:
    """Constants of the operator."""
    return Precomputed(operator=modulated_stops.derive(p.operator, T))


def step(p: Params, u: In, x: X, T: float, derived: Precomputed) -> tuple[X, Out]:
    """One sample."""
    # A measured stroke belongs to the demand of the same instant; one that is ahead already, to
    # the sample before.
    answered = ca.if_else(p.horizon > 0, u.stroke, x.demand.before)
    share = 1 - math.exp(-2 * math.pi * CORNER * T)
    demand_mean = x.demand_mean + share * (answered - x.demand_mean)
    measured_mean = x.measured_mean + share * (u.measured - x.measured_mean)
    d, m = answered - demand_mean, u.measured - measured_mean
    learning = ca.logic_and(
        ca.logic_and(p.adaptation_time > 0, u.measured_valid), x.demand.started >= 2
    )
    pace = ca.if_else(learning, T / ca.fmax(p.adaptation_time, T), 0.0)
    power = x.power + pace * (d**2 - x.power)
    change = pace * (m - d) * d / (power + SMALLEST_POWER)
    gain = ca.fmin(ca.fmax(x.gain * (1 + change), 1 / LARGEST_GAIN), LARGEST_GAIN)

    wanted, _ = demand.ahead(u.stroke, x.demand, p.horizon / T)
    volts, limited, stack = drive(p.operator, derived.operator, p.amplifier, wanted / gain, x.stack)
    following = X(
        stack=stack,
        demand=demand.seen(u.stroke, x.demand),
        gain=gain,
        demand_mean=demand_mean,
        measured_mean=measured_mean,
        power=power,
    )
    return following, Out(volts=volts, limited=limited, gain=gain)


MODEL = Model(
    "InverseModulatedStops",
    step,
    Params,
    In,
    X,
    Out,
    sample_period=SAMPLE_PERIOD,
    derived=Precomputed,
    derive=derive,
)
