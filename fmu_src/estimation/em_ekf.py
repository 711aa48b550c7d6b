"""Attitude from an electromagnetic tracker and an inertial unit, by an extended filter (RK III).

    q'  = q (x) exp((w_m - b) T / 2)                               gyro, every sample (RK 2, 3)
    f_m = R^T g + b_a + v_f                                        gravity (RK 4)
    0   = atan2(e_y, e_x) + v_h,  e = R m                          heading by the magnetometer
    q_m = exp(d / 2) (x) r* (x) q_then (x) h (x) exp(v_e / 2)      tracker (RK III.B, 5)

| symbol | meaning |
| --- | --- |
| q, R | attitude q_WB and its matrix |
| b, b_a | bias of the gyro [rad/s] and of the accelerometer [m/s2], B |
| h | hand-eye rotation, from B to the coil frame C: RK's R_coil^imu |
| r | registration, from W to the tracker's frame F: RK's R_fg^nav |
| d | distortion of the tracker's attitude by metal, a rotation vector in F [rad] |
| g | gravity, (0, 0, g) in W |
| w_m, f_m, m | rate, specific force, field, as the unit gives them |
| q_m, q_then | attitude of C in F; attitude of B when it was measured, by the turns since |
| v_f, v_h, v_e | noise |
| t_g | lag of the inertial unit behind the tracker's clock [s], from which q is carried on |

RK's seven states are q and b. The filter in error-state form has three numbers for each of q, b,
b_a, d, h and r; one whose `_sigma` is zero is known and stays, so that with all but the first two
zero the states are RK's.

Switching. RK take gravity and magnetometer while the acceleration is below a threshold and the
field is undisturbed, else the tracker; both thresholds are hard, and the filter overshoots by 1.2
deg where the motion starts or stops. `hard_switching` does so. Otherwise the tracker is always
taken, but its distortion is a state: a first-order Gauss-Markov process that changes with the
angle turned through and with time, so what metal nearby adds is neither noise to be averaged away
nor believed. Gravity counts the less the more the specific force in W departs from its slow mean:
that shows horizontal acceleration as well as vertical, which the length of f alone does not.

Forces and fields are averaged in the turning body over `interval` before they correct: acceleration
of a hand and what disturbs the heading are no noise of a millisecond. Their densities are those of
slow disturbances.

A magnet on the instrument now and then gives the field's strength and dip by chance while the
instrument turns. So a field that showed iron counts again only after it has been right for a while:
`DOUBT` times as long as it was wrong, at most `hold`. Iron for a moment costs next to nothing then.
Hard switching goes by the moment alone, as RK's.

The jitter of the tracker grows with its distance from the field generator as s (1 + (x / x_0)^4).

Where all that the tracker says is beyond the gate for long, but its vertical is that of the
specific force, the filter has gone astray, and starts anew from the tracker.

The filter starts from the first attitude of the tracker, whatever it is; without one for `wait`,
from gravity and field. Heading then is as sure as the field is undisturbed.
"""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation import ports
from fmu_src.filters import triad
from fmu_src.filters.error_space import Space
from fmu_src.filters.error_state import NOTHING, Extended, chosen, correct_if
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, boolean, quaternion, real, vector
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
SIZE = SPACE.error_size
AIDING = 1e-9
"""Rounding of sums of sample periods [s]."""
LEVEL = np.radians(2.0)
"""Tilt of the tracker's vertical against the specific force that passes for none [rad]."""
SLOW, FADING = 1.0, 0.2
"""Times of the slow mean, and in which a seen acceleration is forgotten [s] (chosen)."""
DOUBT = 3.0
"""Seconds that a field must fit for each one that it did not (chosen on the BROAD trials)."""
START_SIGMA = 1.0
"""Attitude before the first measurement [rad]: as good as unknown."""


class Inertial(Parameters):
    """Gyro and accelerometer."""

    rate_noise = real(
        "rad/s/Hz0.5", "one-sided density of the gyro's noise", start=1.75e-4, min=1e-8, max=1.0
    )
    rate_scale = real(
        None,
        "relative error of the gyro's scale and alignment, as noise over a second",
        start=3e-3,
        min=0.0,
        max=0.2,
    )
    bias_walk = real("rad/s1.5", "density of the walk of b", start=3e-6, min=0.0, max=1.0)
    bias_sigma = real("rad/s", "of b at the start", start=0.02, min=0.0, max=1.0)
    moving_rate = ports.MOVING_RATE
    force_noise = real(
        "m/s2/Hz0.5",
        "one-sided density of the accelerometer's noise",
        start=3e-3,
        min=1e-8,
        max=10.0,
    )
    force_bias_sigma = real("m/s2", "of b_a at the start", start=0.03, min=0.0, max=5.0)
    force_bias_walk = real("m/s2.5", "density of the walk of b_a", start=1e-5, min=0.0, max=1.0)
    hand_density = real(
        "m/s2/Hz0.5",
        "one-sided density of acceleration that is taken for tilt",
        start=0.02,
        min=0.0,
        max=10.0,
    )
    hand_gain = real(
        None, "how much a seen acceleration counts as noise of gravity", start=3.0, min=0.0, max=100
    )
    gravity = real("m/s2", "length of g", start=design.SITE_GRAVITY, min=1.0, max=20.0)
    quiet = real(
        "m/s2",
        "departure of the specific force from g below which hard switching believes in gravity",
        start=0.1,
        min=0.0,
        max=10.0,
    )
    interval = real("s", "over which forces and fields are averaged", start=0.01, min=1e-3, max=1.0)


class Magnetic(Parameters):
    """Magnetometer."""

    used = boolean("whether there is one", start=True)
    strength = real(
        "T", "of the field at the site", start=design.MAGNETIC_FIELD, min=1e-6, max=1e-3
    )
    inclination = real("rad", "dip of the field", start=design.MAGNETIC_INCLINATION, within=1.5)
    noise = real("T/Hz0.5", "one-sided density of its noise", start=8.5e-8, min=0.0, max=1e-4)
    heading_density = real(
        "rad/Hz0.5",
        "one-sided density of what disturbs the heading, slow as it is",
        start=0.05,
        min=1e-6,
        max=10.0,
    )
    disturbed_density = real(
        "rad/Hz0.5",
        "the same where strength or dip tell iron: a heading is better than none",
        start=1.0,
        min=1e-6,
        max=1e3,
    )
    strength_limit = real(
        None, "departure from the strength, relative, that tells iron", start=0.08, min=0, max=1
    )
    dip_limit = real(
        "rad", "departure from the dip that tells iron", start=np.radians(5), min=0.0, max=3.0
    )
    hold = real(
        "s",
        "longest time for which strength and dip must fit before a field that showed iron counts"
        " again",
        start=2.0,
        min=0.0,
        max=60.0,
    )


class Tracker(Parameters):
    """Electromagnetic tracker, and how it is fixed to the unit and the world."""

    sigma = real("rad", "jitter s of an axis", start=np.radians(0.1), min=1e-6, max=1.0)
    generator = real(
        "m", "place of the field generator in F", shape=3, start=(0.3, 0, 0), within=10
    )
    jitter_distance = real("m", "distance x_0 of double jitter", start=0.4, min=0.01, max=1e3)
    distortion_sigma = real("rad", "of d, each axis", start=np.radians(0.4), min=0.0, max=1.0)
    distortion_angle = real(
        "rad", "turn after which d is another one", start=0.35, min=1e-3, max=100.0
    )
    distortion_time = real("s", "time after which d is another one", start=20.0, min=1e-2, max=1e5)
    mounting = real("rad", "rotation vector of h", shape=3, within=4.0)
    mounting_sigma = real("rad", "of h", start=0.0, min=0.0, max=1.0)
    registration = real("rad", "rotation vector of r", shape=3, within=4.0)
    registration_sigma = real("rad", "of r", start=0.0, min=0.0, max=1.0)
    lag = real(
        "s", "t_g, by which the inertial unit is behind the tracker's clock", start=0.0, within=0.05
    )
    gate = ports.gate("an attitude counts less")
    astray = ports.astray(2.0)
    patience = ports.patience(0.2)
    hard_switching = boolean("whether it is used only where gravity or field are not (RK III.D)")


class Params(Parameters):
    """Everything that is known beforehand."""

    limits: Any = sources.Limits
    inertial: Any = Inertial
    magnetic: Any = Magnetic
    tracker: Any = Tracker
    wait = real(
        "s", "for the tracker, before gravity and field start the filter", start=0.3, min=0, max=60
    )
    attitude_limit = ports.attitude_limit(0.02)


class In(Inputs):
    """Samples of both."""

    rate = ports.RATE
    force = ports.FORCE
    field = vector("T", "magnetometer, B", within=1.0)
    inertial_valid = ports.INERTIAL_VALID
    em_position = vector("m", "coils in F", within=100.0)
    em_attitude = ports.tracked_attitude("C in F")
    em_new = boolean("an attitude arrives at this instant")
    em_age = real("s", "its age on arrival", start=0.025, min=0.0, max=10.0)


class Gathered(State):
    """Sums over the samples since the last correction, in the body as it is now."""

    turn = quaternion("quaternion turned through")
    angle = real("rad", "angle turned through", min=0.0)
    variance = real("rad2", "what the gyro's noise added, each axis", min=0.0)
    time = real("s", "since the covariance was carried on", min=0.0)
    waited = real("s", "since gravity and field were taken", min=0.0)
    sums = real(None, "sum of forces and fields", shape=6)
    count = real(None, "samples in it", min=0.0)


class Acceleration(State):
    """Acceleration seen in the specific force."""

    slow = real("m/s2", "slow mean of the specific force in W", shape=3)
    level = real("m/s2", "departure from it, falling slowly", min=0.0)
    seen = boolean("whether there is a slow mean")


class X(State):
    """Filter, and what is kept of the samples."""

    nominal: Any = Nominal
    P = SPACE.covariance()
    started = boolean("whether the filter has an attitude")
    age = real("s", "time since the first sample", min=0.0)
    gathered: Any = Gathered
    acceleration: Any = Acceleration
    unit: Any = sources.Unit
    tracked: Any = sources.Tracked
    disturbed = boolean("whether the field was disturbed when last looked at")
    doubt = real("s", "for which its strength and dip still have to fit", min=0.0)


class Out(Outputs):
    """Attitude, and how far to believe it."""

    attitude = ports.ATTITUDE
    body_rate = vector("rad/s", "body rate in B, bias removed")
    rate_bias = vector("rad/s", "bias of the gyro in B")
    distortion = vector("rad", "distortion d of the tracker's attitude in F")
    mounting = quaternion("hand-eye rotation q_BC")
    registration = quaternion("registration q_WF")
    valid = boolean("the attitude may be used")
    inertial_lost = ports.INERTIAL_LOST
    em_lost = boolean("the tracker has said nothing usable for longer than its patience")
    accelerated = boolean("gravity counts less than half, or not at all: the body accelerates")
    magnetic_disturbance = boolean(
        "the magnetometer hardly counts: strength or dip of its field, now or not long ago"
    )
    attitude_sigma = ports.ATTITUDE_SIGMA
    rate_bias_sigma = ports.RATE_BIAS_SIGMA
    distortion_sigma = vector("rad", "standard deviation of d", min=0.0)
    mounting_sigma = vector("rad", "standard deviation of h", min=0.0)
    registration_sigma = vector("rad", "standard deviation of r", min=0.0)
    innovation_squared = ports.INNOVATION_SQUARED
    innovation_size = ports.INNOVATION_SIZE


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


def gather(x: Any, u: Any, turn: Any, sample: Any, rate: Any, noise: Any, T: float) -> Gathered:
    """One sample more.

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


def accelerating(q: Any, force: Any, noise: Any, h: Any, x: Any) -> Acceleration:
    """Measure how much the specific force in W departs from its slow mean.

    Args:
        q: attitude.
        force: mean specific force over h, bias taken off, (3,) [m/s2].
        noise: its standard deviation [m/s2].
        h: time since the last one [s].
        x: what was seen.
    """
    now = rotations.matrix(q) @ force
    slow = ca.if_else(x.seen, x.slow + ca.fmin(h / SLOW, 1) * (now - x.slow), now)
    apart = ca.sqrt(ca.sumsqr(now - slow))
    level = ca.fmax(x.level * ca.exp(-h / FADING), ca.fmax(apart - 5 * noise, 0))
    return Acceleration(slow=slow, level=level, seen=1)


def disturbance(site: Any, q: Any, field: Any) -> Any:
    """Return whether strength or dip of a field are not those of the site.

    Args:
        site: strength [T] and dip [rad], and how far a field may depart from them, (4,).
        q: attitude.
        field: in B, (3,) [T].
    """
    size = ca.sqrt(ca.sumsqr(field) + 1e-24)
    dip = ca.asin(ca.fmax(ca.fmin(-(rotations.matrix(q)[2, :] @ field) / size, 1), -1))
    return ca.logic_or(ca.fabs(size / site[0] - 1) > site[2], ca.fabs(dip - site[1]) > site[3])


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


def _collect(p: Params, u: In, x: X, T: float) -> Due:
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


def _predict(p: Params, x: X, d: Due) -> tuple[Any, Any, Any]:
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
    return *chosen(carried, predicted, nominal, P, known, Q), carried


class Gravity(NamedTuple):
    """Correction by the specific force.

    Attributes:
        nominal, P: state and covariance after it.
        nis: normalised innovation squared.
        by: whether it was made.
        acceleration: next `Acceleration`, packed.
        accelerated: whether the hand accelerates.
    """

    nominal: Any
    P: Any
    nis: Any
    by: Any
    acceleration: Any
    accelerated: Any


def _correct_by_gravity(p: Params, x: X, d: Due, nominal: Any, P: Any) -> Gravity:
    """Return the correction by the mean specific force, weaker where the hand accelerates."""
    i, e, g = p.inertial, p.tracker, d.g
    q = Nominal.unpack(nominal).attitude
    noise_f = i.force_noise / ca.sqrt(2 * g.waited)
    force = d.mean[:3] - Nominal.unpack(nominal).force_bias
    (seen,) = sources.recorded(
        "accelerating",
        lambda q, f, n, h, a: accelerating(q, f, n, h, Acceleration.unpack(a)).pack(),
        q,
        force,
        noise_f,
        g.waited,
        x.acceleration.pack(),
    )
    acceleration = ca.if_else(d.aided, seen, x.acceleration.pack())
    level = Acceleration.unpack(acceleration).level
    calm = ca.fabs(ca.sqrt(ca.sumsqr(d.mean[:3])) - i.gravity) < i.quiet
    resting = noise_f**2 + i.hand_density**2 / (2 * g.waited)
    moving = ca.if_else(e.hard_switching, 0, i.hand_gain * level) ** 2
    accelerated = ca.if_else(e.hard_switching, ca.logic_not(calm), moving > resting)
    R_f = (resting + moving) * ca.DM.eye(3)
    by_gravity = ca.logic_and(d.aided, ca.logic_not(ca.logic_and(e.hard_switching, accelerated)))
    known = ca.vertcat(d.mean[:3], i.gravity)
    nominal, P, nis = correct_if(
        by_gravity, FILTER, gravity_residual, nominal, P, known, R_f, e.gate
    )
    return Gravity(nominal, P, nis, by_gravity, acceleration, accelerated)


class Heading(NamedTuple):
    """Correction by the magnetic field.

    Attributes:
        nominal, P: state and covariance after it.
        nis: normalised innovation squared.
        by: whether it was made.
        usable: whether the field may be used.
        doubt: time for which a field that was strange is not believed [s].
        disturbed: whether it is strange.
    """

    nominal: Any
    P: Any
    nis: Any
    by: Any
    usable: Any
    doubt: Any
    disturbed: Any


def _correct_by_field(p: Params, x: X, d: Due, gravity: Gravity) -> Heading:
    """Return the correction of the heading, weaker where the field is disturbed."""
    m, e, g = p.magnetic, p.tracker, d.g
    nominal, field = gravity.nominal, d.mean[3:]
    site = ca.vertcat(m.strength, m.inclination, m.strength_limit, m.dip_limit)
    (strange,) = sources.recorded(
        "disturbance", disturbance, site, Nominal.unpack(nominal).attitude, field
    )
    grown = ca.fmin(x.doubt + DOUBT * g.waited, ca.if_else(e.hard_switching, 0, m.hold))
    left_over = ca.fmax(x.doubt - g.waited, 0)
    doubt = ca.if_else(d.aided, ca.if_else(strange, grown, left_over), x.doubt)
    disturbed = ca.if_else(d.aided, ca.logic_or(strange, doubt > 0), x.disturbed)
    horizontal = m.strength * ca.cos(m.inclination)
    heading_density = ca.if_else(disturbed, m.disturbed_density, m.heading_density)
    R_h = ((m.noise / horizontal) ** 2 + heading_density**2) / (2 * g.waited)
    usable = ca.logic_and(m.used, ca.logic_not(disturbed))
    by_heading = ca.logic_and(gravity.by, ca.if_else(e.hard_switching, usable, m.used))
    q = Nominal.unpack(nominal).attitude
    (measured,) = sources.recorded("heading", heading, q, field)
    known = ca.vertcat(measured, q, m.inclination)
    nominal, P, nis = correct_if(
        by_heading, FILTER, heading_residual, nominal, gravity.P, known, R_h, e.gate
    )
    return Heading(nominal, P, nis, by_heading, usable, doubt, disturbed)


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


def _correct_by_tracker(
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
        known = sources.measured("coils", _coils, nominal, turn, z)
        found = FILTER.correct(tracker_residual, nominal, known, P, R, gate)
        (level,) = sources.recorded("levelled", levelled, nominal, z, turn, f)
        return found.x, found.P, found.nis, level

    age = ca.fmax(u.em_age - e.lag, 0)
    attitude, force = d.came.attitude, d.mean[:3]
    nominal, P, nis, level = chosen(
        by_coils, with_tracker, north.nominal, north.P, attitude, d.past, age, force, R_e, e.gate
    )
    # Where metal bends the tracker's attitude, it mostly bends the vertical, too.
    beyond = ca.logic_and(nis > 3 * e.gate, level)
    return Coils(nominal, P, nis, by_coils, sources.doubted(x.tracked, by_coils, beyond, T))


def step(p: Params, u: In, x: X, T: float) -> tuple[X, Out]:
    """Return state and outputs one sample later."""
    d = _collect(p, u, x, T)
    nominal, P, carried = _predict(p, x, d)
    gravity = _correct_by_gravity(p, x, d, nominal, P)
    north = _correct_by_field(p, x, d, gravity)
    coils = _correct_by_tracker(p, u, x, T, d, gravity, north)
    P = coils.P

    # What is gathered begins anew where it was used.
    g, emptied = d.g, ca.logic_or(carried, d.first)
    used = ca.logic_or(ca.logic_or(d.aided, d.first), d.due)
    g = Gathered(
        turn=ca.if_else(emptied, ca.DM([1, 0, 0, 0]), g.turn),
        angle=ca.if_else(emptied, 0, g.angle),
        variance=ca.if_else(emptied, 0, g.variance),
        time=ca.if_else(emptied, 0, g.time),
        waited=ca.if_else(used, 0, g.waited),
        sums=ca.if_else(used, 0, g.sums),
        count=ca.if_else(used, 0, g.count),
    )
    state = Nominal.unpack(coils.nominal)
    rate = d.sample.sensed[:3] - state.rate_bias
    (attitude,) = sources.recorded("now", now, state.attitude, g.turn, rate * p.tracker.lag)
    variances = ca.fmax(ca.diag(P), 0) + NOTHING
    sigma = {name: ca.sqrt(variances[place]) for name, place in SPACE.places.items()}
    attitude_sigma = ca.sqrt(variances[SPACE.places["attitude"]] + g.variance)
    well_known = ca.mmax(attitude_sigma) < p.attitude_limit
    aided_by_coils = 1 - d.by_tracker
    nis = gravity.nis + north.nis + aided_by_coils * coils.nis
    return (
        X(
            nominal=state,
            P=P,
            started=d.started,
            age=ca.fmin(x.age + T, 1e6),
            gathered=g,
            acceleration=Acceleration.unpack(gravity.acceleration),
            unit=d.sample.unit,
            tracked=d.came.tracked.replace(doubted=coils.doubted),
            disturbed=north.disturbed,
            doubt=north.doubt,
        ),
        Out(
            attitude=attitude,
            body_rate=rate,
            rate_bias=state.rate_bias,
            distortion=state.distortion,
            mounting=rotations.canonical(state.mounting),
            registration=rotations.canonical(state.registration),
            valid=ca.logic_and(d.started, well_known),
            inertial_lost=d.sample.lost,
            em_lost=d.came.tracked.quiet > p.tracker.patience,
            accelerated=gravity.accelerated,
            magnetic_disturbance=ca.logic_and(p.magnetic.used, north.disturbed),
            attitude_sigma=attitude_sigma,
            rate_bias_sigma=sigma["rate_bias"],
            distortion_sigma=sigma["distortion"],
            mounting_sigma=sigma["mounting"],
            registration_sigma=sigma["registration"],
            innovation_squared=ca.fmax(nis, 0),
            innovation_size=3 * gravity.by + north.by + 3 * coils.by * aided_by_coils,
        ),
    )


def _coils(x: Any, turn: Any) -> Any:
    return coils(Nominal.unpack(x), turn)


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


MODEL = Model.of_step("EmInertialEkf", step, sample_period=1e-3, matrix=True)
