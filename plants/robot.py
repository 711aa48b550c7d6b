"""Robot's wrist that carries an instrument from one attitude to another and back.

    R  = R_0 R_z(c) R_y(b) R_x(a),   (a, b, c) = start + (end - start) s(t)
    s' = V (1 - cos(pi t / t_r)) / 2  in the ramps,  V  between them,  V = 1 / (t_m - t_r)
    o  = pivot + R arm,   o'' = R (alpha x arm + w x (w x arm))

| symbol | field | meaning |
| --- | --- | --- |
| R | attitude | R(q_WB), body to world |
| R_0 | rest | attitude with all joints at zero |
| a, b, c | start, end | angles of the last three joints: roll, pitch, yaw [rad] |
| s | | share of the way |
| t_m, t_r | move_time, ramp_time | of a move, and of its start and its stop [s] |
| o | body | origin of B in W [m] |
| w, alpha | rate, angular_acceleration | B |

All joints start and stop together and turn at constant rates between (RK IV.A, C23 3.1.3); or with
`one_by_one` each has a third of the move to itself, as a calibration needs it. A move there, a
dwell, a move back, a dwell, and again. The rate has no jumps and the angular acceleration
no steps; the robot does not shake.
"""

import math
from typing import Any

import casadi as ca

from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, boolean, quaternion, real, vector
from fmu_src.math import rotations

JOINTS = 3


class Params(Parameters):
    """Place of the wrist, and its programme."""

    pivot = real("m", "place of the joints in W", shape=3, within=5.0)
    arm = real("m", "from there to the origin of B, in B", shape=3, within=2.0)
    rest = real("rad", "rotation vector of R_0", shape=3, start=0.0, within=math.pi)
    start = real("rad", "roll, pitch and yaw at the start", shape=3, within=2 * math.pi)
    end = real(
        "rad",
        "roll, pitch and yaw at the end",
        shape=3,
        start=(-math.pi / 3, 0.3, -0.4),
        within=2 * math.pi,
    )
    move_time = real("s", "t_m of a move", start=6.0, min=0.02, max=1000.0)
    ramp_time = real(
        "s", "t_r of start and stop, at most half of it", start=0.2, min=0.01, max=10.0
    )
    one_by_one = boolean("whether roll, pitch and yaw move one after the other")
    dwell = real("s", "rest at either end", start=0.5, min=0.0, max=1000.0)


class In(Inputs):
    """Nothing: the robot follows its programme."""


class X(State):
    """Time in the programme."""

    time = real("s", "since the cycle began", min=0.0)


class Out(Outputs):
    """Motion of the body."""

    body = vector("m", "origin of B in W")
    body_acceleration = vector("m/s2", "acceleration of the origin of B, W")
    attitude = quaternion("attitude q_WB")
    rate = vector("rad/s", "body rate in B")
    angular_acceleration = vector("rad/s2", "angular acceleration in B")
    moving = real(None, "rate of the way s', over that between the ramps", min=0.0, max=1.0)


def move(t: Any, length: Any, ramp: Any) -> tuple[Any, Any, Any]:
    """Return the share of the way a time after the start of a move, and two derivatives."""
    speed = 1 / (length - ramp)
    turn = math.pi / ramp

    def ramped(t: Any) -> tuple[Any, Any, Any]:
        t = ca.fmin(ca.fmax(t, 0), ramp)
        way = speed * (t / 2 - ca.sin(turn * t) / (2 * turn))
        return way, speed * (1 - ca.cos(turn * t)) / 2, speed * turn * ca.sin(turn * t) / 2

    begun, ended = ramped(t), ramped(length - t)
    early, late = t < ramp, t > length - ramp

    def joined(first: Any, between: Any, last: Any) -> Any:
        return ca.if_else(early, first, ca.if_else(late, last, between))

    return (
        joined(begun[0], speed * (t - ramp / 2), 1 - ended[0]),
        joined(begun[1], speed, ended[1]),
        joined(begun[2], 0, -ended[2]),
    )


def _wrist() -> ca.Function:
    """Return attitude, rate and angular acceleration of angles (3,) and their two derivatives."""
    angles, rates, accelerations = (ca.SX.sym(letter, 3) for letter in "abc")
    turns = [
        rotations.from_rotation_vector(axis * angle)
        for axis, angle in zip(ca.horzsplit(ca.DM.eye(3)), ca.vertsplit(angles), strict=True)
    ]
    q = rotations.multiply(rotations.multiply(turns[2], turns[1]), turns[0])
    (a, b, _), (da, db, dc) = ca.vertsplit(angles), ca.vertsplit(rates)
    w = ca.vertcat(
        da - dc * ca.sin(b),
        db * ca.cos(a) + dc * ca.cos(b) * ca.sin(a),
        -db * ca.sin(a) + dc * ca.cos(b) * ca.cos(a),
    )
    alpha = ca.jtimes(w, ca.vertcat(angles, rates), ca.vertcat(rates, accelerations))
    return ca.Function("wrist", [angles, rates, accelerations], [q, w, alpha])


def step(p: Params, u: In, x: X, T: float) -> tuple[X, Out]:
    """Compute one sample."""
    length = ca.if_else(p.one_by_one, p.move_time / JOINTS, p.move_time)
    ramp = ca.fmin(p.ramp_time, 0.5 * length)
    half = p.dwell + p.move_time
    back = x.time >= half
    t = ca.fmax(x.time - ca.if_else(back, half, 0) - p.dwell, 0)
    moves = [move(t - p.one_by_one * joint * length, length, ramp) for joint in range(JOINTS)]
    way, speed, change = (ca.vertcat(*column) for column in zip(*moves, strict=True))
    sign = ca.if_else(back, -1, 1)
    span = p.end - p.start
    angles = p.start + span * ca.if_else(back, 1 - way, way)
    q, rate, alpha = _wrist()(angles, span * sign * speed, span * sign * change)
    attitude = rotations.multiply(rotations.from_rotation_vector(p.rest), q)
    R = rotations.matrix(attitude)
    time = x.time + T
    return (
        X(time=ca.if_else(time >= 2 * half, time - 2 * half, time)),
        Out(
            body=p.pivot + R @ p.arm,
            body_acceleration=R @ (ca.cross(alpha, p.arm) + ca.cross(rate, ca.cross(rate, p.arm))),
            attitude=attitude,
            rate=rate,
            angular_acceleration=alpha,
            moving=ca.fmin(ca.mmax(speed) * (length - ramp), 1),
        ),
    )


MODEL = Model.of_step("Robot", step, sample_period=1e-3)
