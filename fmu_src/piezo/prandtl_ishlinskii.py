"""Modified Prandtl-Ishlinskii operator: stroke of a piezo stack with hysteresis (A04 7.2).

    H_i = max(v - r_i, min(v + r_i, H_i))          play, i = 0..n                (7.1)
    y   = sum w_i H_i                                                            (7.4)
    S_0 = y,  S_j = max(y - d_j, 0)                one-sided dead zone, j = 1..m (7.7)
    z   = sum s_j S_j                                                            (7.8, 7.9)

y is the voltage that hysteresis leaves to act: the weights of the plays are pure numbers, those of
the dead zones carry the unit. Slopes of the two curves are the running sums of the weights (7.6).

| symbol | field | meaning |
| --- | --- | --- |
| v | volts | voltage |
| z | stroke | stroke |
| r_i | thresholds | half widths of the plays, rising from r_0 = 0 |
| w_i | weights | weights of the plays |
| d_j | dead_zones | thresholds of the dead zones, rising from d_0 = 0 |
| s_j | saturation | weights of the dead zones |
| H_i | plays | memory of the stack; zero when it has never had a voltage |
"""

from typing import Any

import casadi as ca

from fmu_src.device import design
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, real

PLAYS = 10
"""n + 1 (A04 7.4)."""
DEAD_ZONES = 4
"""m + 1 (A04 7.4)."""
NOMINAL = design.STACK_STROKE / design.STACK_VOLTS
"""Stroke per volt by the data sheet [m/V]; s_0 is held at it, which settles the scale of w."""

UNDEFINED = (
    "the operator has no inverse, for which thresholds must rise and all slopes stay above the "
    "least one; an inverse goes on with slopes that are raised. Identify it again, or correct its "
    "values"
)
"""Warning for parameters without an inverse."""


class Hysteresis(Parameters):
    """Thresholds and weights of one stack.

    Thresholds are A04's (7.4), whose dead zones are taken as volts of y: with s_0 held at the
    nominal stroke per volt, y runs to 100 V at the full stroke. Weights are what
    `steadytip identify hysteresis` makes of its own excitation, recorded with 0.07 um rms of sensor
    noise from a stack that it knows nothing else of; the mean of six recordings.
    """

    thresholds = real(
        "V",
        "r, half widths of the plays, rising from 0",
        shape=PLAYS,
        start=(0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 25.0, 31.0, 38.0, 45.0),
        min=0.0,
        max=200.0,
    )
    weights = real(
        None,
        "w, weights of the plays",
        shape=PLAYS,
        start=(0.4106, 0.1532, 0.1365, 0.0718, 0.1175, 0.0672, 0.1262, 0.1261, 0.122, 0.049),
        within=10.0,
    )
    dead_zones = real(
        "V",
        "d, thresholds of the dead zones, rising from 0",
        shape=DEAD_ZONES,
        start=(0.0, 63.3, 74.8, 87.3),
        min=0.0,
        max=200.0,
    )
    saturation = real(
        "m/V",
        "s, weights of the dead zones",
        shape=DEAD_ZONES,
        start=(NOMINAL, -2.4e-9, -2.5e-9, -1.1e-8),
        within=1e-5,
    )


class In(Inputs):
    """Drive."""

    volts = real("V", "v, voltage across the stack", within=500.0)


class X(State):
    """Memory."""

    plays = real("V", "H, outputs of the plays", shape=PLAYS)


class Out(Outputs):
    """Response."""

    stroke = real("m", "z, stroke")


def remember(p: Hysteresis, volts: Any, plays: Any) -> ca.SX:
    """Return the plays after a voltage has been applied (7.1), (PLAYS,) [V].

    Args:
        p: thresholds.
        volts: v [V].
        plays: H before it, (PLAYS,) [V].
    """
    return ca.fmax(volts - p.thresholds, ca.fmin(volts + p.thresholds, plays))


def respond(p: Hysteresis, plays: Any) -> ca.SX:
    """Return the stroke that belongs to a memory (7.9), scalar [m].

    Args:
        p: thresholds and weights.
        plays: H, (PLAYS,) [V].
    """
    return ca.dot(p.saturation, stops(ca.dot(p.weights, plays), p.dead_zones))


def stops(value: Any, thresholds: Any) -> ca.SX:
    """Apply one-sided dead zones (7.7), the first one open, (DEAD_ZONES,), in the value's unit."""
    return ca.vertcat(value, ca.fmax(value - thresholds[1:], 0.0))


def step(p: Hysteresis, u: In, x: X, T: float) -> tuple[X, Out]:
    """Compute one sample."""
    plays = remember(p, u.volts, x.plays)
    return X(plays=plays), Out(stroke=respond(p, plays))


MODEL = Model.of_step("PrandtlIshlinskii", step, sample_period=1e-3)
