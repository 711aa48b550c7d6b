"""Correction by the tracker's attitude, of the instant at which it was sensed (RK 5)."""

from typing import Any, NamedTuple

import casadi as ca

from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation.em_ekf.gravity import Gravity
from fmu_src.estimation.em_ekf.interface import In, Params, X
from fmu_src.estimation.em_ekf.north import Heading
from fmu_src.estimation.em_ekf.prediction import Due
from fmu_src.estimation.em_ekf.state import FILTER, Nominal, coils, levelled, tracker_residual
from fmu_src.filters.error_state import lazy_update


class Coils(NamedTuple):
    """Correction by the tracker.

    Attributes:
        nominal, P: state and covariance after it.
        nis: normalised innovation squared.
        by: whether it was made.
        doubted: time for which the tracker has not fitted [s].
    """

    nominal: Any
    P: Any
    nis: Any
    by: Any
    doubted: Any


def correct_by_tracker(
    p: Params, u: In, x: X, T: float, d: Due, gravity: Gravity, north: Heading
) -> Coils:
    """Return the correction by the tracker's attitude, of the instant at which it was sensed."""
    e = p.tracker
    trusted = ca.logic_and(ca.logic_not(gravity.accelerated), north.usable)
    by_coils = ca.logic_and(
        d.tracked, ca.logic_not(ca.logic_and(e.hard_switching, ca.logic_and(x.started, trusted)))
    )
    distance = ca.sqrt(ca.sumsqr(u.em_position - e.generator))
    R_e = (e.sigma * (1 + (distance / e.jitter_distance) ** 4)) ** 2 * ca.DM.eye(3)

    def with_tracker(
        nominal: Any, P: Any, z: Any, past: Any, age: Any, f: Any, R: Any, gate: Any
    ) -> tuple[Any, ...]:
        turn = sources.since(past, age, T)
        known = sources.measured("coils", Nominal, coils, nominal, turn, z)
        found = FILTER.correct(tracker_residual, nominal, known, P, R, gate)
        (level,) = sources.recorded("levelled", levelled, nominal, z, turn, f)
        return found.x, found.P, found.nis, level

    age = ca.fmax(u.em_age - e.lag, 0)
    attitude, force = d.came.attitude, d.mean[:3]
    nominal, P, nis, level = lazy_update(
        by_coils, with_tracker, north.nominal, north.P, attitude, d.past, age, force, R_e, e.gate
    )
    # Where metal bends the tracker's attitude, it mostly bends the vertical, too.
    beyond = ca.logic_and(nis > 3 * e.gate, level)
    return Coils(nominal, P, nis, by_coils, sources.doubted(x.tracked, by_coils, beyond, T))
