"""Correction by what is known of the rate without vertical or north: rest, and a hand's habits.

At rest there is no rate, and a hand that is not seen does not turn on and on. What lasts for a time
is the same in all samples of it.
"""

from typing import Any, NamedTuple

import casadi as ca

from fmu_src.estimation.micron import attitude_filter, plausibility
from fmu_src.estimation.micron.north import North
from fmu_src.estimation.micron.prediction import Prediction, Turn
from fmu_src.estimation.micron.sample import Sample
from fmu_src.estimation.micron.start import Start
from fmu_src.estimation.micron.vertical import Vertical
from fmu_src.kit.lazy_select import lazy_select

TURN = 0.3
"""Time that a hand turns one way [s]."""
UNUSED = 1e4
"""Variance of what is not measured; no larger, for the sake of single precision."""


class KnownRate(NamedTuple):
    """State after all corrections.

    Attributes:
        P: covariance, (6, 6).
        change: of attitude error and bias by all corrections, (6,).
        at_rest: whether the instrument rests.
        state: next `plausibility.Rest`.
    """

    P: Any
    change: Any
    at_rest: Any
    state: plausibility.Rest


def _take_rate(P: Any, residual: Any, up_B: Any, variances: Any, flags: Any) -> list[Any]:
    """Correct by a rate: all of it, the part about the vertical, or that about the level axes."""
    up = up_B @ up_B.T
    heading = ca.diagcat(up, up)
    everything = ca.SX.eye(6)
    corrected = attitude_filter.correct(
        P,
        residual,
        ca.horzcat(ca.SX.zeros(3, 3), ca.SX.eye(3)),
        variances[0] * (ca.SX.eye(3) - up) + variances[1] * up,
        onto=ca.if_else(flags[0], everything, ca.if_else(flags[1], heading, everything - heading)),
    )
    return [corrected.P, corrected.change]


def correct_rate(
    p: Any,
    s: Sample,
    start: Start,
    turn: Turn,
    before: Prediction,
    tilt: Vertical,
    north: North,
    x: Any,
    T: float,
) -> KnownRate:
    """Return covariance and change after the rate that is known."""
    gates, heard = p.gates, s.alive.field
    white = before.white
    noise = ca.vertcat(white, 4 * white, p.magnetometer.sigma**2 + p.magnetometer.residue**2)
    state, at_rest = plausibility.follow_rest(
        ca.horzcat(s.gravity_B, s.A_D, s.field),
        noise,
        ca.logic_and(turn.usable, heard),
        start.anew,
        gates,
        x.rest,
        T,
    )
    seen_level, seen_north = tilt.correction.taken, north.correction.taken
    resting = gates.rest_rate**2 * gates.rest_time / T
    turning = p.hand_rate**2 * TURN / T
    about_level = ca.if_else(at_rest, resting, ca.if_else(seen_level, UNUSED, turning))
    about_up = ca.if_else(at_rest, resting, ca.if_else(seen_north, UNUSED, turning))
    caught = ca.logic_and(
        plausibility.caught(heard, s.dead_field, north.believed, x.field), start.going
    )
    up = before.heading[:3, :3]
    change = tilt.correction.change + north.correction.change
    widened = north.correction.P + caught * ca.diagcat(
        gates.field**2 / north.level * up, p.hand_rate**2 * up
    )
    of_all = ca.logic_or(at_rest, ca.logic_not(ca.logic_or(seen_level, seen_north)))
    of_up = ca.logic_and(ca.logic_not(of_all), seen_level)
    P, by_rate = lazy_select(
        "rate_known",
        ca.logic_and(
            start.going,
            ca.logic_or(at_rest, ca.logic_not(ca.logic_and(seen_level, seen_north))),
        ),
        _take_rate,
        lambda P, *_: [P, ca.SX.zeros(6)],
        widened,
        turn.rate_measured - before.b - change[3:],
        before.up_B,
        ca.vertcat(about_level, about_up),
        ca.vertcat(of_all, of_up),
    )
    return KnownRate(P, change + by_rate, at_rest, state)
