"""Electromagnetic tracker: a sensor of two coils in the field of a generator, and metal beside it.

    D(r)  = (3 r r^T / rho^2 - I) / rho^3,  rho^2 = |r|^2 + r_0^2               field of a dipole
    E     = -sum_k a_k^3 / 2  D(s - m_k) D(m_k - g) D(s - g)^-1                 what metal adds
    t_d   = (I - c_3 c_3^T / 2) sum_{i=1,2} c_i x E^T c_i                       attitude error, W
    q_m   = exp((t_d + s_q z) / 2) (x) q (x) h,  p_m = p + R l - E (s - g) / 3 + s_p z
    s_q,p = s_0 (1 + (|s - g| / d_0)^4)                                         jitter

| symbol | field | meaning |
| --- | --- | --- |
| p, q, R | body, attitude | origin of B in W [m], attitude q_WB and its matrix |
| s, l | lever | place of the sensor in W and in B [m] |
| h, c_i | mounting | rotation from B to the coil frame C; axes of C in W |
| g | generator | place of the field generator in W [m] |
| m_k, a_k | metal, metal_radius, room, room_radii | place [m] and radius [m] of a piece of metal |
| s_0, d_0 | | jitter near the generator [rad], [m]; distance at which it has doubled [m] |

Metal is a conducting sphere: in the generator's alternating field its eddy currents are a dipole of
moment -2 pi a^3 H. The tracker takes what its coils feel for the field of the generator alone. The
6DOF sensor has two 5DOF coils (RK III.A), along the first two axes of C: a coil along c feels the
field as if it lay along c + E^T c, and the attitude is the rotation that fits both best, to the
first order. So distortion depends on place and attitude, is smooth, and falls with the third power
of the distance to the metal. The apparent place moves by a third of the relative change of a field
that falls with the third power. A sphere of 5 cm at 10 cm gives some degrees, as RK I report
for metal nearby; angles above a radian are bent down to one.

One piece is moved by an input; three stand in the room (RK IV.A: unforeseen and inhomogeneous
surroundings). Pose of the coil frame in the tracker's frame, whose axes are turned by
`registration` from W and whose origin is `origin`: the same as W unless set.

Sources. Rate and latency as usual for an Aurora, 40 Hz and 25 ms; jitter, room and mounting are
chosen, the room so that the roll of an instrument that turns by 60 deg is shown with 0.5 deg rms,
latency in it (RK Fig. 4).
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.noise import standard_normal
from fmu_src.kit.records import Derived, Inputs, boolean, integer, quaternion, real, vector
from fmu_src.math import rotations
from plants import sampling

ROOM = 3
"""Pieces of metal in the room."""
SOFT = 0.01
"""Length r_0 that keeps the field of a dipole finite at its place [m]."""
LARGEST = 1.0
"""Angle that distortion cannot exceed [rad]."""
_PACKET = 7


class Params(Parameters):
    """Surroundings, accuracy, timing and mounting."""

    seed = integer("seed of the jitter", start=1, min=0, max=2**31 - 1)
    rate = real("Hz", "measurements in a second", start=40.0, min=1.0, max=1000.0)
    latency = real("s", "from measurement to arrival", start=0.025, min=0.0, max=0.12)
    latency_jitter = sampling.LATENCY_JITTER
    clock_error = sampling.CLOCK_ERROR
    loss = real(None, "share of measurements that is lost at random", start=0.0, min=0.0, max=1.0)
    generator = real(
        "m", "place g of the field generator in W", shape=3, start=(0.3, 0.0, 0.0), within=5
    )
    reach = real("m", "distance from it beyond which nothing is measured", start=0.6, min=0.05)
    jitter_attitude = real(
        "rad", "s_0 of the attitude, each axis", start=np.radians(0.1), min=0.0, max=0.2
    )
    jitter_position = real("m", "s_0 of the position, each axis", start=1e-4, min=0.0, max=0.01)
    jitter_distance = real("m", "distance d_0 of double jitter", start=0.4, min=0.05, max=5.0)
    metal_radius = real(
        "m", "radius a of the piece that is moved; 0 for none", start=0.03, min=0.0, max=0.2
    )
    room = real(
        "m",
        "places of the pieces in the room, one a row",
        shape=(ROOM, 3),
        start=[[0.13, -0.03, 0.16], [0.06, -0.2, -0.05], [-0.21, 0.11, 0.16]],
        within=5.0,
    )
    room_radii = real("m", "their radii", shape=ROOM, start=(0.03, 0.05, 0.035), min=0.0, max=0.5)
    lever = real("m", "place l of the sensor in B", shape=3, within=1.0)
    mounting = real("rad", "rotation vector of h, from B to the coil frame", shape=3, within=np.pi)
    registration = sampling.REGISTRATION
    origin = sampling.ORIGIN


class In(Inputs):
    """True pose, the piece of metal that is moved, and losses on demand."""

    body = sampling.BODY
    attitude = sampling.ATTITUDE
    metal = vector("m", "place of the moved piece in W", start=5.0, within=10.0)
    lost = boolean("whether measurements are lost")


class Precomputed(Derived):
    """Threshold of a loss, computed from the share of losses."""

    loss_draw = real(None, "standard normal draw below which a measurement is lost")


class X(State):
    """Clock, packets under way, and the last one."""

    phase = real(None, "measurements that are due", start=1.0)
    line: Any = sampling.queue(_PACKET)
    held = real(None, "last packet", shape=_PACKET, listed=False, start=(1, *[0] * 6))
    age = real("s", "its stated age")


class Out(Outputs):
    """Pose of the last packet, and what metal adds to it now."""

    em_position = vector("m", "sensor in the tracker's frame")
    em_attitude = quaternion("attitude of the coil frame in the tracker's")
    em_new = boolean("a measurement arrives at this instant")
    em_age = real("s", "its age on arrival, by the tracker's clock", min=0.0)
    distortion = vector("rad", "attitude error t_d by metal at this instant, W")


def derive(p: Params, T: float) -> Precomputed:
    """Compute what follows from the parameters."""
    share = ca.fmin(ca.fmax(p.loss, 1e-300), 1 - 1e-16)
    return Precomputed(loss_draw=standard_normal(share))


def dipole(r: Any) -> tuple[Any, Any]:
    """Return D(r), and its inverse but for r_0, (3, 3) [1/m3], [m3]."""
    squared = ca.sumsqr(r) + SOFT**2
    along = r @ r.T / squared
    cube = squared * ca.sqrt(squared)
    return (3 * along - ca.SX.eye(3)) / cube, (1.5 * along - ca.SX.eye(3)) * cube


def secondary(p: Params, metal: Any, place: Any) -> Any:
    """Return E at a place: the field of all metal relative to the generator's, (3, 3).

    Args:
        p: parameters.
        metal: place of the moved piece in W, (3,) [m].
        place: of the sensor in W, (3,) [m].
    """
    _, undone = dipole(place - p.generator)
    pieces = [(metal, p.metal_radius), *((p.room[k, :].T, p.room_radii[k]) for k in range(ROOM))]
    total = ca.SX.zeros(3, 3)
    for at, radius in pieces:
        total -= radius**3 / 2 * dipole(place - at)[0] @ dipole(at - p.generator)[0] @ undone
    return total


def step(p: Params, u: In, x: X, T: float, derived: Precomputed, normal: Any) -> tuple[X, Out]:
    """Compute one sample."""
    due, phase = sampling.exposed(x.phase, p.rate, T)
    q = sampling.unit_quaternion(u.attitude)
    sensor = u.body + rotations.matrix(q) @ p.lever
    coil = rotations.multiply(q, rotations.from_rotation_vector(p.mounting))
    C = rotations.matrix(coil)

    arm = sensor - p.generator
    distance = ca.sqrt(ca.sumsqr(arm))
    E = secondary(p, u.metal, sensor)
    bent = sum(ca.cross(C[:, i], E.T @ C[:, i]) for i in range(2))
    bent = bent - C[:, 2] * ca.dot(C[:, 2], bent) / 2
    bent = bent / ca.sqrt(1 + ca.sumsqr(bent) / LARGEST**2)
    growth = 1 + (ca.fmin(distance, 100.0) / p.jitter_distance) ** 4
    turn = bent + p.jitter_attitude * growth * normal[:3]
    pushed = -E @ arm / 3
    pushed = pushed / ca.sqrt(1 + ca.sumsqr(pushed) / LARGEST**2)
    place = sensor + pushed + p.jitter_position * growth * normal[3:6]

    F = rotations.matrix(rotations.from_rotation_vector(p.registration)).T
    attitude = rotations.multiply(
        rotations.from_rotation_vector(-p.registration),
        rotations.multiply(rotations.from_rotation_vector(turn), coil),
    )
    packet = ca.vertcat(rotations.canonical(attitude), F @ (place - p.origin))
    kept = ca.logic_and(distance <= p.reach, normal[6] > derived.loss_draw)
    sent = ca.logic_and(due, ca.logic_and(kept, ca.logic_not(u.lost)))
    latency = ca.fmax(p.latency + p.latency_jitter * normal[7], 0)
    line, arrived, packet, age = sampling.passed(x.line, sent, packet, latency, T)
    held = ca.if_else(arrived, packet, x.held)
    stated = ca.if_else(arrived, ca.fmax(age - p.clock_error, 0), x.age)
    return (
        X(phase=phase, line=line, held=held, age=stated),
        Out(
            em_position=held[4:],
            em_attitude=held[:4],
            em_new=arrived,
            em_age=stated,
            distortion=bent,
        ),
    )


MODEL = Model.of_step("EmTracker", step, sample_period=1e-3, draws=8, derive=derive)
