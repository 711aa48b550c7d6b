"""Pose from an optical tracker and an inertial unit: the model, and a step of its filter (E13 3).

| symbol | meaning |
| --- | --- |
| q, p, v | attitude q_WB, position and velocity of the inertial unit, as old as its samples |
| w, f | body rate and specific force: (1 + M) sample - b |
| b_g, b_a | biases of rate and force |
| M_g, M_a | what is left of scale and misalignment, (3, 3) |
| G | specific force at rest in W: the tracker's axes need not be level |
| t_g, t_a | lag of rate and force behind the tracker's clock [s] |
| l, m | lever arm from the unit to the tracked body O, in B; mounting, the rotation q_BO |
| o_p, o_f | slow and fast error of the tracker's position, in W |
| o_q | error of its attitude, in O |
| r_i | marker i in O |
| z_p, z_q, z_i, d | pose and markers from the tracker, and their age when they arrive [s] |

    q' = q (x) exp((w + w') h / 4 + w x w' h^2 / 24),    a = R(t_a) f - G
    v' = v + h (a + a') / 2,    p' = p + h v + h^2 (2 a + a') / 6
    z_p = p + v s + a s^2 / 2 + R l + o_p + o_f,    z_q = q (x) exp(w s / 2) (x) m (x) exp(o_q / 2)

h is the time since the inertial sample before, and s how much later than the state the pose was
taken: the lag, less the age. E13 carries acceleration and rate as states and measures them, sixteen
numbers with fifteen degrees of freedom; here the inertial unit drives the process, and its biases
are in their place. Lever arm, mounting, lags, scale, misalignment, G and the tracker's own errors
are further states. One whose `_sigma` is zero is known and stays as it is.

A tracker's errors are not white: they hold as long as the same markers are seen from the same side.
What is given out is the pose in the tracker's own coordinates, these errors included, as everything
is that is registered with it.

A pose that arrives late is compared with where the state was: the rotation, velocity and way since
then, from the samples kept, take the state back. Where fewer than three markers are seen there is
no pose, and each marker corrects by itself.

Without fresh inertial samples, or with ones that are frozen or clipped, the last rate and force
hold and the process noise is that of a moving hand.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from fmu_src.device import design
from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation import ports
from fmu_src.filters.error_space import Space, jacobian_at_zero
from fmu_src.filters.error_state import Filter, chosen, deviation
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import boolean, quaternion, real, vector
from fmu_src.math import rotations

SAMPLE_PERIOD = 1e-3
KEPT = 128
"""Inertial samples that are kept for late poses."""
LONG = 1e3
"""Longest time that is counted [s]."""
OPEN = 1e6
"""Gate that nothing is beyond: a pose is not doubted twice, the state may be what is wrong."""
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


class Inertial(Parameters):
    """The inertial unit: its noise, and what drifts."""

    rate_noise = real("rad/s/Hz0.5", "density of the rate", start=2e-4, min=1e-8, max=10.0)
    force_noise = real("m/s2/Hz0.5", "density of the force", start=4e-3, min=1e-8, max=100.0)
    rate_bias_walk = real("rad/s1.5", "walk of b_g", start=1e-5, min=0.0, max=1.0)
    force_bias_walk = real("m/s2.5", "walk of b_a", start=1e-4, min=0.0, max=1.0)
    rate_matrix_walk = real("1/s0.5", "walk of M_g", start=0.0, min=0.0, max=0.1)
    force_matrix_walk = real("1/s0.5", "walk of M_a", start=0.0, min=0.0, max=0.1)
    rate_bias_sigma = real("rad/s", "of b_g at the start", start=0.02, min=0.0, max=1.0)
    force_bias_sigma = real("m/s2", "of b_a at the start", start=0.2, min=0.0, max=5.0)
    rate_matrix_sigma = real(None, "of M_g at the start", start=0.01, min=0.0, max=0.2)
    force_matrix_sigma = real(None, "of M_a at the start", start=0.01, min=0.0, max=0.2)
    between = real(
        None,
        "error of the straight line between two samples, of their difference",
        start=0.1,
        min=0.0,
        max=1.0,
    )
    moving_rate = ports.MOVING_RATE
    moving_force = real(
        "m/s2/Hz0.5", "density of the force where no sample tells it", start=3.0, min=1e-2, max=1e3
    )


class Mounting(Parameters):
    """Place of the inertial unit on the tracked body, and its lag behind the tracker's clock."""

    lever = real("m", "l in B", shape=3, within=2.0)
    lever_sigma = real("m", "how well it is known", start=0.05, min=0.0, max=1.0)
    rotation = real("rad", "rotation vector of m", shape=3, within=4.0)
    rotation_sigma = real("rad", "how well it is known", start=0.05, min=0.0, max=1.0)
    rate_lag = real("s", "t_g", within=0.05)
    force_lag = real("s", "t_a", within=0.05)
    lag_sigma = real("s", "how well they are known", start=3e-3, min=0.0, max=0.1)


class Tracker(Parameters):
    """The optical tracker: its noise and its slower errors."""

    position_noise = real("m", "of each position", start=1e-4, min=1e-7, max=0.1)
    attitude_noise = real("rad", "of each attitude", start=1e-3, min=1e-6, max=1.0)
    marker_noise = real("m", "of each marker seen by itself", start=2e-4, min=1e-7, max=0.1)
    position_offset_sigma = real("m", "of o_p", start=2e-4, min=0.0, max=0.1)
    position_offset_memory = real("s", "in which o_p changes", start=5.0, min=1e-3, max=1e4)
    flicker_sigma = real("m", "of o_f", start=0.0, min=0.0, max=0.1)
    flicker_memory = real("s", "in which o_f changes", start=0.05, min=1e-3, max=1e4)
    attitude_offset_sigma = real("rad", "of o_q", start=1e-3, min=0.0, max=0.1)
    attitude_offset_memory = real("s", "in which o_q changes", start=1.0, min=1e-3, max=1e4)
    markers = real("m", "r_i in O, one a row", shape=(MARKERS, 3), start=design.MARKERS, within=1.0)
    gate = ports.gate("a pose counts less unless the one before was as unlikely")
    patience = ports.patience(0.1)


class Params(Parameters):
    """Everything that is known beforehand."""

    limits: Any = sources.Limits
    inertial = Inertial
    mounting = Mounting
    tracker = Tracker
    gravity = real("m/s2", "length of G", start=design.SITE_GRAVITY, min=1.0, max=20.0)
    gravity_sigma = real("m/s2", "of G, mostly by the tracker's level", start=0.2, min=0.0, max=5.0)
    velocity_sigma = real("m/s", "of v at the first pose", start=0.3, min=1e-6, max=10.0)
    position_limit = ports.POSITION_LIMIT
    attitude_limit = ports.attitude_limit(0.1)


class In(ports.PoseInputs):
    """Samples of both, and single markers."""

    optical_markers_new = boolean("markers arrive at this instant; used where there is no pose")
    optical_marker1 = vector("m", "z_1 in W", within=1e3)
    optical_marker2 = vector("m", "z_2 in W", within=1e3)
    optical_marker3 = vector("m", "z_3 in W", within=1e3)
    optical_marker4 = vector("m", "z_4 in W", within=1e3)
    optical_visible1 = boolean("marker 1 is among them")
    optical_visible2 = boolean("marker 2 is among them")
    optical_visible3 = boolean("marker 3 is among them")
    optical_visible4 = boolean("marker 4 is among them")


class X(State):
    """Filter, and what is kept of the samples."""

    nominal = Nominal
    P = SPACE.covariance()
    started = boolean("a pose has come")
    unit: Any = sources.Unit
    pending = real("s", "time since the process was carried on", min=0.0)
    past = real(None, "rate and force, newest first", shape=(6, KEPT), listed=False)
    steps = real("s", "time before each of them", shape=KEPT, listed=False)
    pose = real(None, "last pose that came", shape=7)
    doubted = boolean("the last pose was beyond the gate")
    unseen = real("s", "time since a pose or a marker was used", min=0.0)


class Out(Outputs):
    """Pose of the tracked body now, how far to believe it, and what has been learnt."""

    attitude = quaternion("q_WO")
    position = vector("m", "of the tracked body in W")
    velocity = vector("m/s", "of the tracked body in W")
    body_rate = vector("rad/s", "body rate in B, bias removed")
    valid = boolean("the pose may be used")
    inertial_lost = ports.INERTIAL_LOST
    optical_lost = boolean("no pose or marker could be used of late")
    attitude_sigma = ports.ATTITUDE_SIGMA
    position_sigma = ports.POSITION_SIGMA
    velocity_sigma = ports.VELOCITY_SIGMA
    rate_bias = vector("rad/s", "b_g in B")
    rate_bias_sigma = vector("rad/s", "its standard deviation", min=0.0)
    force_bias = vector("m/s2", "b_a in B")
    force_bias_sigma = vector("m/s2", "its standard deviation", min=0.0)
    lever = vector("m", "l in B")
    lever_sigma = vector("m", "its standard deviation", min=0.0)
    mounting = quaternion("q_BO")
    mounting_sigma = vector("rad", "its standard deviation in O", min=0.0)
    rate_lag = real("s", "t_g")
    rate_lag_sigma = real("s", "its standard deviation", min=0.0)
    force_lag = real("s", "t_a")
    force_lag_sigma = real("s", "its standard deviation", min=0.0)
    innovation_squared = ports.INNOVATION_SQUARED
    innovation_size = ports.INNOVATION_SIZE


def arrived(u: Any, before: Any) -> tuple[Any, Any]:
    """Return whether a new pose arrives that is one, and the pose (7,).

    Args:
        u: inputs `optical_position`, `optical_attitude` and `optical_new`.
        before: the last pose that came, (7,).
    """
    proper, attitude = sources.of_unit_length(u.optical_attitude)
    z = ca.vertcat(u.optical_position, attitude)
    repeated = ca.sumsqr(z - before) == 0
    return ca.logic_and(u.optical_new, ca.logic_and(proper, ca.logic_not(repeated))), z


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


def _way_back(x: Any, past: Any, steps: Any, age: Any) -> tuple[Any, Any, Any]:
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


class Advanced(NamedTuple):
    """State at this inertial sample, before any correction.

    Attributes:
        sample: of the inertial unit, see `sources.inertial`.
        nominal, P: state and covariance at the last due sample.
        past, steps: rates and forces of the last due samples, and their periods.
        pending: time since the last due sample [s].
    """

    sample: Any
    nominal: Any
    P: Any
    past: Any
    steps: Any
    pending: Any


class Corrected(NamedTuple):
    """State after a pose, single markers, or a start.

    Attributes:
        nominal, P: state and covariance.
        nis: normalised innovation squared.
        size: its degrees of freedom.
        doubted: whether the last pose did not fit.
        used: whether the tracker corrected or started the filter.
        started: whether it has started by now.
        z: pose of the tracker, (7,).
    """

    nominal: Any
    P: Any
    nis: Any
    size: Any
    doubted: Any
    used: Any
    started: Any
    z: Any


@dataclass(frozen=True)
class _Step:
    """One sample, by a filter on `SPACE`."""

    method: Filter

    def predict(self, nominal: Any, P: Any, known: Any, Q: Any) -> tuple[Any, ...]:
        """Return state and covariance after the motion between two samples."""
        return self.method.predict(process, nominal, known, P, Q)

    def correct(
        self,
        function: Any,
        nominal: Any,
        P: Any,
        past: Any,
        steps: Any,
        age: Any,
        z: Any,
        R: Any,
        g: Any,
    ) -> tuple[Any, ...]:
        """Return state, covariance and nis after a measurement of some age."""
        known = ca.vertcat(*_way_back(nominal, past, steps, age), z)
        found = self.method.correct(function, nominal, known, P, R, g)
        return found.x, found.P, found.nis

    def advance(self, p: Any, u: Any, x: Any, T: float) -> Advanced:
        """Return the state up to this inertial sample; where one is overdue the last one holds."""
        unit, tracker = p.inertial, p.tracker
        sample = sources.inertial(x.unit, u.rate, u.force, u.inertial_valid, p.limits, T)
        sensed = sample.sensed
        due = ca.logic_or(sample.fresh, sample.unit.pending > p.limits.patience)
        pending = x.pending + T
        left = ca.exp(
            -pending
            / ca.vertcat(
                tracker.position_offset_memory,
                tracker.flicker_memory,
                tracker.attitude_offset_memory,
            )
        )
        change = sensed - x.unit.sensed
        Q = ca.diag(_process_noise(unit, tracker, sample.lost, change, pending, left))
        known = ca.vertcat(x.unit.sensed, sensed, pending, left)
        going = ca.logic_and(due, x.started)
        nominal, P = chosen(going, self.predict, x.nominal.pack(), x.P, known, Q)
        return Advanced(
            sample,
            nominal,
            P,
            past=ca.if_else(due, ca.horzcat(sensed, x.past[:, :-1]), x.past),
            steps=ca.if_else(due, ca.vertcat(pending, x.steps[:-1]), x.steps),
            pending=ca.if_else(due, 0, pending),
        )

    def by_tracker(self, p: Any, u: Any, x: Any, now: Advanced) -> Corrected:
        """Return the state after a pose, or after single markers where there is none."""
        tracker, past, steps = p.tracker, now.past, now.steps
        taken, z = arrived(u, x.pose)
        age = u.optical_age - now.pending
        known_then = age <= ca.sum1(steps[:-1])
        usable = ca.logic_and(ca.logic_and(taken, known_then), x.started)
        position, attitude = tracker.position_noise, tracker.attitude_noise
        R = ca.diag(ca.vertcat(ca.repmat(position**2, 3, 1), ca.repmat(attitude**2, 3, 1)))
        gate = ca.if_else(x.doubted, OPEN, tracker.gate)
        nominal, P, nis = chosen(
            usable,
            lambda *values: self.correct(residual, *values),
            *(now.nominal, now.P, past, steps, age, z, R, gate),
        )
        doubted = ca.if_else(usable, nis > POSE * tracker.gate, x.doubted)

        visible = ca.vertcat(
            u.optical_visible1, u.optical_visible2, u.optical_visible3, u.optical_visible4
        )
        count = ca.sum1(visible)
        single = ca.logic_and(ca.logic_and(u.optical_markers_new, count > 0), known_then)
        single = ca.logic_and(ca.logic_and(single, ca.logic_not(taken)), x.started)
        seen = ca.vertcat(
            u.optical_marker1, u.optical_marker2, u.optical_marker3, u.optical_marker4
        )
        nominal, P, marker_nis = chosen(
            single,
            lambda *values: self.correct(marker_residual, *values),
            *(nominal, P, past, steps, age),
            ca.vertcat(seen, visible, ca.vec(tracker.markers.T)),
            tracker.marker_noise**2 * ca.DM.eye(MARKER),
            gate * count / MARKERS,
        )

        first = ca.logic_and(taken, ca.logic_not(x.started))
        nominal, P = chosen(
            first,
            lambda _nominal, _P, start, variance: (start, ca.diag(variance)),
            *(nominal, P, _start(p, z), _start_variance(p)),
        )
        return Corrected(
            nominal,
            P,
            nis=nis + marker_nis,
            size=POSE * usable + 3 * count * single,
            doubted=doubted,
            used=ca.logic_or(ca.logic_or(usable, single), first),
            started=ca.logic_or(x.started, first),
            z=z,
        )

    def __call__(self, p: Any, u: Any, x: Any, T: float) -> tuple[X, Out]:
        """Return state and outputs one sample later."""
        now = self.advance(p, u, x, T)
        found = self.by_tracker(p, u, x, now)
        P, started = found.P, found.started
        unseen = ca.if_else(found.used, 0, x.unseen + T)
        state = Nominal.unpack(found.nominal)
        q_now, p_now, v_now, w_now, J = _now()(found.nominal, now.sample.sensed, now.pending)
        of_pose = deviation(ca.sum1((P @ J) * J).T)
        of_state = deviation(ca.diag(P))
        part = {name: of_state[place] for name, place in SPACE.places.items()}
        known_well = ca.logic_and(
            ca.mmax(of_pose[:3]) < p.attitude_limit, ca.mmax(of_pose[3:6]) < p.position_limit
        )
        following = X(
            nominal=state,
            P=P,
            started=started,
            unit=now.sample.unit,
            pending=now.pending,
            past=now.past,
            steps=now.steps,
            pose=ca.if_else(u.optical_new, found.z, x.pose),
            doubted=found.doubted,
            unseen=ca.fmin(unseen, LONG),
        )
        return following, Out(
            attitude=ca.if_else(started, q_now, ca.DM([1, 0, 0, 0])),
            position=p_now,
            velocity=v_now,
            body_rate=w_now,
            valid=ca.logic_and(started, known_well),
            inertial_lost=now.sample.lost,
            optical_lost=ca.logic_or(unseen > p.tracker.patience, ca.logic_not(started)),
            attitude_sigma=of_pose[:3],
            position_sigma=of_pose[3:6],
            velocity_sigma=of_pose[6:],
            **{f"{name}_sigma": part[name] for name in _REPORTED},
            rate_bias=state.rate_bias,
            force_bias=state.force_bias,
            lever=state.lever,
            mounting=ca.if_else(started, rotations.canonical(state.mounting), ca.DM([1, 0, 0, 0])),
            rate_lag=state.rate_lag,
            force_lag=state.force_lag,
            innovation_squared=ca.fmax(found.nis, 0),
            innovation_size=found.size,
        )


def make(name: str, method: Filter) -> Model:
    """Return the model of this estimator with one of the filters on `SPACE`, under a name."""
    # Derivatives of Jacobians of 53 errors would be half of the binary and of the time to build it.
    return Model(
        name,
        _Step(method),
        Params,
        In,
        X,
        Out,
        sample_period=SAMPLE_PERIOD,
        matrix=True,
        derivatives=False,
    )


_REPORTED = (
    "rate_bias",
    "force_bias",
    "lever",
    "mounting",
    "rate_lag",
    "force_lag",
)
"""States whose standard deviations are outputs, beside those of the pose."""


def _process_noise(
    unit: Inertial, tracker: Tracker, lost: Any, change: Any, h: Any, left: Any
) -> Any:
    """Variance that a time h adds, (n,), in which the samples changed by so much, (6,)."""
    # White noise of the one-sided density N, summed up over a time h: N^2 h / 2.
    rate = ca.if_else(lost, unit.moving_rate, unit.rate_noise) ** 2 / 2
    force = ca.if_else(lost, unit.moving_force, unit.force_noise) ** 2 / 2
    # A knock is over before the next sample tells how it went on.
    bent = unit.between**2 * h**2 * change**2
    bent_rate, bent_force = (ca.sum1(part) / 3 for part in (bent[:3], bent[3:]))
    gone = 1 - left**2
    return SPACE.diagonal(
        attitude=rate * h + bent_rate,
        position=force * h**3 / 3 + bent_force * h**2 / 4,
        velocity=force * h + bent_force,
        rate_bias=unit.rate_bias_walk**2 * h,
        force_bias=unit.force_bias_walk**2 * h,
        rate_matrix=unit.rate_matrix_walk**2 * h,
        force_matrix=unit.force_matrix_walk**2 * h,
        position_offset=gone[0] * tracker.position_offset_sigma**2,
        flicker=gone[1] * tracker.flicker_sigma**2,
        attitude_offset=gone[2] * tracker.attitude_offset_sigma**2,
    )


def _start(p: Params, z: Any) -> Any:
    """Nominal state at the first pose (7,), stacked: at rest."""
    mounting = rotations.from_rotation_vector(p.mounting.rotation)
    attitude = rotations.multiply(z[3:7], rotations.conjugate(mounting))
    nothing = Nominal.unpack(ca.MX(Nominal.size(), 1))
    return nothing.replace(
        attitude=attitude,
        position=z[:3] - rotations.matrix(attitude) @ p.mounting.lever,
        gravity=ca.vertcat(0, 0, p.gravity),
        rate_lag=p.mounting.rate_lag,
        force_lag=p.mounting.force_lag,
        lever=p.mounting.lever,
        mounting=mounting,
    ).pack()


def _start_variance(p: Params) -> Any:
    """Return the variance of the errors at the first pose, (n,)."""
    unit, mounting, tracker = p.inertial, p.mounting, p.tracker
    return (
        SPACE.diagonal(
            attitude=tracker.attitude_noise + mounting.rotation_sigma,
            position=tracker.position_noise + mounting.lever_sigma,
            velocity=p.velocity_sigma,
            rate_bias=unit.rate_bias_sigma,
            force_bias=unit.force_bias_sigma,
            rate_matrix=unit.rate_matrix_sigma,
            force_matrix=unit.force_matrix_sigma,
            # Its length is known much better than its direction.
            gravity=p.gravity_sigma * ca.DM([1, 1, 0.1]),
            rate_lag=mounting.lag_sigma,
            force_lag=mounting.lag_sigma,
            lever=mounting.lever_sigma,
            mounting=mounting.rotation_sigma,
            position_offset=tracker.position_offset_sigma,
            flicker=tracker.flicker_sigma,
            attitude_offset=tracker.attitude_offset_sigma,
        )
        ** 2
    )


def _now() -> ca.Function:
    """(state, sample, time since it) -> pose of this instant, and how errors of a state change it.

    Results: q_WO, position and velocity of the tracked body, w; slope of the errors of the first
    three, attitude in O, transposed, (n, 9).
    """
    x, sensed, pending = ca.SX.sym("x", SPACE.size), ca.SX.sym("sensed", 6), ca.SX.sym("pending")
    e = ca.SX.sym("e", SPACE.error_size)
    state, other = Nominal.unpack(x), Nominal.unpack(SPACE.moved(x, e))
    here = pose(state, ca.DM(Back.NONE), sensed, pending)
    there = pose(other, ca.DM(Back.NONE), sensed, pending)
    turned = rotations.multiply(rotations.conjugate(here[0]), there[0])
    apart = ca.vertcat(rotations.to_rotation_vector(turned), *there[1:])
    rate, _ = rate_and_force(state, sensed)
    slopes = ca.densify(jacobian_at_zero(apart, e).T)
    results = [rotations.canonical(here[0]), *here[1:], rate, slopes]
    return ca.Function("now", [x, sensed, pending], results, {"cse": True})
