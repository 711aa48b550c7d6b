"""Rigid handheld instrument with its three-legged tip manipulator.

    f_i   = R^T (a_W - g_W) + alpha x r_i + w x (w x r_i)          specific force at site i
    m     = R^T F (cos I, 0, -sin I)                               field in the body frame
    S_i   = (r - L_i sin t_i) e_i + L_i cos t_i z,  L_i = L_0 + k s_i
    0     = |S_i - S_j|^2 - 3 r^2                                  i, j = 1 2, 2 3, 3 1
    n     = (S_2 - S_1) x (S_3 - S_1), scaled to 1
    P     = (S_1 + S_2 + S_3) / 3 + l n                            tip of the shaft (A04 eq. 6.62)
    tip_W = o_W + R (p_B + P(s) - P(0))

| symbol | meaning |
| --- | --- |
| W, B | world (z up, x in the plane of z and magnetic north), body (z towards the tip) |
| o_W, a_W | position and acceleration of the origin of B [m], [m/s2], W |
| R | R(q_WB), body to world |
| w, alpha | body rate and its derivative [rad/s], [rad/s2], B |
| r_i | place of accelerometer site i [m], B |
| g_W | (0, 0, -g) |
| F, I | strength and dip of the earth's field [T], [rad] |
| s_i | stroke of stack i [m]; s = 0 at 0 V |
| k | stroke amplification of the levers |
| L_0, L_i | length of a leg at zero stroke, and now [m] |
| t_i | tilt of leg i towards the axis [rad] |
| e_i | radial direction of leg i, at 0, 120 and 240 degrees from x |
| r | radius of the pin joints on the base and of the ball joints on the platform [m] |
| l | length of the shaft, platform to tip [m] |
| p_B | tip in B at zero stroke [m] |

The manipulator is a 3-RPS parallel mechanism (Lee and Shah 1988; A04 6.3). A pin joint with a
tangential axis keeps leg i in the plane of z and e_i, so that three tilts t_i describe all it can
do; the three distances of the ball joints on the rigid platform determine them. Newton's method
solves for the tilts from upright legs. Their size is micrometres over L_0, the constraints are
quadratic in them, and two steps are enough; a third is for strokes far beyond a stack's.

The base frame of the manipulator is parallel to B. Deflection is counted from zero stroke: stacks
that rest at half their voltage show the deflection of that rest, mostly along z. Mechanics are
quasi-static (the resonance of the actuation is part of the stack), the body is rigid, and the
moving platform does not push back on the hand.
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, Inputs, real, vector
from fmu_src.math import rotations
from plants import sampling

OUTWARDS = [np.array([np.cos(a), np.sin(a), 0.0]) for a in np.radians([0.0, 120.0, 240.0])]
"""Directions e_i of the legs in the manipulator's base frame."""
UPWARDS = np.array([0.0, 0.0, 1.0])
NEWTON_STEPS = 3


class Params(Parameters):
    """Geometry of the instrument, gravity and field of the site."""

    sites = real(
        "m",
        "places of the accelerometers in B, one site a row",
        shape=(3, 3),
        start=[[design.D1, 0, 0], [0, design.D1, 0], [design.D2, design.D2, design.D3]],
        within=1.0,
    )
    tip = real("m", "tip in B at zero stroke", shape=3, start=design.TIP, within=1.0)
    gravity = sampling.GRAVITY
    field_strength = sampling.FIELD_STRENGTH
    inclination = sampling.INCLINATION
    radius = real(
        "m",
        "radius r of the pin joints and of the ball joints",
        start=design.PLATFORM_RADIUS,
        min=2e-3,
        max=0.1,
    )
    leg_length = real(
        "m", "length L_0 of a leg at zero stroke (chosen)", start=20e-3, min=5e-3, max=0.2
    )
    shaft_length = real(
        "m", "length l from platform to tip", start=design.SHAFT_LENGTH, min=0.0, max=0.5
    )
    lever_gain = real(
        None, "amplification k of the strokes", start=design.LEVER_GAIN, min=0.0, max=20.0
    )


class In(Inputs):
    """Motion of the body and strokes of the stacks."""

    body = sampling.BODY
    body_acceleration = sampling.BODY_ACCELERATION
    attitude = sampling.ATTITUDE
    rate = vector("rad/s", "body rate in B", within=100.0)
    angular_acceleration = sampling.ANGULAR_ACCELERATION
    stroke = real("m", "strokes of the stacks, 0 at 0 V", shape=3, min=-20e-6, max=60e-6)


class Precomputed(Derived):
    """Constants: rest of the shaft, and the earth's field."""

    rest = real("m", "P(0), tip of the shaft at zero stroke, base frame of the legs", shape=3)
    field = real("T", "F (cos I, 0, -sin I), the earth's field in W", shape=3)


class X(State):
    """Nothing: rigid and quasi-static."""


class Out(Outputs):
    """Quantities at the sensors, and place of the tip."""

    force1 = vector("m/s2", "specific force at site 1 in B")
    force2 = vector("m/s2", "specific force at site 2 in B")
    force3 = vector("m/s2", "specific force at site 3 in B")
    field = vector("T", "magnetic field in B")
    free_tip = vector("m", "tip in W as if at zero stroke")
    tip = vector("m", "tip in W")
    deflection = vector("m", "tip in B, from its place at zero stroke")


def derive(p: Params, T: float) -> Precomputed:
    """Compute what follows from the parameters."""
    return Precomputed(
        rest=shaft_tip(p, ca.SX.zeros(3)),
        field=sampling.earth_field(p.field_strength, p.inclination),
    )


def shaft_tip(p: Params, stroke: Any) -> Any:
    """Solve the forward kinematics of the 3-RPS: shaft tip from the plane of the pins, (3,) [m].

    Args:
        p: parameters.
        stroke: strokes of the stacks, (3,) [m].
    """
    legs = p.leg_length + p.lever_gain * stroke
    tilts = ca.SX(3, 1)
    for _ in range(NEWTON_STEPS):
        joints = _ball_joints(p, legs, tilts)
        slopes = [
            -legs[i] * (ca.cos(tilts[i]) * OUTWARDS[i] + ca.sin(tilts[i]) * UPWARDS)
            for i in range(3)
        ]
        gaps, jacobian = ca.SX(3, 1), ca.SX(3, 3)
        for row, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
            span = joints[i] - joints[j]
            gaps[row] = ca.sumsqr(span) - 3 * p.radius**2
            jacobian[row, i] = 2 * ca.dot(span, slopes[i])
            jacobian[row, j] = -2 * ca.dot(span, slopes[j])
        tilts -= ca.solve(jacobian, gaps)
    joints = _ball_joints(p, legs, tilts)
    normal = rotations.normalize(ca.cross(joints[1] - joints[0], joints[2] - joints[0]))
    return sum(joints) / 3 + p.shaft_length * normal


def _ball_joints(p: Params, legs: Any, tilts: Any) -> list[Any]:
    """Return the places S_i of the ball joints in the manipulator's base frame, each (3,) [m]."""
    return [
        (p.radius - legs[i] * ca.sin(tilts[i])) * OUTWARDS[i] + legs[i] * ca.cos(tilts[i]) * UPWARDS
        for i in range(3)
    ]


def step(p: Params, u: In, x: X, T: float, derived: Precomputed) -> tuple[X, Out]:
    """Compute one sample."""
    R = sampling.attitude_matrix(u.attitude)
    motion = (u.body_acceleration, p.gravity, u.rate, u.angular_acceleration)
    forces = [sampling.specific_force(R, *motion, p.sites[i, :].T) for i in range(3)]
    deflection = shaft_tip(p, u.stroke) - derived.rest
    free_tip = u.body + R @ p.tip
    return X(), Out(
        force1=forces[0],
        force2=forces[1],
        force3=forces[2],
        field=R.T @ derived.field,
        free_tip=free_tip,
        tip=free_tip + R @ deflection,
        deflection=deflection,
    )


MODEL = Model.of_step("Instrument", step, sample_period=1e-3, derive=derive)
