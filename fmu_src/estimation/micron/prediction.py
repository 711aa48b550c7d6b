"""Angular acceleration from the differences of the channels, and the filter's prediction."""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from fmu_src.device import sensing_kinematics as kinematics
from fmu_src.estimation.micron import attitude_filter
from fmu_src.estimation.micron.sample import Sample
from fmu_src.estimation.micron.start import Start
from fmu_src.kit.lazy_select import lazy_select
from fmu_src.math import rotations

FADING = 0.02
"""Time constant by which alpha and the tip's acceleration fade without samples [s]."""
SETTLING = 0.1
"""Share of what a hand can do that is possible while it settles, nearly at rest."""


def fade(T: float) -> float:
    """Return the factor by which alpha and the tip's acceleration fade in a sample."""
    return float(np.exp(-T / FADING))


class Turn(NamedTuple):
    """Rotation by the accelerometers.

    Attributes:
        usable: whether the specific forces of this sample are used.
        zero: A_D at rest, (3,) [m/s2], learned while the filter settles.
        alpha: angular acceleration, (3,) [rad/s2].
        w_i: integral of alpha, (3,) [rad/s].
        rate_measured: w_I + tau alpha, (3,) [rad/s].
    """

    usable: Any
    zero: Any
    alpha: Any
    w_i: Any
    rate_measured: Any


class Prediction(NamedTuple):
    """Attitude and covariance before any correction.

    Attributes:
        b: bias of w_I, (3,) [rad/s].
        q: attitude q_WB, (4,).
        P: covariance of attitude error and bias, (6, 6).
        R: rotation matrix of `q`, (3, 3).
        up_B: vertical in B, (3,).
        heading: projection onto the rotation about the vertical and its bias, (6, 6).
        white: variance of the specific force's white noise behind the lag [m2/s4].
        sigma_N: of the unit field.
    """

    b: Any
    q: Any
    P: Any
    R: Any
    up_B: Any
    heading: Any
    white: Any
    sigma_N: Any


def densities(p: Any) -> tuple[Any, Any]:
    """Return (S_A, S_r); the weakest channel stands for all, since A_D mixes them."""
    return ca.mmax(p.accelerometer.density) ** 2, p.roll_density**2


def sense_turn(p: Any, s: Sample, start: Start, x: Any, T: float, rate_gain: Any) -> Turn:
    """Return angular acceleration and rate from the channels' differences.

    Offsets of the channels would make the rate's bias a ramp: their mean while the filter settles
    is the zero of A_D.
    """
    swing = p.gates.difference * ca.if_else(start.young, SETTLING, 1)
    possible = ca.logic_or(start.anew, ca.mmax(ca.fabs(s.A_D - x.zero)) < swing)
    usable = ca.logic_and(s.alive.force, possible)
    samples = x.age / T
    zero = ca.if_else(
        ca.logic_and(start.young, ca.logic_and(start.going, usable)),
        (samples * x.zero + s.A_D) / (samples + 1),
        ca.if_else(ca.logic_and(start.anew, p.settling > 0), s.A_D, x.zero),
    )
    (sensed,) = lazy_select(
        "angular_acceleration",
        p.method == 0,
        lambda gain, left, *_: [gain @ left],
        lambda _, left, w, layout, S: [
            kinematics.angular_acceleration(
                left, w, kinematics.Geometry.of(kinematics.Layout.unpack(layout)), (S[0], S[1]), T
            )
        ],
        rate_gain,
        s.A_D - zero,
        x.w_i - x.b,
        p.geometry.pack(),
        ca.vertcat(*densities(p)),
    )
    alpha = ca.if_else(usable, sensed, fade(T) * x.alpha)
    w_i = ca.if_else(start.going, x.w_i + T / 2 * (alpha + x.alpha), 0)
    return Turn(usable, zero, alpha, w_i, w_i + p.accelerometer.lag * alpha)


def predict(
    p: Any, s: Sample, start: Start, turn: Turn, x: Any, T: float, derived: Any
) -> Prediction:
    """Return attitude and covariance over the sample that has passed."""
    tau = p.accelerometer.lag
    white = ca.sum1(p.accelerometer.density**2) / 6 / (4 * ca.fmax(tau, T / 2)) / 2
    sigma_N = ca.sqrt(p.magnetometer.sigma**2 + p.magnetometer.residue**2) / s.strength
    unknown = ca.if_else(turn.usable, 0, T / 2 * p.hand_rotation**2)
    W = ca.diagcat(T**2 * derived.rate_noise, derived.bias_noise + unknown * ca.SX.eye(3))
    b = ca.if_else(start.going, x.b, 0)
    w = turn.rate_measured - b
    q = attitude_filter.predict_attitude(x.q, w, T)
    P = attitude_filter.predict_covariance(x.P, w, W, T)
    R = rotations.matrix(q)
    up_B = R[2, :].T
    heading = ca.diagcat(up_B @ up_B.T, up_B @ up_B.T)
    return Prediction(b, q, P, R, up_B, heading, white, sigma_N)
