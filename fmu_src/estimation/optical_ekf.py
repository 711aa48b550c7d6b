"""Attitude, rate and gyro bias from an optical tracker and a gyro, by an extended filter (C23 2.1).

    q' = q (x) exp(w T / 2),  w' = w + T a,  b' = b + T a_b        constant rate (C23 11, 14)
    w_m = w + b + v_w                                              gyro, every fresh sample (C23 15)
    q_m = q_then (x) exp(v_q / 2)                                  tracker, when it has one (C23 15)

| symbol | meaning |
| --- | --- |
| q | attitude q_WB |
| w, b | body rate and bias of the gyro, B [rad/s] |
| a, a_b | angular acceleration and bias rate: white noise |
| w_m, q_m | from the gyro and the tracker |
| q_then | attitude when the tracker exposed, by the turns since |
| t_g | lag of the gyro behind the tracker's clock [s] |
| v_w, v_q | noise of a sample |

C23's ten states have nine degrees of freedom: the error of q is a rotation vector in B, so the
covariance is not singular. The gyro gives the body rate, so the turn is on the right of q (the
paper has it on the left). C23 holds both measurements during an occlusion (zero-order hold, 3.2);
here nothing is measured then, and the filter turns on with the gyro's rate, less the bias.

The state is as old as the gyro's samples, by t_g; q as given out is carried on to now with the
rate. t_g is known where `lag_sigma` is zero, else one more state: a millisecond is 0.3 deg at
5 rad/s.

In C23's experiment the gyro has a sample every second one of the tracker's 16 ms intervals, and the
filter runs at the slower of both; here each is taken when it comes, at any rates. A gyro that is
lost, frozen or clipped is not taken: the rate stays, and its uncertainty grows with a.
"""

from typing import Any

import casadi as ca

from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation import ports
from fmu_src.filters.error_space import Space
from fmu_src.filters.error_state import Extended, correct_if, deviation, lazy_update
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, boolean, quaternion, real, vector
from fmu_src.math import rotations


class Nominal(State):
    """C23 eq. 12."""

    attitude = quaternion("q, attitude q_WB")
    rate = real("rad/s", "w in B", shape=3)
    rate_bias = real("rad/s", "b in B", shape=3)
    lag = real("s", "t_g, by which the gyro is behind the tracker's clock")


SPACE = Space(Nominal, "attitude")
FILTER = Extended(SPACE)


class Params(Parameters):
    """Noise, faults and limits."""

    limits: Any = sources.Limits
    angular_acceleration = real(
        "rad/s2/Hz0.5",
        "one-sided density of a, what the hand or robot does to a constant rate",
        start=3.0,
        min=1e-6,
        max=1e4,
    )
    rate_noise = real(
        "rad/s/Hz0.5", "one-sided density of the gyro's noise", start=2e-4, min=1e-8, max=1.0
    )
    rate_interval = real(
        "s", "time between fresh samples of the gyro", start=1e-3, min=1e-3, max=1.0
    )
    bias_walk = real("rad/s1.5", "density of a_b", start=1e-5, min=0.0, max=1.0)
    optical_sigma = real(
        "rad",
        "v_q of an axis, also what the gyro's age is unsure by",
        start=2e-3,
        min=1e-6,
        max=1.0,
    )
    bias_sigma = real("rad/s", "of b at the start", start=0.02, min=0.0, max=1.0)
    lag = real("s", "t_g", start=0.0, within=0.05)
    lag_sigma = real("s", "of t_g at the start", start=0.0, min=0.0, max=0.1)
    rate_sigma = real("rad/s", "of w at the start", start=1.0, min=1e-6, max=100.0)
    gate = ports.gate("an attitude counts less")
    astray = ports.astray(1.0)
    attitude_limit = ports.attitude_limit(0.02)
    occlusion_limit = ports.patience(0.1)


class In(Inputs):
    """Samples of both."""

    rate = ports.RATE
    inertial_valid = ports.INERTIAL_VALID
    optical_attitude = ports.tracked_attitude("B in W")
    optical_new = boolean("an attitude arrives at this instant")
    optical_age = real("s", "its age on arrival", start=0.016, min=0.0, max=10.0)


class X(State):
    """Filter, and what is kept of the samples."""

    nominal: Any = Nominal
    P = SPACE.covariance()
    started = boolean("an attitude has come")
    unit: Any = sources.Unit
    tracked: Any = sources.Tracked


class Out(Outputs):
    """Attitude and rate, and how far to believe them."""

    attitude = ports.ATTITUDE
    body_rate = vector("rad/s", "body rate w in B")
    rate_bias = vector("rad/s", "bias of the gyro in B")
    valid = boolean("attitude and rate may be used")
    inertial_lost = ports.INERTIAL_LOST
    optical_lost = boolean("the line of sight is lost")
    attitude_sigma = ports.ATTITUDE_SIGMA
    body_rate_sigma = vector("rad/s", "standard deviation of w in B", min=0.0)
    rate_bias_sigma = ports.RATE_BIAS_SIGMA
    lag_seen = real("s", "lag t_g of the gyro")
    lag_seen_sigma = real("s", "standard deviation of t_g", min=0.0)
    innovation_squared = ports.INNOVATION_SQUARED
    innovation_size = ports.INNOVATION_SIZE


def process(x: Any, u: Any) -> Nominal:
    """State a time u later (C23 11, 14)."""
    turned = rotations.multiply(x.attitude, rotations.from_rotation_vector(x.rate * u))
    return x.replace(attitude=turned)


def gyro_residual(x: Any, u: Any) -> Any:
    """Rate of the gyro u minus the predicted one, (3,) (C23 15)."""
    return u - x.rate - x.rate_bias


def then(x: Any, u: Any) -> Any:
    """Attitude when the tracker exposed, (4,).

    Args:
        x: nominal state.
        u: turn since an instant that was kept (4,), and how much later the tracker exposed, but
            for the lag [s].
    """
    before = rotations.multiply(x.attitude, rotations.conjugate(u[:4]))
    rest = rotations.from_rotation_vector(x.rate * (u[4] + x.lag))
    return rotations.multiply(before, rest)


def optical_residual(x: Any, u: Any) -> Any:
    """Attitude measured against that predicted for then, (3,).

    Args:
        x: nominal state.
        u: as `attitude_sources.measured` gives it.
    """
    return sources.attitude_residual(then(x, u[7:]), u[:7])


def process_noise(p: Params, T: float) -> Any:
    """Return what white angular acceleration and bias rate add in a sample, (n, n)."""
    s = p.angular_acceleration**2 / 2
    eye, none = ca.DM.eye(3), ca.DM.zeros(3, 3)
    moved = ca.vertcat(
        ca.horzcat(s * T**3 / 3 * eye, s * T**2 / 2 * eye, none),
        ca.horzcat(s * T**2 / 2 * eye, s * T * eye, none),
        ca.horzcat(none, none, p.bias_walk**2 * T * eye),
    )
    return ca.diagcat(moved, ca.MX(1, 1))


def step(p: Params, u: In, x: X, T: float) -> tuple[X, Out]:
    """Return state and outputs one sample later."""
    still = ca.DM.zeros(3, 1)  # no accelerometer: a force at rest is no fault
    sample = sources.inertial(x.unit, u.rate, still, u.inertial_valid, p.limits, T)
    usable = ca.logic_and(sample.fresh, ca.logic_not(sample.lost))

    before = x.nominal.pack()
    nominal, P = FILTER.predict(process, before, ca.MX(T), x.P, process_noise(p, T))

    R_w = p.rate_noise**2 / (2 * p.rate_interval) * ca.DM.eye(3)
    counted = ca.logic_and(usable, x.started)
    nominal, P, nis = correct_if(counted, FILTER, gyro_residual, nominal, P, sample.sensed[:3], R_w)

    # Before there is an attitude the gyro alone tells the turns.
    w = ca.if_else(x.started, Nominal.unpack(nominal).rate, sample.sensed[:3])
    past = sources.moved(x.tracked.past, w * T)
    arrival = sources.arrival(x.tracked, past, u.optical_attitude, u.optical_new, u.optical_age, T)

    def by_tracker(nominal: Any, P: Any, z: Any, past: Any, age: Any, R: Any, gate: Any) -> Any:
        behind = ca.fmax(age - Nominal.unpack(nominal).lag, 0)
        turn = ca.vertcat(sources.since(past, behind, T), behind - age)
        known = sources.measured("then", Nominal, then, nominal, turn, z)
        found = FILTER.correct(optical_residual, nominal, known, P, R, gate)
        return found.x, found.P, found.nis

    # At the first attitude the gyro tells the rate; what of it is bias shows later.
    begins = ca.logic_or(ca.logic_not(x.started), x.tracked.doubted > p.astray)
    first = ca.logic_and(arrival.taken, begins)
    nominal = ca.if_else(
        first,
        ca.vertcat(arrival.attitude, ca.if_else(usable, u.rate, 0), still, p.lag),
        nominal,
    )
    begun = ca.diag(
        SPACE.diagonal(
            attitude=1.0,
            rate=p.rate_sigma**2,
            rate_bias=p.bias_sigma**2,
            lag=p.lag_sigma**2,
        )
    )
    P = ca.if_else(first, begun, P)
    R_q = p.optical_sigma**2 * ca.DM.eye(3)
    nominal, P, optical_nis = lazy_update(
        arrival.taken, by_tracker, nominal, P, arrival.attitude, past, u.optical_age, R_q, p.gate
    )
    started = ca.logic_or(x.started, first)
    beyond = optical_nis > 3 * p.gate
    doubted = sources.doubted(x.tracked, arrival.taken, beyond, T)
    tracked = arrival.tracked.replace(doubted=doubted)
    # Until an attitude has come there is nothing to predict.
    state = Nominal.unpack(ca.if_else(started, nominal, before))
    P = ca.if_else(started, P, x.P)

    sigma = deviation(ca.diag(P))
    (attitude,) = sources.recorded(
        "now",
        lambda q, turn: rotations.multiply(q, rotations.from_rotation_vector(turn)),
        state.attitude,
        state.rate * state.lag,
    )
    well_known = ca.mmax(sigma[:3]) < p.attitude_limit
    measured = ca.logic_and(arrival.taken, ca.logic_not(first))
    return (
        X(nominal=state, P=P, started=started, unit=sample.unit, tracked=tracked),
        Out(
            attitude=rotations.canonical(attitude),
            body_rate=state.rate,
            rate_bias=state.rate_bias,
            valid=ca.logic_and(started, well_known),
            inertial_lost=sample.lost,
            optical_lost=arrival.tracked.quiet > p.occlusion_limit,
            attitude_sigma=sigma[:3],
            body_rate_sigma=sigma[3:6],
            rate_bias_sigma=sigma[6:9],
            lag_seen=state.lag,
            lag_seen_sigma=sigma[9],
            innovation_squared=ca.fmax(nis + measured * optical_nis, 0),
            innovation_size=3 * counted + 3 * measured,
        ),
    )


MODEL = Model.of_step("OpticalGyroEkf", step, sample_period=1e-3, matrix=True)
