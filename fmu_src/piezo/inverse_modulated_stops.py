"""Step-wise exact inverse of modulated stops: voltage that gives a stroke at the next sample.

    v    : z(v; memory) = y / gain                       solved exactly at every sample
    y    = demand, a horizon h ahead                     `demand`
    z    = modulated stops                               the operator of `modulated_stops`

For a given memory the operator is a cubic between break points H_i -+ r_i, and it rises. So where
no break point lies between the last voltage and the next, the cubic there is solved by Newton's
method at once. Else the values at all break points are laid out by running sums, the two that
enclose y are picked, and the cubic between them is solved, from a place it cannot leave: no search
that could end early. The memory that is carried is the operator's own, moved by the voltage really
sent; it never parts from the stack's for a voltage limit or a change of the gain.

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
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.functions import by_elements
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, Inputs, boolean, real
from fmu_src.math.pairwise import pairwise_min, pairwise_sum
from fmu_src.piezo import demand, modulated_stops
from fmu_src.piezo.inverse_prandtl_ishlinskii import Range
from fmu_src.piezo.modulated_stops import Constants, Memory, Stops, settled

SAMPLE_PERIOD = 1e-3
NEWTON_STEPS = 5
"""The cubic bends by some percent between two break points; each step squares what is left."""
FEW_STEPS, SMALL_STEP = 3, 1e-8
"""From a voltage that is near already; the last of them squares a share of the span this small."""
TOLERANCE = 0.1e-9
"""Stroke by which a solution may miss the demand before it counts as limited [m]."""
CORNER = 2.0
"""Corner of the high-pass ahead of the adaptation [Hz]: below tremor, above creep."""
LARGEST_GAIN = 1.5
"""Largest gain of the adaptation, and the reciprocal of the smallest."""
SAME = 1e-14
"""Share of the span by which rounding may keep a play from its end."""
SMALLEST_POWER = (0.05e-6) ** 2
"""Least mean square of the demand that the adaptation counts with [m2]: a rest teaches nothing."""


class Params(Parameters):
    """The operator to invert, the amplifier, how far to look ahead, and adaptation."""

    operator: Any = Stops
    amplifier: Any = Range
    horizon = demand.horizon(SAMPLE_PERIOD)
    adaptation_time = real("s", "tau, time of the gain's adaptation; 0: none", min=0.0, max=1e4)


class In(Inputs):
    """Stroke wanted, and stroke measured."""

    stroke = real("m", "d, stroke wanted", within=1e-3)
    measured = real("m", "m, stroke measured", within=1e-3)
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
    """Voltage to send."""

    volts = real("V", "v, voltage to send")
    limited = boolean("whether the voltage had to be limited")
    gain = real(None, "gain of the stack over that of the operator", start=1.0)


class Precomputed(Derived):
    """Constants of the operator, computed from the parameters."""

    operator: Any = Constants


@dataclass(frozen=True)
class Piece:
    """The operator between two neighbouring break points: a cubic in the share of the span.

    Args:
        p: the operator.
        derived: what follows from its parameters.
        low, high: what stops at their ends and the plays of the others sum up to, by the weights
            at either end of the range, at a = 0 [m].
        low_slope, high_slope: sums of the weights of those that move [m].
    """

    p: Stops
    derived: Constants
    low: Any
    low_slope: Any
    high: Any
    high_slope: Any

    @property
    def linear(self) -> Any:
        """Slope of the stroke at a = 0 [m]."""
        return self.p.polynomial[0] + self.derived.steepness + self.low - self.low_slope - self.high

    @property
    def square(self) -> Any:
        """Coefficient of a^2 [m]."""
        return self.p.polynomial[1] + self.low_slope - self.high_slope

    def stroke(self, a: Any) -> Any:
        """Return the part of the stroke that depends on this sample's voltage [m]."""
        return a * (self.linear + a * (self.square + a * self.p.polynomial[2])) - self.low

    def solved(self, wanted: Any, start: Any, bottom: Any, top: Any, steps: int) -> tuple[Any, Any]:
        """Solve for the share of the span with the stroke wanted; return it and the last step."""
        least = modulated_stops.SMALLEST_SLOPE * modulated_stops.NOMINAL * self.p.span
        a = before = ca.fmin(ca.fmax(start, bottom), top)
        for _ in range(steps):
            before = a
            slope = self.linear + a * (2 * self.square + a * 3 * self.p.polynomial[2])
            miss = self.stroke(a) - wanted
            a = ca.fmin(ca.fmax(a - miss / ca.fmax(slope, least), bottom), top)
        return a, ca.fabs(a - before)


def nearby(
    p: Stops, derived: Constants, amplifier: Range, stroke: Any, x: Memory
) -> tuple[Any, Any]:
    """Find the voltage for a stroke if no break point lies between it and the last one.

    Args:
        p: the operator.
        derived: what follows from its parameters.
        amplifier: range of the voltage.
        stroke: stroke wanted at the end of the sample [m].
        x: memory of the stack.

    Returns:
        Voltage within the amplifier's range [V], and whether it is the one.
    """
    wanted = stroke - settled(p, derived, x)
    share = derived.share
    here = ca.fmin(ca.fmax(x.volts, amplifier.lowest), amplifier.highest)
    low, high = (-share * pairwise_sum(w * x.plays) for w in (p.weights_low, p.weights_high))
    resting = Piece(p, derived, low, derived.low_sum, high, derived.high_sum)
    side = ca.if_else(resting.stroke(share * here) < wanted, 1.0, -1.0)
    # How far each play is from its end in the direction of the voltage [V]. Those that are there
    # hold back as much as here.
    way = (p.thresholds + side * x.plays) - side * here
    ended = way <= SAME * p.span
    low_ended, high_ended = (
        pairwise_sum(ca.if_else(ended, w, 0.0)) for w in (p.weights_low, p.weights_high)
    )
    ahead = Piece(
        p,
        derived,
        low + share * here * low_ended,
        derived.low_sum - low_ended,
        high + share * here * high_ended,
        derived.high_sum - high_ended,
    )
    limit = ca.if_else(side > 0, amplifier.highest - here, here - amplifier.lowest)
    reach = pairwise_min(ca.vertcat(limit, ca.if_else(ended, limit, way)))
    end = share * (here + side * reach)
    bottom, top = ca.fmin(share * here, end), ca.fmax(share * here, end)
    a, last = ahead.solved(wanted, share * here, bottom, top, FEW_STEPS)
    reached = side * (ahead.stroke(end) - wanted) >= 0
    return a * p.span, ca.logic_and(ca.logic_or(reached, reach >= limit), last <= SMALL_STEP)


def anywhere(p: Stops, derived: Constants, amplifier: Range, stroke: Any, x: Memory) -> Any:
    """Find the voltage for a stroke within the amplifier's range, across break points [V].

    Args:
        p: the operator.
        derived: what follows from its parameters.
        amplifier: range of the voltage.
        stroke: stroke wanted at the end of the sample [m].
        x: memory of the stack.
    """
    wanted = stroke - settled(p, derived, x)
    r, plays = p.thresholds * derived.share, x.plays * derived.share
    lowest, highest = amplifier.lowest * derived.share, amplifier.highest * derived.share

    def value(a: Any, low: Any, low_slope: Any, high: Any, high_slope: Any) -> Any:
        """Return the stroke at a, with stops of low + low_slope a and high + high_slope a."""
        held = (1 - a) * (low + low_slope * a) + a * (high + high_slope * a)
        return modulated_stops.loading(p, a) + derived.steepness * a - held

    def at_corners(side: float) -> tuple[Any, Any]:
        """Return the break points on one side of the memory, and the strokes there.

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
    sums = []
    for weights in (p.weights_low, p.weights_high):
        sums += [ca.dot(weights, still), ca.sum1(ca.if_else(ended, 0.0, weights))]
    between = Piece(p, derived, *sums)
    a, _ = between.solved(wanted, x.volts * derived.share, bottom, top, NEWTON_STEPS)
    return a * p.span


def _solving() -> ca.Function:
    """Record (operator, constants, range, stroke, memory) -> volts."""
    records = (Stops, Constants, Range, 1, Memory)
    near = by_elements("nearby", nearby, *records)
    far = by_elements("anywhere", anywhere, *records)
    given = near.mx_in()
    volts, found = near(*given)
    # The search costs four times as much, and few samples need it: calls are not to be inlined,
    # or both were evaluated.
    solved = ca.if_else(found, volts, far(*given), True)
    return ca.Function("solve_stops", given, [solved], {"never_inline": True})


SOLVE = _solving()


def solve(p: Stops, derived: Constants, amplifier: Range, stroke: Any, x: Memory) -> Any:
    """Find the voltage for a stroke, within the amplifier's range [V].

    Args:
        p: the operator.
        derived: what follows from its parameters.
        amplifier: range of the voltage.
        stroke: stroke wanted at the end of the sample [m].
        x: memory of the stack.
    """
    return SOLVE(p.pack(), derived.pack(), amplifier.pack(), stroke, x.pack())


def drive(
    p: Stops, derived: Constants, amplifier: Range, stroke: Any, x: Memory
) -> tuple[ca.SX, ca.SX, Memory]:
    """Find the voltage that gives a stroke at the end of the sample.

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
    """Compute the constants of the operator."""
    return Precomputed(operator=modulated_stops.derive(p.operator, T))


def step(p: Params, u: In, x: X, T: float, derived: Precomputed) -> tuple[X, Out]:
    """Compute one sample."""
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


MODEL = Model.of_step("InverseModulatedStops", step, sample_period=SAMPLE_PERIOD, derive=derive)
