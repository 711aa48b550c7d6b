"""Start at the first pose, and the noise that the process adds."""

from typing import Any

import casadi as ca

from fmu_src.estimation.optical_inertial.interface import Inertial, Params, Tracker
from fmu_src.estimation.optical_inertial.state import SPACE, Nominal
from fmu_src.math import rotations


def process_noise(
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


def start_state(p: Params, z: Any) -> Any:
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


def start_variance(p: Params) -> Any:
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
