"""One sample of the sensors: compensated channels, and which of them may be used."""

from typing import Any, NamedTuple

import casadi as ca

from fmu_src.device import sensing_kinematics as kinematics
from fmu_src.estimation.micron import compensation, plausibility

LEAST_NORTH = 0.1
"""Level part of the unit field below which it has no north to speak of: 6 deg from the vertical."""


class Sample(NamedTuple):
    """Compensated channels of one instant.

    Attributes:
        f: specific forces of the six channels, (6,) [m/s2].
        field: magnetic field in B, (3,) [T], and its strength [T], not below its noise.
        strength: see `field`.
        n_B: unit field in B, (3,).
        A_D: differences of the channels, (3,) [m/s2].
        gravity_B: specific force of all channels together, (3,) [m/s2].
        weight: its norm [m/s2].
        z_B: unit vector up in B, (3,).
        alive: channels that deliver, see `plausibility.Alive`.
        dead_field: whether there is a sample, but no live magnetometer in it.
        upright: whether the specific force is near gravity.
        complete: whether the sample gives an attitude on its own.
    """

    f: Any
    field: Any
    strength: Any
    n_B: Any
    A_D: Any
    gravity_B: Any
    weight: Any
    z_B: Any
    alive: plausibility.Alive
    dead_field: Any
    upright: Any
    complete: Any


def compensate(p: Any, u: Any, x: Any, alignment: Any) -> Sample:
    """Return the compensated channels (A04 3.2) and what of them is usable."""
    variances = p.accelerometer.density**2
    at = (u.temperature, p.thermometer.reference, alignment)
    f = compensation.specific_forces(p.accelerometer, u.volts[:6], *at)
    field = compensation.magnetic_field(p.magnetometer, u.volts[6:], *at)
    strength = ca.sqrt(ca.sumsqr(field) + p.magnetometer.sigma**2)
    n_B = field / strength
    gravity_B = kinematics.compound(f, variances)
    weight = ca.sqrt(ca.sumsqr(gravity_B) + 1e-12)
    z_B = gravity_B / weight
    alive = plausibility.alive(u.volts, u.inertial_valid, f, field, p.gates, x.channels)
    upright = ca.logic_and(weight > 0.5 * p.gravity, weight < 1.5 * p.gravity)
    across = ca.sumsqr(ca.cross(z_B, n_B)) > LEAST_NORTH**2
    return Sample(
        f=f,
        field=field,
        strength=strength,
        n_B=n_B,
        A_D=kinematics.differences(f),
        gravity_B=gravity_B,
        weight=weight,
        z_B=z_B,
        alive=alive,
        dead_field=ca.logic_and(u.inertial_valid, ca.logic_not(alive.field)),
        upright=upright,
        complete=ca.logic_and(
            ca.logic_and(alive.force, alive.field), ca.logic_and(upright, across)
        ),
    )
