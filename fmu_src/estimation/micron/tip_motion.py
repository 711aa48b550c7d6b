"""Tip velocity and displacement from its acceleration, free of drift.

| symbol | meaning |
| --- | --- |
| a | tip acceleration in W, as lagged by the sensors' output filter [m/s2] |
| c | corner of the wash-out [rad/s] |
| m | slow mean of a [m/s2] |
| v, d | velocity and displacement, lagged as a is [m/s, m] |
| tau | time constant of the output filter [s] |

    m' = c (a - m),     v' = (a - m) - c v - c^2 d,     d' = v

is double integration with a third-order Butterworth high-pass: an offset of a, as a tilt error of
gravity leaves, dies out of d, and slow noise stays bounded. The price is a phase lead of 2 c / w at
the frequency w. Trapezoidal rule: no phase of its own.

A signal behind a lag, y = x - tau y', is put right without differentiating: the displacement is one
integral behind the velocity, so x_d = d + tau v, x_v = v + tau a. Only the acceleration needs a
derivative, x_a = a + tau a', band-limited.
"""

from typing import Any, NamedTuple

import casadi as ca

from fmu_src.device import sensing_kinematics as kinematics
from fmu_src.estimation.micron import attitude_filter
from fmu_src.estimation.micron.prediction import Turn, fade
from fmu_src.estimation.micron.sample import Sample
from fmu_src.estimation.micron.start import Start
from fmu_src.math import rotations

STATES = 3
"""m, v, d for each axis."""


def discretise(corner: Any, T: float) -> tuple[ca.SX, ca.SX]:
    """Return A (3, 3), B (3,) of the trapezoidal rule x[k] = A x[k-1] + B (a[k] + a[k-1])."""
    A = ca.vertcat(
        ca.horzcat(-corner, 0, 0), ca.horzcat(-1, -corner, -(corner**2)), ca.horzcat(0, 1, 0)
    )
    B = ca.vertcat(corner, 1, 0)
    left = ca.inv_minor(ca.SX.eye(3) - A * (T / 2))
    return left @ (ca.SX.eye(3) + A * (T / 2)), left @ B * (T / 2)


def advance(x: Any, A: Any, B: Any, a: Any, a_before: Any) -> ca.SX:
    """Return the states one sample later for all axes, (3 states, 3 axes)."""
    return A @ x + B @ (a + a_before).T


class TipMotion(NamedTuple):
    """Motion of the tip in W.

    Attributes:
        a: acceleration without gravity, lagged, (3,) [m/s2].
        a_wide: the same with the lag put right, band-limited, (3,) [m/s2].
        motion: m, v, d for each axis, lagged, (3, 3).
        velocity: washed out, lag put right, (3,) [m/s].
        displacement: washed out, lag put right, (3,) [m].
    """

    a: Any
    a_wide: Any
    motion: Any
    velocity: Any
    displacement: Any


def follow_tip(
    p: Any, s: Sample, start: Start, turn: Turn, q: Any, b: Any, x: Any, T: float, derived: Any
) -> TipMotion:
    """Return the tip's motion for the corrected attitude q, (4,), and bias b, (3,) [rad/s].

    Gravity is removed before any integration (A04 2.26 with its sign).
    """
    tau = p.accelerometer.lag
    geometry = kinematics.Geometry.of(p.geometry)
    rate = turn.rate_measured - b
    force = kinematics.tip_force(s.f, turn.alpha, rate, geometry, p.accelerometer.density**2)
    # Specific force and attitude must be of one age: gravity turns in the body while it is lagged.
    q_lagged = attitude_filter.predict_attitude(q, turn.w_i - b, -tau)
    a = rotations.matrix(q_lagged) @ force - ca.vertcat(0, 0, p.gravity)
    a = ca.if_else(turn.usable, a, fade(T) * x.a)
    a_before = ca.if_else(start.going, x.a, a)
    blank = ca.vertcat(a.T, ca.SX.zeros(2, 3))
    motion = ca.if_else(
        start.going,
        advance(x.motion, derived.integrator, derived.integrator_input, a, a_before),
        blank,
    )
    velocity = motion[1, :].T + tau * (a - motion[0, :].T)
    displacement = motion[2, :].T + tau * motion[1, :].T
    # Lead (1 + tau s) / (1 + s / w_a), trapezoidal
    slow = 1 / (2 * ca.pi * p.acceleration_bandwidth)
    lead = (2 * tau / T * (a - a_before) + a + a_before - (1 - 2 * slow / T) * x.a_wide) / (
        1 + 2 * slow / T
    )
    return TipMotion(a, ca.if_else(start.going, lead, a), motion, velocity, displacement)
