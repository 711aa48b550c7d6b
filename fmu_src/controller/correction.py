"""Tremor to voltages: a correction that is faded in and out, within the reach of the tip."""

from functools import cache, partial
from typing import Any

import casadi as ca

from fmu_src.controller.interface import STOPS, Command, Driving, In, Memory, Operators, Params
from fmu_src.controller.stacks import beginning, driving
from fmu_src.kit.functions import by_elements
from fmu_src.manipulator import parallel_3dof
from fmu_src.math import rotations


def smooth(progress: Any) -> ca.SX:
    """Map 0 to 1 to itself, with slopes of 0 at both ends."""
    return progress**2 * (3 - 2 * progress)


def aim(
    p: Params, derived: Operators, u: In, tremor: Any, x: Driving, T: float
) -> tuple[Any, Any, Any, Any]:
    """Compute the strokes against a tremor.

    Args:
        p: parameters.
        derived: what follows from them.
        u: attitude, and whether to correct at all.
        tremor: y_W, (3,) [m].
        x: memory and progress.
        T: sample period [s].

    Returns:
        Strokes, (3,) [m], whether they are all that is wanted, and progress of start and
        correction.
    """
    rise = ca.fmin(x.rise + T / p.rise_time, 1.0)
    wanted = ca.logic_and(ca.logic_and(u.valid, ca.logic_not(u.hold)), rise >= 1)
    towards = ca.if_else(wanted, 1.0, -1.0)
    engagement = ca.fmin(ca.fmax(x.engagement + towards * T / p.fade_time, 0.0), 1.0)
    correction = -rotations.matrix(u.attitude).T @ tremor
    demand = derived.rest + smooth(engagement) * correction

    strokes, reachable = parallel_3dof.limited(
        p.mechanism, parallel_3dof.inverse(p.mechanism, demand)
    )
    initial = derived.initial_strokes
    strokes = initial + smooth(rise) * (strokes - initial)
    return strokes, reachable, rise, engagement


@cache
def acting(T: float) -> ca.Function:
    """Record (p, operators, u, tremor, driving) -> (driving, command)."""
    records = (Params, Operators, In, Driving)
    aiming = by_elements("aim", partial(aim, T=T), Params, Operators, In, 3, Driving)
    p, d, u, state = (ca.MX.sym(record.__name__, record.size()) for record in records)
    tremor = ca.MX.sym("tremor", 3)
    parameters, derived, x = Params.unpack(p), Operators.unpack(d), Driving.unpack(state)
    strokes, reachable, rise, engagement = aiming(p, d, u, tremor, state)
    memory = beginning()(x.started, p, derived.initial_strokes, x.stacks.pack())
    following, volts, limited, singular = driving(T)(
        parameters.operator == STOPS, p, d, strokes, memory
    )
    driven = Driving(
        stacks=Memory.unpack(following), started=ca.MX(1.0), rise=rise, engagement=engagement
    )
    command = Command(
        volts=volts,
        engagement=smooth(engagement),
        saturated=ca.logic_or(ca.logic_not(reachable), limited),
        singular=singular,
    )
    return ca.Function("act", [p, d, u, tremor, state], [driven.pack(), command.pack()])
