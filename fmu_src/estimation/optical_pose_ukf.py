"""Pose from an optical tracker and an inertial unit by E13's own unscented filter (E13 3.4).

    p' = p + v T + a T^2 / 2,  v' = v + a T,  a' = a      constant acceleration (E13 3.9 ff.)
    q' = q (x) exp(w T / 2),  w' = w                      constant rate (E13 3.12 ff.)
    H_gyr = w + v_g,  H_acc = R^T (a + G) + v_a           when a fresh sample comes (E13 3.26, 3.28)
    H_ots = p + R l + v_p, q (x) exp(v_q / 2)             when a pose comes (E13 3.25)

| symbol | meaning |
| --- | --- |
| p, v, a | position, velocity and acceleration of the inertial unit in W |
| q, w, R | attitude q_WB, body rate, matrix of q |
| G | specific force at rest, (0, 0, g) in W |
| l | lever arm from the unit to the tracked body, in B; E13 has none |
| v_g, v_a, v_p, v_q | noise of a sample |

Sixteen numbers with fifteen degrees of freedom (E13 3.4, 3.17): the error of q is a rotation vector
in B. White jerk of the density s adds, over a sample, the covariance of E13 3.18 with m = 2, and
white angular acceleration that with m = 1. There sigma_w^2 is two-sided; s is one-sided, s^2 / 2.
Sigma points, their weights and the mean of quaternions are those of `error_state.Unscented`.

What differs from the print. E13 turns q by w from the right (3.16), so that w is the body rate, and
the gyro measures it as it is, though 3.26 turns it once more. 3.28 turns the force by the tracker's
attitude where there is one; here by that of each sigma point, which has taken it in, and the force
corrects the attitude, too. The covariance at the start is not that of the tracker throughout, which
cannot tell v, a and w. Samples come at any rates: an occlusion is H_ots left out. E13 has no gate.

There are no biases, no lags and no scale: this filter stands beside `OpticalInertialUkf` to show
what they are worth. A pose that is late is compared with p - v d and q (x) exp(-w d / 2), d its
age, and no more. Faults are detected, unlike in E13: an inertial unit that is silent, frozen or
clipped is not taken, nor is a pose that is none or the one before once more.
"""

from math import factorial
from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation import ports
from fmu_src.estimation.optical_inertial.model import LONG, OPEN, arrived
from fmu_src.estimation.optical_inertial.state import POSE
from fmu_src.filters.error_space import Space
from fmu_src.filters.error_state import Unscented, correct_if, deviation, lazy_update
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import boolean, quaternion, real, vector
from fmu_src.math import rotations

INERTIAL = 6
"""Size of the residual."""


class Nominal(State):
    """E13 eq. 3.4."""

    position = real("m", "p in W", shape=3)
    velocity = real("m/s", "v in W", shape=3)
    acceleration = real("m/s2", "a in W", shape=3)
    attitude = quaternion("q, attitude q_WB")
    body_rate = real("rad/s", "w in B", shape=3)


SPACE = Space(Nominal, "attitude")
FILTER = Unscented(SPACE)


class Params(Parameters):
    """Noise, faults and limits."""

    limits: Any = sources.Limits
    jerk = real(
        "m/s3/Hz0.5", "one-sided density, what a hand does to a", start=10.0, min=1e-6, max=1e5
    )
    angular_acceleration = real(
        "rad/s2/Hz0.5", "one-sided density, what a hand does to w", start=5.0, min=1e-6, max=1e5
    )
    rate_noise = real("rad/s", "v_g of an axis, each sample", start=5e-3, min=1e-7, max=10.0)
    force_noise = real("m/s2", "v_a of an axis, each sample", start=0.05, min=1e-6, max=100.0)
    position_noise = real("m", "v_p of an axis, each pose", start=1e-4, min=1e-7, max=0.1)
    attitude_noise = real("rad", "v_q of an axis, each pose", start=2e-3, min=1e-6, max=1.0)
    lever = real("m", "l in B", shape=3, within=2.0)
    gravity = real("m/s2", "g", start=design.SITE_GRAVITY, min=1.0, max=20.0)
    velocity_sigma = real("m/s", "of v at the first pose", start=0.3, min=1e-6, max=10.0)
    acceleration_sigma = real("m/s2", "of a at the first pose", start=3.0, min=1e-6, max=100.0)
    rate_sigma = real("rad/s", "of w at the first pose", start=1.0, min=1e-6, max=100.0)
    gate = ports.gate("a pose counts less unless the one before was as unlikely")
    occlusion_limit = ports.patience(0.1)
    position_limit = ports.POSITION_LIMIT
    attitude_limit = ports.attitude_limit(0.1)


class X(State):
    """Filter, and what is kept of the samples."""

    nominal: Any = Nominal
    P = SPACE.covariance()
    started = boolean("a pose has come")
    unit: Any = sources.Unit
    pose = real(None, "last pose that came", shape=7)
    doubted = boolean("the last pose was beyond the gate")
    unseen = real("s", "time since a pose was used", min=0.0)


class Out(Outputs):
    """Pose of the tracked body and its derivatives, and how far to believe them."""

    attitude = ports.ATTITUDE
    position = vector("m", "of the tracked body in W")
    velocity = vector("m/s", "of the tracked body in W")
    acceleration = vector("m/s2", "a, of the inertial unit in W")
    body_rate = vector("rad/s", "w in B")
    valid = boolean("the pose may be used")
    inertial_lost = ports.INERTIAL_LOST
    optical_lost = boolean("no pose could be used of late")
    attitude_sigma = ports.ATTITUDE_SIGMA
    position_sigma = ports.POSITION_SIGMA
    velocity_sigma = ports.VELOCITY_SIGMA
    acceleration_sigma = vector("m/s2", "standard deviation of a in W", min=0.0)
    body_rate_sigma = vector("rad/s", "standard deviation of w in B", min=0.0)
    innovation_squared = ports.INNOVATION_SQUARED
    innovation_size = ports.INNOVATION_SIZE


def process(x: Any, u: Any) -> Nominal:
    """State a time u later (E13 3.9 to 3.16)."""
    return x.replace(
        position=x.position + u * x.velocity + u**2 / 2 * x.acceleration,
        velocity=x.velocity + u * x.acceleration,
        attitude=rotations.multiply(x.attitude, rotations.from_rotation_vector(x.body_rate * u)),
    )


def process_noise(p: Params, T: float) -> Any:
    """Covariance that a sample adds, (15, 15)."""

    def of(density: Any, order: int) -> Any:
        return density**2 / 2 * ca.DM(np.kron(integrated(order, T), np.eye(3)))

    return ca.diagcat(of(p.jerk, 2), of(p.angular_acceleration, 1))


def integrated(order: int, T: float) -> np.ndarray:
    """Covariance of white noise integrated up to `order` times more, (order + 1, order + 1).

    The last entry is that of the noise's own integral, the first that of the highest (E13 3.18).
    """
    left = order + 1 - np.arange(1, order + 2)
    power = left[:, np.newaxis] + left + 1
    scale = np.array([factorial(k) for k in left])
    return np.asarray(T**power / (np.outer(scale, scale) * power))


def inertial_residual(x: Any, u: Any) -> Any:
    """Rate and force u (6,) minus the predicted ones, (6,); g is the last of u (E13 3.26, 3.28)."""
    force = rotations.matrix(x.attitude).T @ (x.acceleration + ca.vertcat(0, 0, u[6]))
    return ca.vertcat(u[:3] - x.body_rate, u[3:6] - force)


def optical_residual(x: Any, u: Any) -> Any:
    """Pose u (7,) minus the predicted one, (6,); age (1,) and lever arm (3,) follow (E13 3.25)."""
    age, lever = u[7], u[8:11]
    then = rotations.multiply(x.attitude, rotations.from_rotation_vector(-x.body_rate * age))
    position = x.position - age * x.velocity + rotations.matrix(then) @ lever
    turned = rotations.multiply(rotations.conjugate(then), u[3:7])
    return ca.vertcat(u[:3] - position, rotations.to_rotation_vector(turned))


def step(p: Params, u: ports.PoseInputs, x: X, T: float) -> tuple[X, Out]:
    """Return state and outputs one sample later."""
    sample = sources.inertial(x.unit, u.rate, u.force, u.inertial_valid, p.limits, T)
    sensed = ca.logic_and(ca.logic_and(sample.fresh, ca.logic_not(sample.lost)), x.started)
    taken, z = arrived(u, x.pose)

    def predict(nominal: Any, P: Any, Q: Any) -> tuple[Any, ...]:
        return FILTER.predict(process, nominal, ca.MX(T), P, Q)

    nominal, P = lazy_update(x.started, predict, x.nominal.pack(), x.P, process_noise(p, T))
    nominal, P, inertial_nis = correct_if(
        *(sensed, FILTER, inertial_residual, nominal, P),
        ca.vertcat(sample.sensed, p.gravity),
        _twice(p.rate_noise, p.force_noise),
    )
    usable = ca.logic_and(taken, x.started)
    nominal, P, nis = correct_if(
        *(usable, FILTER, optical_residual, nominal, P),
        ca.vertcat(z, u.optical_age, p.lever),
        _twice(p.position_noise, p.attitude_noise),
        ca.if_else(x.doubted, OPEN, p.gate),
    )

    # At rest at the first pose (E13 3.4.8)
    first = ca.logic_and(taken, ca.logic_not(x.started))
    still = ca.DM.zeros(3, 1)
    place = z[:3] - rotations.matrix(z[3:7]) @ p.lever
    nominal = ca.if_else(first, ca.vertcat(place, still, still, z[3:7], still), nominal)
    P = ca.if_else(first, ca.diag(_start_variance(p)), P)
    started = ca.logic_or(x.started, first)
    unseen = ca.if_else(taken, 0, x.unseen + T)

    state = Nominal.unpack(nominal)
    R = rotations.matrix(state.attitude)
    sigma = deviation(ca.diag(P))
    part = {name: sigma[place] for name, place in SPACE.places.items()}
    part |= _of_body(state, R, p.lever, P)
    known_well = ca.logic_and(
        ca.mmax(part["position"]) < p.position_limit, ca.mmax(part["attitude"]) < p.attitude_limit
    )
    following = X(
        nominal=state,
        P=P,
        started=started,
        unit=sample.unit,
        pose=ca.if_else(u.optical_new, z, x.pose),
        doubted=ca.if_else(usable, nis > POSE * p.gate, x.doubted),
        unseen=ca.fmin(unseen, LONG),
    )
    return following, Out(
        attitude=rotations.canonical(state.attitude),
        position=state.position + R @ p.lever,
        velocity=state.velocity + R @ ca.cross(state.body_rate, p.lever),
        acceleration=state.acceleration,
        body_rate=state.body_rate,
        valid=ca.logic_and(started, known_well),
        inertial_lost=sample.lost,
        optical_lost=ca.logic_or(unseen > p.occlusion_limit, ca.logic_not(started)),
        **{f"{name}_sigma": value for name, value in part.items()},
        innovation_squared=ca.fmax(inertial_nis + nis, 0),
        innovation_size=INERTIAL * sensed + POSE * usable,
    )


def _of_body(x: Nominal, R: Any, lever: Any, P: Any) -> dict[str, Any]:
    """Return standard deviations of position and velocity of the tracked body, (3,) each."""
    eye, none = ca.DM.eye(3), ca.DM.zeros(3, 3)
    arm = -R @ rotations.skew(lever)
    turned = -R @ rotations.skew(ca.cross(x.body_rate, lever))
    slopes = {
        "position": ca.horzcat(eye, none, none, arm, none),
        "velocity": ca.horzcat(none, eye, none, turned, arm),
    }
    return {name: deviation(ca.sum2((H @ P) * H)) for name, H in slopes.items()}


def _twice(first: Any, second: Any) -> Any:
    """Covariance of two vectors (3,) with these standard deviations of an axis, (6, 6)."""
    return ca.diag(ca.vertcat(ca.repmat(first**2, 3, 1), ca.repmat(second**2, 3, 1)))


def _start_variance(p: Params) -> Any:
    return (
        SPACE.diagonal(
            position=p.position_noise,
            velocity=p.velocity_sigma,
            acceleration=p.acceleration_sigma,
            attitude=p.attitude_noise,
            body_rate=p.rate_sigma,
        )
        ** 2
    )


MODEL = Model.of_step("OpticalPoseUkf", step, sample_period=1e-3, matrix=True)
