"""Pose from an optical tracker and an inertial unit, by either filter (E13 3).

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

from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation.optical_inertial.interface import In, Out, Params, X
from fmu_src.estimation.optical_inertial.start import process_noise, start_state, start_variance
from fmu_src.estimation.optical_inertial.state import (
    MARKER,
    MARKERS,
    POSE,
    SPACE,
    Back,
    Nominal,
    marker_residual,
    pose,
    process,
    rate_and_force,
    residual,
    way_back,
)
from fmu_src.filters.error_space import jacobian_at_zero
from fmu_src.filters.error_state import Filter, deviation, lazy_update
from fmu_src.kit.model import Model
from fmu_src.math import rotations

SAMPLE_PERIOD = 1e-3
LONG = 1e3
"""Longest time that is counted [s]."""
OPEN = 1e6
"""Gate that nothing is beyond: a pose is not doubted twice, the state may be what is wrong."""


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
        known = ca.vertcat(*way_back(nominal, past, steps, age), z)
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
        Q = ca.diag(process_noise(unit, tracker, sample.lost, change, pending, left))
        known = ca.vertcat(x.unit.sensed, sensed, pending, left)
        going = ca.logic_and(due, x.started)
        nominal, P = lazy_update(going, self.predict, x.nominal.pack(), x.P, known, Q)
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
        nominal, P, nis = lazy_update(
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
        nominal, P, marker_nis = lazy_update(
            single,
            lambda *values: self.correct(marker_residual, *values),
            *(nominal, P, past, steps, age),
            ca.vertcat(seen, visible, ca.vec(tracker.markers.T)),
            tracker.marker_noise**2 * ca.DM.eye(MARKER),
            gate * count / MARKERS,
        )

        first = ca.logic_and(taken, ca.logic_not(x.started))
        nominal, P = lazy_update(
            first,
            lambda _nominal, _P, start, variance: (start, ca.diag(variance)),
            *(nominal, P, start_state(p, z), start_variance(p)),
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
