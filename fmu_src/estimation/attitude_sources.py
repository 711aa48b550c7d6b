"""Checks of samples ahead of filters with a tracker: faults, and age.

| symbol | meaning |
| --- | --- |
| s | rate and force of the inertial unit, (6,) |
| c_k | attitude made of the turns of all samples, from any start |
| d | age of an attitude when it arrives [s] |

An inertial sample is lost where it does not come (`inertial_valid` false for longer than a unit's
own interval), repeats itself (frozen: noise never repeats), or is at its limit (clipped). The
turn of a sample goes straight from the last rate to the present one; where none comes the last one
holds, and what that missed is made good with the next.

An attitude from a tracker is taken where it is new, of unit length, not the same as before
(duplicated or frozen), and not older than what is kept of the turns. Where all are beyond the gate
for long, it is the filter that has gone astray, and starts anew. It is compared with where the
body was: q_then = q (x) (c_then* (x) c_now)*.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from fmu_src.filters.error_state import LEAST_VARIANCE
from fmu_src.kit import Parameters, State
from fmu_src.kit.records import real
from fmu_src.math import rotations

LATEST = 160
"""Samples for which turns are kept."""
FROZEN = 4
"""Equal samples in a row that tell a frozen unit."""
ONE_GAP = 0.2
"""Longest time between two attitudes that counts as doubt [s]."""


class Limits(Parameters):
    """Ranges of an inertial unit."""

    rate_range = real("rad/s", "largest rate it tells from more", start=4.36, min=0.1, max=1e3)
    force_range = real(
        "m/s2", "largest specific force it tells from more", start=19.6, min=1.0, max=1e4
    )
    patience = real(
        "s", "without a sample, after which it counts as lost", start=0.02, min=1e-3, max=1.0
    )


class Unit(State):
    """Memory of the inertial samples."""

    sensed = real(None, "last rate and force that came", shape=6)
    pending = real("s", "time since then", min=0.0)
    equal = real(None, "samples that were equal in a row", min=0.0)


class Tracked(State):
    """Memory of the tracker's attitudes, and of the turns since."""

    last = real(None, "last attitude that came", shape=4)
    quiet = real("s", "time since one was taken", min=0.0)
    doubted = real("s", "time for which all that were taken were beyond the gate", min=0.0)
    past = real(
        None,
        "c, newest first",
        shape=(4, LATEST),
        start=[[1.0] * LATEST, *[[0.0] * LATEST] * 3],
        listed=False,
    )


class Sample(NamedTuple):
    """Next memory, rate and force, whether they came and are lost, the sample's turn [rad]."""

    unit: Unit
    sensed: Any
    fresh: Any
    lost: Any
    turn: Any


class Arrival(NamedTuple):
    """Next memory, whether an attitude is taken, its unit quaternion."""

    tracked: Tracked
    taken: Any
    attitude: Any


def measured(
    name: str, record: type[State], predict: Callable[..., Any], x: Any, turn: Any, z: Any
) -> Any:
    """Known numbers of `attitude_residual`, and what the prediction takes besides, (7 + n,).

    Args:
        name: of the C function.
        record: of the nominal state.
        predict: attitude that is measured, of such a record and further numbers (n,).
        x: nominal state, stacked, (N,).
        turn: these numbers: the turn since the measurement, (n,).
        z: measured attitude, (4,).
    """

    def known(x: Any, turn: Any, z: Any) -> Any:
        expected = predict(record.unpack(x), turn)
        return ca.vertcat(shown(expected, z), expected, turn)

    return recorded(name, known, x, turn, z)[0]


def recorded(name: str, function: Callable[..., Any], *values: Any) -> list[Any]:
    """Results of a function of single elements, called from whole matrices."""
    symbols = [ca.SX.sym(f"v{i}", *ca.MX(value).shape) for i, value in enumerate(values)]
    found = function(*symbols)
    results = list(found) if isinstance(found, tuple) else [found]
    called = ca.Function(name, symbols, list(map(ca.densify, results)), {"cse": True})
    return list(called.call(list(map(ca.MX, values)), False, True))


def inertial(x: Unit, rate: Any, force: Any, valid: Any, limits: Limits, T: float) -> Sample:
    """Take in the inertial sample of this instant.

    Args:
        x: what was kept.
        rate: body rate, (3,) [rad/s].
        force: specific force, (3,) [m/s2].
        valid: whether both are fresh.
        limits: of the unit.
        T: sample period [s].
    """
    now = ca.vertcat(rate, force)
    same = ca.sumsqr(now - x.sensed) == 0
    equal = ca.if_else(valid, ca.if_else(same, ca.fmin(x.equal + 1, FROZEN), 0), x.equal)
    pending = x.pending + T
    clipped = ca.logic_or(
        ca.mmax(ca.fabs(rate)) >= 0.999 * limits.rate_range,
        ca.mmax(ca.fabs(force)) >= 0.999 * limits.force_range,
    )
    faulty = ca.logic_or(equal >= FROZEN, clipped)
    lost = ca.logic_or(faulty, pending > limits.patience)
    sensed = ca.if_else(valid, now, x.sensed)
    w, w_now = x.sensed[:3], sensed[:3]
    # Time before this sample was passed with the last rate held: half the change makes it good.
    turn = w * T + (w_now - w) * (pending / 2)
    pending = ca.if_else(valid, 0, ca.fmin(pending, 1e3))
    return Sample(Unit(sensed=sensed, pending=pending, equal=equal), sensed, valid, lost, turn)


def moved(past: Any, turn: Any) -> Any:
    """Return the kept attitudes with one more, a turn (3,) [rad] later, (4, LATEST)."""

    def turned(c: Any, turn: Any) -> Any:
        return rotations.normalize(rotations.multiply(c, rotations.from_rotation_vector(turn)))

    (now,) = recorded("turned", turned, past[:, 0], turn)
    return ca.horzcat(now, past[:, :-1])


def since(past: Any, age: Any, T: float) -> Any:
    """Turn from the instant of some age [s] until now, quaternion (4,)."""

    def turn(then: Any, now: Any) -> Any:
        return rotations.multiply(rotations.conjugate(rotations.normalize(then)), now)

    weights = ca.fmax(0, 1 - ca.fabs(age / T - ca.DM(range(LATEST))))
    (found,) = recorded("since", turn, past @ weights, past[:, 0])
    return found


def arrival(x: Tracked, past: Any, attitude: Any, new: Any, age: Any, T: float) -> Arrival:
    """Take in what the tracker says at this instant.

    Args:
        x: what was kept.
        past: c with that of this instant, (4, LATEST).
        attitude: quaternion, (4,).
        new: whether it arrives now.
        age: its age [s].
        T: sample period [s].
    """
    proper, unit = of_unit_length(attitude)
    known = ca.logic_and(proper, age <= (LATEST - 1) * T)
    repeated = ca.sumsqr(attitude - x.last) == 0
    taken = ca.logic_and(new, ca.logic_and(known, ca.logic_not(repeated)))
    tracked = Tracked(
        last=ca.if_else(new, attitude, x.last),
        quiet=ca.if_else(taken, 0, ca.fmin(x.quiet + T, 1e3)),
        doubted=x.doubted,
        past=past,
    )
    return Arrival(tracked, taken, unit)


def of_unit_length(attitude: Any) -> tuple[Any, Any]:
    """Return whether four numbers pass for an attitude, and their unit quaternion, (4,)."""
    length = ca.sqrt(ca.sumsqr(attitude) + LEAST_VARIANCE)
    return ca.logic_and(length > 0.9, length < 1.1), attitude / ca.fmax(length, 0.1)


def doubted(x: Tracked, taken: Any, beyond: Any, T: float) -> Any:
    """Time for which the filter and the tracker have disagreed [s].

    Args:
        x: what was kept.
        taken: whether an attitude is taken now.
        beyond: whether its innovation is beyond the gate.
        T: sample period [s].
    """
    return ca.if_else(taken, beyond * (x.doubted + ca.fmin(x.quiet, ONE_GAP) + T), x.doubted)


def shown(expected: Any, measured: Any) -> Any:
    """Rotation vector from an expected to a measured attitude, in its body, (3,) [rad]."""
    return rotations.to_rotation_vector(rotations.multiply(rotations.conjugate(expected), measured))


def attitude_residual(predicted: Any, u: Any) -> Any:
    """Return the measured attitude minus the predicted one, as a rotation vector, (3,) [rad].

    What is measured is not in the slope, which would be bent by its noise; to the first order in
    the distance of the prediction from that at the nominal state.

    Args:
        predicted: attitude, (4,).
        u: rotation vector that the measurement shows, and attitude at the nominal state, (7,).
    """
    apart = rotations.multiply(rotations.conjugate(u[3:]), predicted)
    return u[:3] - 2 * apart[1:]
