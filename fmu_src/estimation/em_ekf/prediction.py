"""Samples gathered between corrections, and the prediction over them."""

from typing import Any, NamedTuple

import casadi as ca

from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation.em_ekf.interface import Gathered, In, Params, X
from fmu_src.estimation.em_ekf.state import FILTER, SPACE, Nominal, process
from fmu_src.filters import triad
from fmu_src.filters.error_state import lazy_update
from fmu_src.math import rotations

AIDING = 1e-9
"""Rounding of sums of sample periods [s]."""
START_SIGMA = 1.0
"""Attitude before the first measurement [rad]: as good as unknown."""


def gather(x: Any, u: Any, turn: Any, sample: Any, rate: Any, noise: Any, T: float) -> Gathered:
    """Add a sample to the sums.

    Args:
        x: what was gathered.
        u: rate, force and field of the sample, (9,).
        turn: its rotation vector, bias taken off, (3,) [rad].
        sample: whether it came, whether it is lost, (2,).
        rate: body rate, bias taken off, (3,) [rad/s].
        noise: densities of the rate where it is lost and where not, error of its scale, (3,).
        T: sample period [s].
    """
    q = rotations.from_rotation_vector(turn)
    usable = sample[0] * (1 - sample[1])
    R = rotations.matrix(q).T
    turned = ca.vertcat(R @ x.sums[:3], R @ x.sums[3:])
    density = ca.if_else(sample[1], noise[0], noise[1]) ** 2 / 2
    size = ca.sqrt(ca.sumsqr(turn) + 1e-24)
    return Gathered(
        turn=rotations.normalize(rotations.multiply(x.turn, q)),
        angle=x.angle + size,
        variance=x.variance + (density + noise[2] ** 2 * ca.sumsqr(rate)) * T,
        time=x.time + T,
        waited=x.waited + T,
        sums=turned + usable * u[3:],
        count=x.count + usable,
    )


class Due(NamedTuple):
    """Measurements that are due at this sample.

    Attributes:
        sample: of the inertial unit, see `sources.inertial`.
        g: what the samples add up to.
        came: of the tracker, see `sources.arrival`.
        past: the tracker's past orientations, turned on to now.
        mean: mean specific force and field since the last correction, (6,).
        due: whether gravity and field are.
        by_tracker: whether the filter starts from the tracker's attitude.
        first: whether it starts at this sample.
        started: whether it has started by now.
        aided: whether gravity and field correct it.
        tracked: whether the tracker corrects it.
    """

    sample: Any
    g: Gathered
    came: Any
    past: Any
    mean: Any
    due: Any
    by_tracker: Any
    first: Any
    started: Any
    aided: Any
    tracked: Any


def collect(p: Params, u: In, x: X, T: float) -> Due:
    """Return what the samples add up to, and what of it is due."""
    i = p.inertial
    sample = sources.inertial(x.unit, u.rate, u.force, u.inertial_valid, p.limits, T)
    bias = x.nominal.rate_bias
    turn = sample.turn - bias * T

    # The covariance follows where something is measured.
    def gathering(old: Any, now: Any, turn: Any, flags: Any, rate: Any, noise: Any) -> Any:
        return gather(Gathered.unpack(old), now, turn, flags, rate, noise, T).pack()

    (gathered,) = sources.recorded(
        "gather",
        gathering,
        x.gathered.pack(),
        ca.vertcat(u.rate, u.force, u.field),
        turn,
        ca.vertcat(sample.fresh, sample.lost),
        sample.sensed[:3] - bias,
        ca.vertcat(i.moving_rate, i.rate_noise, i.rate_scale),
    )
    g = Gathered.unpack(gathered)
    past = sources.moved(x.tracked.past, turn)
    came = sources.arrival(x.tracked, past, u.em_attitude, u.em_new, u.em_age, T)

    # Gravity and field are due after their interval, and start the filter after the wait.
    due = ca.logic_and(g.waited >= i.interval - AIDING, g.count > 0)
    mean = g.sums / ca.fmax(g.count, 1)
    by_earth = ca.logic_and(ca.logic_not(x.started), ca.logic_and(due, x.age >= p.wait))
    begins = ca.logic_or(ca.logic_not(x.started), x.tracked.doubted > p.tracker.astray)
    by_tracker = ca.logic_and(begins, came.taken)
    first = ca.logic_or(by_earth, by_tracker)
    started = ca.logic_or(x.started, first)
    return Due(
        sample,
        g,
        came,
        past,
        mean,
        due,
        by_tracker,
        first,
        started,
        aided=ca.logic_and(started, due),
        tracked=ca.logic_and(started, came.taken),
    )


def predict(p: Params, x: X, d: Due) -> tuple[Any, Any, Any]:
    """Return state and covariance over all samples since the last correction, and if they moved."""
    i, e, g = p.inertial, p.tracker, d.g
    nominal, P = begun(p, x, d.came.attitude, d.mean, d.by_tracker, d.first)
    left = ca.exp(-g.angle / e.distortion_angle - g.time / e.distortion_time)
    Q = ca.diag(
        SPACE.diagonal(
            attitude=g.variance,
            rate_bias=i.bias_walk**2 * g.time,
            force_bias=i.force_bias_walk**2 * g.time,
            distortion=(1 - left**2) * e.distortion_sigma**2,
        )
    )

    def predicted(nominal: Any, P: Any, known: Any, Q: Any) -> tuple[Any, ...]:
        return FILTER.predict(process, nominal, known, P, Q)

    carried = ca.logic_and(x.started, ca.logic_or(d.due, d.came.taken))
    known = ca.vertcat(g.turn, x.nominal.rate_bias, g.time, left)
    return *lazy_update(carried, predicted, nominal, P, known, Q), carried


def begun(p: Params, x: X, z: Any, mean: Any, by_tracker: Any, first: Any) -> tuple[Any, Any]:
    """Nominal state and covariance, at the start those of nothing but a first attitude.

    Args:
        p: parameters.
        x: state before.
        z: attitude of the tracker, (4,).
        mean: mean specific force and field, (6,).
        by_tracker: whether it starts from the tracker's attitude, or from gravity and field.
        first: whether it starts at this sample.
    """
    e = p.tracker

    def attitudes(z: Any, mean: Any, h: Any, r: Any) -> Any:
        h, r = rotations.from_rotation_vector(h), rotations.from_rotation_vector(r)
        coils = rotations.multiply(rotations.multiply(r, z), rotations.conjugate(h))
        f, m = mean[:3], mean[3:]
        up = f / ca.sqrt(ca.sumsqr(f) + 1e-12)
        north = m / ca.sqrt(ca.sumsqr(m) + 1e-24)
        return coils, triad.attitude(up, north), h, r

    coils, earth, h, r = sources.recorded("begun", attitudes, z, mean, e.mounting, e.registration)
    nominal = Nominal(
        attitude=ca.if_else(by_tracker, coils, earth),
        rate_bias=ca.DM.zeros(3, 1),
        force_bias=ca.DM.zeros(3, 1),
        distortion=ca.DM.zeros(3, 1),
        mounting=h,
        registration=r,
    ).pack()
    i = p.inertial
    P = ca.diag(
        SPACE.diagonal(
            attitude=START_SIGMA**2,
            rate_bias=i.bias_sigma**2,
            force_bias=i.force_bias_sigma**2,
            distortion=e.distortion_sigma**2,
            mounting=e.mounting_sigma**2,
            registration=e.registration_sigma**2,
        )
    )
    return ca.if_else(first, nominal, x.nominal.pack()), ca.if_else(first, P, x.P)
