"""State of the filter, its process, and what its measurements predict (E13 3)."""

from typing import Any

import casadi as ca

from fmu_src.device import design
from fmu_src.filters.error_space import Space
from fmu_src.kit import State
from fmu_src.kit.records import quaternion, real
from fmu_src.math import rotations

KEPT = 128
"""Inertial samples that are kept for late poses."""
MARKERS = len(design.MARKERS)
POSE, MARKER = 6, 3 * MARKERS
"""Sizes of the residuals."""


class Nominal(State):
    """State of the filter; what bends the process comes first, then what else it depends on."""

    attitude = quaternion("q, attitude q_WB")
    rate_bias = real("rad/s", "b_g", shape=3)
    rate_matrix = real(None, "M_g", shape=(3, 3))
    rate_lag = real("s", "t_g")
    force_lag = real("s", "t_a")
    position = real("m", "p in W", shape=3)
    velocity = real("m/s", "v in W", shape=3)
    force_bias = real("m/s2", "b_a", shape=3)
    force_matrix = real(None, "M_a", shape=(3, 3))
    gravity = real("m/s2", "G in W", shape=3)
    lever = real("m", "l in B", shape=3)
    mounting = quaternion("m, q_BO")
    position_offset = real("m", "o_p in W", shape=3)
    flicker = real("m", "o_f in W", shape=3)
    attitude_offset = real("rad", "o_q in O", shape=3)


SPACE = Space(Nominal, "attitude", "mounting")


def rate_and_force(x: Any, sensed: Any) -> tuple[Any, Any]:
    """Body rate w and specific force f of a sample (6,)."""
    w = sensed[:3] + x.rate_matrix @ sensed[:3] - x.rate_bias
    f = sensed[3:] + x.force_matrix @ sensed[3:] - x.force_bias
    return w, f


def acceleration(x: Any, q: Any, w: Any, f: Any) -> Any:
    """Acceleration a in W, (3,), at the time of the force: the attitude is as old as the rate."""
    turned = rotations.multiply(q, rotations.from_rotation_vector(w * (x.rate_lag - x.force_lag)))
    return rotations.matrix(turned) @ f - x.gravity


def process(x: Any, u: Any) -> Nominal:
    """State after an inertial sample.

    Args:
        x: nominal state.
        u: the sample before (6,), this one (6,), h [s], and what is left of o_p, o_f and o_q.
    """
    h = u[12]
    w, f = rate_and_force(x, u[:6])
    w_now, f_now = rate_and_force(x, u[6:12])
    turn = (w + w_now) * (h / 2) + ca.cross(w, w_now) * (h * h / 12)
    attitude = rotations.multiply(x.attitude, rotations.from_rotation_vector(turn))
    a = acceleration(x, x.attitude, w, f)
    a_now = acceleration(x, attitude, w_now, f_now)
    return x.replace(
        attitude=rotations.normalize(attitude),
        position=x.position + h * x.velocity + h * h / 6 * (2 * a + a_now),
        velocity=x.velocity + h / 2 * (a + a_now),
        position_offset=u[13] * x.position_offset,
        flicker=u[14] * x.flicker,
        attitude_offset=u[15] * x.attitude_offset,
    )


class Back:
    """From the state back to what it was some samples ago: (q_r, v_r, p_r, t), (11,).

    q = q_then (x) q_r, v = v_then + R_then v_r - G t, and the way likewise: the motion relative to
    the body, without gravity.
    """

    SIZE = 11
    NONE = (1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)

    @staticmethod
    def then(x: Any, back: Any) -> tuple[Any, Any, Any]:
        """Attitude, position and velocity of then."""
        q_r, v_r, p_r, t = back[:4], back[4:7], back[7:10], back[10]
        q = rotations.multiply(x.attitude, rotations.conjugate(q_r))
        R = rotations.matrix(q)
        v = x.velocity + x.gravity * t - R @ v_r
        return q, x.position - v * t + x.gravity * (t * t / 2) - R @ p_r, v

    @staticmethod
    def longer(back: Any, w: Any, f: Any, h: Any) -> Any:
        """Return the way back from h earlier on, with the mean rate and force of that time."""
        q_r, v_r, p_r, t = back[:4], back[4:7], back[7:10], back[10]
        turn = rotations.from_rotation_vector(w * h)
        half = rotations.matrix(rotations.from_rotation_vector(w * (h / 2)))
        R = rotations.matrix(turn)
        v = half @ f * h
        return ca.vertcat(
            rotations.multiply(turn, q_r), v + R @ v_r, R @ p_r + v * (t + h / 2), t + h
        )


def way_back(x: Any, past: Any, steps: Any, age: Any) -> tuple[Any, Any, Any]:
    """Way back to the kept sample that is nearest to an age.

    Args:
        x: nominal state, stacked.
        past: samples, newest first, (6, KEPT).
        steps: time before each of them, (KEPT,) [s].
        age: of a pose, by the newest sample [s].

    Returns:
        Way (11,), sample of then (6,), and the time from it to the pose [s].
    """
    state, carried = ca.SX.sym("x", SPACE.size), ca.SX.sym("carried", Back.SIZE + 6)
    pair, h, wanted = ca.SX.sym("pair", 12), ca.SX.sym("h"), ca.SX.sym("age")
    back = carried[: Back.SIZE]
    go = ca.logic_and(back[10] + h / 2 <= wanted, h > 0)
    w, f = rate_and_force(Nominal.unpack(state), (pair[:6] + pair[6:]) / 2)
    following = ca.vertcat(Back.longer(back, w, f, h), pair[6:])
    arguments = [carried, pair, h, state, wanted]
    step = ca.Function("step_back", arguments, [ca.if_else(go, following, carried)])
    pairs = ca.vertcat(past[:, :-1], past[:, 1:])
    start = ca.vertcat(ca.DM(Back.NONE), past[:, 0])
    count = KEPT - 1
    held = ca.repmat(x, 1, count), ca.repmat(age, 1, count)
    found = step.fold(count)(start, pairs, steps[:-1].T, *held)
    return found[: Back.SIZE], found[Back.SIZE :], found[10] - age


def pose(x: Any, back: Any, sensed: Any, later: Any) -> tuple[Any, Any, Any]:
    """Attitude q_WO, position and velocity of the tracked body, as the tracker sees it.

    Args:
        x: nominal state.
        back: way back to an instant in the past, (11,).
        sensed: sample of that instant, (6,).
        later: how much later than that sample, lags apart [s].
    """
    q, p, v = Back.then(x, back)
    w, f = rate_and_force(x, sensed)
    a = acceleration(x, q, w, f)
    turned = rotations.multiply(q, rotations.from_rotation_vector(w * (x.rate_lag + later)))
    s = x.force_lag + later
    R = rotations.matrix(turned)
    attitude = rotations.multiply(
        rotations.multiply(turned, x.mounting), rotations.from_rotation_vector(x.attitude_offset)
    )
    position = p + v * s + a * (s * s / 2) + R @ x.lever + x.position_offset + x.flicker
    return attitude, position, v + a * s + R @ ca.cross(w, x.lever)


def residual(x: Any, u: Any) -> Any:
    """Pose from the tracker minus the predicted one: position in W, attitude in O, (6,).

    Args:
        x: nominal state.
        u: way back (11,), sample of then (6,), time from it [s]; z_p and z_q.
    """
    attitude, position, _ = pose(x, u[:11], u[11:17], u[17])
    turned = rotations.multiply(rotations.conjugate(attitude), u[21:25])
    return ca.vertcat(u[18:21] - position, rotations.to_rotation_vector(turned))


def marker_residual(x: Any, u: Any) -> Any:
    """Markers from the tracker minus the predicted ones, in W, 0 for those not seen, (12,).

    Args:
        x: nominal state.
        u: way back (11,), sample of then (6,), time from it [s]; z_i (12,), which are seen (4,),
            r_i (12,).
    """
    attitude, position, _ = pose(x, u[:11], u[11:17], u[17])
    R = rotations.matrix(attitude)
    found = []
    for i in range(MARKERS):
        at = slice(18 + 3 * i, 21 + 3 * i)
        place = u[34 + 3 * i : 37 + 3 * i]
        found.append(u[30 + i] * (u[at] - position - R @ place))
    return ca.vertcat(*found)
