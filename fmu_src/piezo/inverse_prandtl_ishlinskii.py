"""Inverse of the modified Prandtl-Ishlinskii operator: voltage that gives a stroke (A04 7.2.4).

    y    = demand z, a horizon h ahead                                           `demand`
    H'_i = W_i H_i + sum_{j>i} w_j H_j             memory of the inverse         (7.13)
    q    = sum s'_j S'_j(y)                        S' with thresholds d'         (7.14)
    v    = sum w'_i max(q - r'_i, min(q + r'_i, H'_i))                           (7.12)
    H_i <- max(v - r_i, min(v + r_i, H_i))         v limited to the amplifier's range

What is remembered from sample to sample is the memory H of the forward operator, moved by the
voltage that was really sent; the inverse's own memory follows from it at every sample by (7.13).
So the two never part: not at a voltage limit, and not when weights change on the way.

The inverse exists where both curves rise, W_i = w_0 + ... + w_i and Z_j = s_0 + ... + s_j all above
SMALLEST_SLOPE (the latter counted in the nominal stroke per volt), and thresholds rise. Elsewhere
`defined` is false and slopes are raised to that bound, so that the voltage stays finite.

| symbol | field | meaning |
| --- | --- | --- |
| z | stroke | stroke wanted |
| v | volts | voltage, within amplifier.lowest and amplifier.highest |
| w', r', s', d' | inverse.* | weights and thresholds of the inverse, from those of the operator |
| W | inverse.slopes | slopes of the operator's loading curve |
| h T | horizon | how far ahead of the demand the voltage has to be |
| others | | as in `prandtl_ishlinskii` |
"""

from typing import Any

import casadi as ca

from fmu_src.device import design
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, Inputs, boolean, condition, real
from fmu_src.piezo.demand import Demand, ahead, horizon, seen
from fmu_src.piezo.prandtl_ishlinskii import (
    DEAD_ZONES,
    NOMINAL,
    PLAYS,
    UNDEFINED,
    Hysteresis,
    remember,
    stops,
)

SMALLEST_SLOPE = 0.01
"""Least slope of both curves for which the inverse counts as defined: a hundredfold gain."""
ROUNDING = 1e-9
"""Voltage beyond the range that does not count as such [V]."""


class Range(Parameters):
    """Range of the amplifier."""

    lowest = real("V", "smallest voltage sent", start=0.0, min=-200.0, max=0.0)
    highest = real("V", "largest voltage sent", start=design.STACK_VOLTS, min=1.0, max=200.0)


class Params(Parameters):
    """The operator to invert, and the amplifier."""

    hysteresis: Any = Hysteresis
    amplifier: Any = Range
    horizon = horizon(0.0)


class Inverse(Derived):
    """Weights and thresholds of the inverse operator."""

    slopes = real(None, "W, slopes of the loading curve", shape=PLAYS)
    weights = real(None, "w', weights of the inverse's plays", shape=PLAYS)
    thresholds = real("V", "r', half widths of the inverse's plays", shape=PLAYS)
    saturation = real("V/m", "s', weights of the inverse's dead zones", shape=DEAD_ZONES)
    dead_zones = real("m", "d', thresholds of the inverse's dead zones", shape=DEAD_ZONES)
    defined = condition("whether the operator has an inverse", UNDEFINED)


class Precomputed(Derived):
    """Inverse operator, computed from the parameters."""

    inverse: Any = Inverse


class In(Inputs):
    """Stroke wanted."""

    stroke = real("m", "z, stroke wanted", within=1e-3)


class X(State):
    """Memory of the stack and of the demand."""

    plays = real("V", "H, outputs of the forward operator's plays", shape=PLAYS)
    demand: Any = Demand


class Out(Outputs):
    """Voltage to send."""

    volts = real("V", "v, voltage to send")
    limited = boolean("whether the voltage had to be limited")


def invert(p: Hysteresis) -> Inverse:
    """Compute weights and thresholds of the inverse (7.13, 7.14)."""
    slopes, weights, thresholds, plays_rise = _mirror(p.weights, p.thresholds, SMALLEST_SLOPE)
    _, saturation, dead_zones, zones_rise = _mirror(
        p.saturation, p.dead_zones, SMALLEST_SLOPE * NOMINAL
    )
    return Inverse(
        slopes=slopes,
        weights=weights,
        thresholds=thresholds,
        saturation=saturation,
        dead_zones=dead_zones,
        defined=ca.logic_and(plays_rise, zones_rise),
    )


def _mirror(weights: Any, thresholds: Any, smallest: float) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Reflect a piecewise linear curve about the 45 degree line.

    Its corners lie at the thresholds, its slopes are the running sums of the weights. The reflected
    curve has its corners at the curve's values there, and the reciprocal slopes: A04's (7.13) and
    (7.14), written by slopes.

    Returns:
        Slopes of the curve, weights and thresholds of the reflected one, and whether the curve
        has one.
    """
    sums = ca.cumsum(weights)
    gaps = thresholds[1:] - thresholds[:-1]
    slopes = ca.fmax(sums, smallest)
    rises = ca.logic_and(ca.mmin(sums) >= smallest, ca.mmin(gaps) > 0)
    exists = ca.logic_and(rises, thresholds[0] == 0)
    values = ca.vertcat(0.0, ca.cumsum(slopes[:-1] * gaps))
    reciprocal = 1 / slopes
    return slopes, ca.vertcat(reciprocal[0], reciprocal[1:] - reciprocal[:-1]), values, exists


def drive(
    p: Hysteresis, inverse: Inverse, amplifier: Range, stroke: Any, plays: Any, there: Any = 0.0
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Find the voltage that gives a stroke.

    Args:
        p: the operator.
        inverse: its inverse.
        amplifier: range of the voltage.
        stroke: z [m].
        plays: H, memory of the forward operator, (PLAYS,) [V].
        there: part of y that is there whatever the voltage [V].

    Returns:
        Voltage v within the range [V], whether it had to be limited, and the memory after it has
        been sent, (PLAYS,) [V].
    """
    # sum_{j>=i} w_j H_j, so that H'_i = W_{i-1} H_i + that; the weights are those of the slopes
    # that were inverted.
    weights = ca.vertcat(inverse.slopes[0], inverse.slopes[1:] - inverse.slopes[:-1])
    carried = ca.cumsum((weights * plays)[::-1])[::-1]
    memory = ca.vertcat(0.0, inverse.slopes[:-1]) * plays + carried
    q = ca.dot(inverse.saturation, stops(stroke, inverse.dead_zones)) - there
    wanted = ca.dot(
        inverse.weights,
        ca.fmax(q - inverse.thresholds, ca.fmin(q + inverse.thresholds, memory)),
    )
    volts = ca.fmin(ca.fmax(wanted, amplifier.lowest), amplifier.highest)
    return volts, ca.fabs(wanted - volts) > ROUNDING, remember(p, volts, plays)


def derive(p: Params, T: float) -> Precomputed:
    """Compute the inverse operator."""
    return Precomputed(inverse=invert(p.hysteresis))


def step(p: Params, u: In, x: X, T: float, derived: Precomputed) -> tuple[X, Out]:
    """Compute one sample."""
    wanted, _ = ahead(u.stroke, x.demand, p.horizon / T)
    volts, limited, plays = drive(p.hysteresis, derived.inverse, p.amplifier, wanted, x.plays)
    return X(plays=plays, demand=seen(u.stroke, x.demand)), Out(volts=volts, limited=limited)


MODEL = Model.of_step("InversePrandtlIshlinskii", step, sample_period=1e-3, derive=derive)
