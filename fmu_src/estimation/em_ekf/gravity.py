"""Correction by the specific force, weaker where the hand accelerates (RK 4)."""

from typing import Any, NamedTuple

import casadi as ca

from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation.em_ekf.interface import Acceleration, Params, X
from fmu_src.estimation.em_ekf.prediction import Due
from fmu_src.estimation.em_ekf.state import FILTER, Nominal, gravity_residual
from fmu_src.filters.error_state import correct_if
from fmu_src.math import rotations

SLOW, FADING = 1.0, 0.2
"""Times of the slow mean, and in which a seen acceleration is forgotten [s] (chosen)."""


def accelerating(q: Any, force: Any, noise: Any, h: Any, x: Any) -> Acceleration:
    """Measure how much the specific force in W departs from its slow mean.

    Args:
        q: attitude.
        force: mean specific force over h, bias taken off, (3,) [m/s2].
        noise: its standard deviation [m/s2].
        h: time since the last one [s].
        x: what was seen.
    """
    now = rotations.matrix(q) @ force
    slow = ca.if_else(x.seen, x.slow + ca.fmin(h / SLOW, 1) * (now - x.slow), now)
    apart = ca.sqrt(ca.sumsqr(now - slow))
    level = ca.fmax(x.level * ca.exp(-h / FADING), ca.fmax(apart - 5 * noise, 0))
    return Acceleration(slow=slow, level=level, seen=1)


class Gravity(NamedTuple):
    """Correction by the specific force.

    Attributes:
        nominal, P: state and covariance after it.
        nis: normalised innovation squared.
        by: whether it was made.
        acceleration: next `Acceleration`, packed.
        accelerated: whether the hand accelerates.
    """

    nominal: Any
    P: Any
    nis: Any
    by: Any
    acceleration: Any
    accelerated: Any


def correct_by_gravity(p: Params, x: X, d: Due, nominal: Any, P: Any) -> Gravity:
    """Return the correction by the mean specific force, weaker where the hand accelerates."""
    i, e, g = p.inertial, p.tracker, d.g
    q = Nominal.unpack(nominal).attitude
    noise_f = i.force_noise / ca.sqrt(2 * g.waited)
    force = d.mean[:3] - Nominal.unpack(nominal).force_bias
    (seen,) = sources.recorded(
        "accelerating",
        lambda q, f, n, h, a: accelerating(q, f, n, h, Acceleration.unpack(a)).pack(),
        q,
        force,
        noise_f,
        g.waited,
        x.acceleration.pack(),
    )
    acceleration = ca.if_else(d.aided, seen, x.acceleration.pack())
    level = Acceleration.unpack(acceleration).level
    calm = ca.fabs(ca.sqrt(ca.sumsqr(d.mean[:3])) - i.gravity) < i.quiet
    resting = noise_f**2 + i.hand_density**2 / (2 * g.waited)
    moving = ca.if_else(e.hard_switching, 0, i.hand_gain * level) ** 2
    accelerated = ca.if_else(e.hard_switching, ca.logic_not(calm), moving > resting)
    R_f = (resting + moving) * ca.DM.eye(3)
    by_gravity = ca.logic_and(d.aided, ca.logic_not(ca.logic_and(e.hard_switching, accelerated)))
    known = ca.vertcat(d.mean[:3], i.gravity)
    nominal, P, nis = correct_if(
        by_gravity, FILTER, gravity_residual, nominal, P, known, R_f, e.gate
    )
    return Gravity(nominal, P, nis, by_gravity, acceleration, accelerated)
