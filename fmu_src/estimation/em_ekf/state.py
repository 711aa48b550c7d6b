"""State of the filter, its process, and what its measurements predict (RK 2 to 5)."""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.estimation import attitude_sources as sources
from fmu_src.filters.error_space import Space
from fmu_src.filters.error_state import Extended
from fmu_src.kit import State
from fmu_src.kit.records import quaternion, real
from fmu_src.math import rotations


class Nominal(State):
    """State of the filter; RK eq. 1 and what is beyond it."""

    attitude = quaternion("q, attitude q_WB")
    rate_bias = real("rad/s", "b in B", shape=3)
    force_bias = real("m/s2", "b_a in B", shape=3)
    distortion = real("rad", "d in F", shape=3)
    mounting = quaternion("h, q_BC")
    registration = quaternion("r, q_WF")


SPACE = Space(Nominal, "attitude", "mounting", "registration")
FILTER = Extended(SPACE)
LEVEL = np.radians(2.0)
"""Tilt of the tracker's vertical against the specific force that passes for none [rad]."""


def process(x: Any, u: Any) -> Nominal:
    """State after the samples since the last correction (RK 3).

    Args:
        x: nominal state.
        u: turn with the bias of the start taken off (4,), that bias (3,), their time [s], and what
            is left of the distortion.
    """
    turn, bias, h, left = u[:4], u[4:7], u[7], u[8]
    missed = rotations.from_rotation_vector((bias - x.rate_bias) * h)
    turned = rotations.multiply(rotations.multiply(x.attitude, turn), missed)
    return x.replace(attitude=turned, distortion=left * x.distortion)


def now(q: Any, turn: Any, rest: Any) -> Any:
    """Attitude after a turn (4,) and a rotation vector (3,) more, for output, (4,)."""
    turned = rotations.multiply(rotations.multiply(q, turn), rotations.from_rotation_vector(rest))
    return rotations.canonical(turned)


def gravity_residual(x: Any, u: Any) -> Any:
    """Specific force (3,) minus that of gravity u[3], (3,) (RK 4)."""
    up = rotations.matrix(x.attitude)[2, :].T
    return u[:3] - x.force_bias - up * u[3]


def heading(q: Any, field: Any) -> Any:
    """Turn about the vertical from an attitude q to the one that a field in B shows [rad]."""
    e = rotations.matrix(q) @ field
    return -ca.atan2(e[1], e[0])


def heading_residual(x: Any, u: Any) -> Any:
    """Turn about the vertical that the field shows, minus that which x would show, (1,) [rad].

    The field as measured is not in the slope: its noise would be there squared, and tilt the
    attitude whatever its sign.

    Args:
        x: nominal state.
        u: turn shown by the measured field, the attitude it is turned from (4,), dip [rad].
    """
    north = ca.vertcat(ca.cos(u[5]), 0, -ca.sin(u[5]))
    return u[0] - heading(u[1:5], rotations.matrix(x.attitude).T @ north)


def coils(x: Any, turn: Any) -> Any:
    """Attitude that the tracker shows before a turn, (4,) (RK III.B)."""
    then = rotations.multiply(x.attitude, rotations.conjugate(turn))
    coil = rotations.multiply(
        rotations.multiply(rotations.conjugate(x.registration), then), x.mounting
    )
    return rotations.multiply(rotations.from_rotation_vector(x.distortion), coil)


def tracker_residual(x: Any, u: Any) -> Any:
    """Attitude of the coils measured against that predicted for then, (3,) (RK 5).

    Args:
        x: nominal state.
        u: as `attitude_sources.measured` gives it.
    """
    return sources.attitude_residual(coils(x, u[7:]), u[:7])


def levelled(x: Any, z: Any, turn: Any, force: Any) -> Any:
    """Return whether the tracker's attitude has its vertical where the specific force is.

    Args:
        x: nominal state, stacked.
        z: attitude of the tracker, (4,).
        turn: turn since then, (4,).
        force: specific force, (3,) [m/s2].
    """
    state = Nominal.unpack(x)
    coil = rotations.multiply(state.registration, z)
    body = rotations.multiply(rotations.multiply(coil, rotations.conjugate(state.mounting)), turn)
    up = rotations.matrix(body)[2, :]
    return up @ force > np.cos(LEVEL) * ca.sqrt(ca.sumsqr(force) + 1e-12)
