"""Share what several plants need: ports of a moving body, and the timing of trackers.

A tracker exposes at a rate that need not divide that of the model; an exposure falls on the first
sample at or after its instant. What it saw is a packet that arrives after a latency, in order, at
most one a sample. This is no plant and holds no model.

| symbol | meaning |
| --- | --- |
| W, B | world, body |
| q_WB, R | attitude of the body, its rotation matrix from B to W |
| a_W, w, alpha | acceleration of the origin of B [m/s2], body rate and angular acceleration in B |
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.kit import State
from fmu_src.kit.noise import standard_normal
from fmu_src.kit.records import integer, quaternion, real, vector
from fmu_src.math import rotations

BODY = vector("m", "origin of B in W", within=10.0)
BODY_ACCELERATION = vector("m/s2", "acceleration of the origin of B in W", within=1e3)
ATTITUDE = quaternion("attitude q_WB; a length other than 1 is scaled away", within=1.01)
ANGULAR_ACCELERATION = vector("rad/s2", "angular acceleration in B", within=1e4)
"""Inputs: motion of a body."""
GRAVITY = real("m/s2", "gravity g at the site", start=design.SITE_GRAVITY, min=0.0, max=20.0)
FIELD_STRENGTH = real(
    "T", "strength F of the earth's field", start=design.MAGNETIC_FIELD, min=0.0, max=1e-3
)
INCLINATION = real(
    "rad",
    "dip I of the field below the horizon",
    start=design.MAGNETIC_INCLINATION,
    within=np.pi / 2,
)
"""Parameters of the site."""
LATENCY_JITTER = real("s", "rms of what is added to it", start=0.0, min=0.0, max=0.05)
CLOCK_ERROR = real("s", "by which the stated age is short of the true one", start=0.0, within=0.1)
REGISTRATION = real(
    "rad", "rotation vector from the axes of W to those of the tracker", shape=3, within=np.pi
)
ORIGIN = real("m", "origin of the tracker's frame in W", shape=3, within=20.0)
"""Parameters of a tracker: timing and frame."""
SMALLEST_NORM = 0.01
"""Squared length below which four numbers no longer pass for an attitude."""
SLOTS = 8
"""Packets that may be under way at once; one that finds no slot is lost."""
_EARLY = 1e-9
"""Rounding of sums of sample periods, in periods."""
_MOST = 0.5
"""Largest chance of an event in a sample."""


def unit_quaternion(attitude: Any) -> ca.SX:
    """Scale an attitude to length 1, (4,)."""
    return attitude / ca.sqrt(ca.fmax(ca.sumsqr(attitude), SMALLEST_NORM))


def attitude_matrix(attitude: Any) -> ca.SX:
    """Return R of an attitude of any length, (3, 3)."""
    return rotations.matrix(attitude) / ca.fmax(ca.sumsqr(attitude), SMALLEST_NORM)


def earth_field(strength: Any, inclination: Any) -> ca.SX:
    """Return the earth's magnetic field in W, (3,) [T].

    Args:
        strength: F [T].
        inclination: dip I below the horizon [rad].
    """
    return strength * ca.vertcat(ca.cos(inclination), 0, -ca.sin(inclination))


def specific_force(
    R: Any, acceleration: Any, gravity: Any, rate: Any, angular_acceleration: Any, place: Any
) -> ca.SX:
    """Return what an ideal accelerometer triad on a rigid body measures, (3,) [m/s2], B.

    Newton-Euler kinematics; at rest it measures +g upwards.

    Args:
        R: rotation matrix from B to W, (3, 3).
        acceleration: a_W, (3,) [m/s2].
        gravity: g [m/s2].
        rate: w, (3,) [rad/s].
        angular_acceleration: alpha, (3,) [rad/s2].
        place: place of the triad in B, (3,) [m].
    """
    lever = ca.cross(angular_acceleration, place) + ca.cross(rate, ca.cross(rate, place))
    return R.T @ (acceleration + ca.vertcat(0, 0, gravity)) + lever


def exposed(phase: Any, rate: Any, T: float) -> tuple[Any, Any]:
    """Return whether a tracker exposes at this sample, and its phase at the next one.

    Args:
        phase: exposures that are due, counted in periods; 1 at the first sample.
        rate: exposures in a second, at most one a sample [Hz].
        T: sample period [s].
    """
    now = phase >= 1 - _EARLY
    return now, phase - now + rate * T


def chance(rate: Any, T: float) -> Any:
    """Return the standard normal draw above which an event happens in a sample.

    Args:
        rate: of the events [Hz].
        T: sample period [s].
    """
    return -standard_normal(ca.fmin(ca.fmax(rate * T, 1e-12), _MOST))


def switched(on: Any, draw: Any, begin: Any, end: Any) -> Any:
    """Return whether a failure that begins and ends at random holds at the next sample.

    Args:
        on: whether it holds now.
        draw: a standard normal draw.
        begin: draw above which it begins, see `chance`.
        end: draw above which it ends.
    """
    return ca.if_else(on, draw <= end, draw > begin)


def queue(size: int) -> type[State]:
    """Make the record of packets that are under way, each of `size` numbers, one a column."""

    class Queue(State):
        """Packets under way, the oldest first."""

        packets = real(None, "packets under way", shape=(size, SLOTS), listed=False)
        left = real("s", "time until each arrives", shape=SLOTS, listed=False)
        age = real("s", "age of each", shape=SLOTS, listed=False)
        count = integer("packets under way", min=0, max=SLOTS)

    return Queue


def passed(line: Any, sent: Any, packet: Any, latency: Any, T: float) -> tuple[Any, Any, Any, Any]:
    """Advance a queue by one sample.

    Args:
        line: its record.
        sent: whether a packet is sent now.
        packet: what it holds, (size,).
        latency: time until it arrives [s].
        T: sample period [s].

    Returns:
        The record at the next sample, whether a packet arrives now, that packet, and its age [s].
    """
    sent = ca.logic_and(sent, line.count < SLOTS)
    packets, left, age = [], [], []
    for i in range(SLOTS):
        here = ca.logic_and(sent, line.count == i)
        packets.append(ca.if_else(here, packet, line.packets[:, i]))
        left.append(ca.if_else(here, latency, line.left[i]))
        age.append(ca.if_else(here, 0, line.age[i]))
    count = line.count + sent
    arrived = ca.logic_and(count > 0, left[0] <= _EARLY * T)

    def moved(items: list[Any]) -> list[Any]:
        return [
            ca.if_else(arrived, later, item)
            for item, later in zip(items, [*items[1:], items[-1]], strict=True)
        ]

    following = type(line)(
        packets=ca.horzcat(*moved(packets)),
        left=ca.vertcat(*moved(left)) - T,
        age=ca.vertcat(*moved(age)) + T,
        count=count - arrived,
    )
    # Times of empty slots would run on for ever.
    waiting = ca.DM(range(SLOTS)) < following.count
    following = following.replace(left=waiting * following.left, age=waiting * following.age)
    return following, arrived, packets[0], age[0]
