"""Hand-eye rotation between an inertial unit and a tracker's sensor, from a recording (RK III.B).

    A_k X = X B_k                               RK's AX = XB, relative rotations of unit and coils
    z_k  = r* (x) q_0 (x) c(t_k + tau) (x) h    all of them at once, with the gyro's bias in c

| symbol | meaning |
| --- | --- |
| z_k, t_k | attitude of the coils C in the tracker's frame F, and when it was measured [s] |
| c(t) | turn of the body B since the start, by the gyro less its bias b [rad/s] |
| h | hand-eye rotation q_BC: X |
| r | registration q_WF |
| q_0 | attitude of B at the start |
| tau | by which the gyro is behind the tracker's clock [s] |

h starts from the rotation that fits the vectors of relative rotations best (Park and Martin 1994,
in Kabsch's form); h, b, tau and r* (x) q_0 are then fitted to all attitudes by least squares. What
the fit leaves is distortion by metal more than noise, and slow: covariances are those of sums over
blocks of the recording (the sandwich), which takes neighbouring residuals for one. Intervals of
95 % by Student's t of that number of blocks. What goes with the attitude, distortion or scale and
alignment of the gyro, is in none of them: h is the rotation to the gyro's axes as they are.

Where specific force and field were recorded, too, r follows: up and north in F, averaged over all
instants at which the force is as long as gravity (RK III.B: several pairs).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage, stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fmu_src.device import design
from fmu_src.errors import SteadytipError
from fmu_src.estimation.em_ekf.model import MODEL
from harness.common.types import FloatArray
from harness.identify.hand_eye.conventions import check_conventions
from harness.identify.hand_eye.read import FEWEST, LARGEST_LAG, TrackedMotion
from harness.identify.hand_eye.rotation import APART, GyroRotation, relative_rotations
from harness.identify.parameter_files import write_parameters

__all__ = ["HandEye", "identify_hand_eye", "write_hand_eye"]

SECOND_AXIS = np.radians(3.0)
"""Least rms turn of the pairs about a second axis, for all of h to be seen."""
BLOCKS, SHORTEST_BLOCK = 20, 1.0
"""Blocks of residuals, and their least length [s]."""
QUIET = 0.2
"""Departure of the specific force from gravity up to which it shows the vertical [m/s2]."""
AVERAGED = 0.05
"""Over which forces and fields are averaged [s]."""
ROUNDS = 3


@dataclass(frozen=True)
class HandEye:
    """Identified rotations, bias and lag.

    Attributes:
        mounting: h.
        mounting_sigma: standard deviation of its error, a rotation vector in C, (3,) [rad].
        bias: bias of the gyro, (3,) [rad/s].
        bias_sigma: (3,) [rad/s].
        lag: tau [s].
        lag_sigma: [s].
        registration: r; None without force and field.
        registration_sigma: registration sigma of an error in F, (3,) [rad]; None without.
        factor: half width of an interval of 95 % over a standard deviation.
        time: time of the residuals, (m,) [s].
        residual: rotation vectors that the fit leaves, in C, (m, 3) [rad].
    """

    mounting: Rotation
    mounting_sigma: FloatArray
    bias: FloatArray
    bias_sigma: FloatArray
    lag: float
    lag_sigma: float
    registration: Rotation | None
    registration_sigma: FloatArray | None
    factor: float
    time: FloatArray
    residual: FloatArray


def identify_hand_eye(recorded: TrackedMotion) -> HandEye:
    """Fit the hand-eye rotation, bias, lag and registration.

    Raises:
        SteadytipError: a recording that turns about one axis only, or whose rates and attitudes
            are not of one motion as they are read.
    """
    check_conventions(recorded)
    z, at = recorded.attitude, recorded.measured
    bias, lag = np.zeros(3), 0.0
    turns = GyroRotation(recorded, bias)
    start, hand = _initial_guess(turns.at(at, bias), z, at, recorded.path)
    limit = np.full(10, np.inf)
    limit[9] = LARGEST_LAG
    for _ in range(ROUNDS):

        def residual(
            x: FloatArray, known: tuple[GyroRotation, Rotation, Rotation] = (turns, start, hand)
        ) -> FloatArray:
            turns, start, hand = known
            body = start * Rotation.from_rotvec(x[:3]) * turns.at(at + x[9], x[6:9])
            predicted = body * hand * Rotation.from_rotvec(x[3:6])
            left: FloatArray = (predicted.inv() * z).as_rotvec().ravel()
            return left

        begin = np.append(np.zeros(9), lag)
        found = least_squares(residual, begin, bounds=(-limit, limit), x_scale="jac")
        start = start * Rotation.from_rotvec(found.x[:3])
        hand = hand * Rotation.from_rotvec(found.x[3:6])
        bias, lag = bias + found.x[6:9], float(found.x[9])
        turns = GyroRotation(recorded, bias)
    covariance, factor = _clustered_covariance(found.jac, found.fun, at)
    sigma = np.sqrt(np.diag(covariance))
    registration = _registration(recorded, hand)
    return HandEye(
        mounting=hand,
        mounting_sigma=sigma[3:6],
        bias=bias,
        bias_sigma=sigma[6:9],
        lag=lag,
        lag_sigma=float(sigma[9]),
        registration=registration[0] if registration else None,
        registration_sigma=registration[1] if registration else None,
        factor=factor,
        time=at,
        residual=found.fun.reshape(-1, 3),
    )


def _initial_guess(
    turns: Rotation, z: Rotation, at: FloatArray, path: Path
) -> tuple[Rotation, Rotation]:
    """Return r* (x) q_0 and h from relative rotations."""
    body, coils = relative_rotations(turns, z, at)
    spread = np.linalg.svd(body, compute_uv=False) / np.sqrt(len(body))
    if spread[1] < SECOND_AXIS:
        raise SteadytipError(
            f"recording {path}: pairs of attitudes {APART:g} s apart turn by "
            f"{np.degrees(spread[0]):.3g} deg rms about one axis and {np.degrees(spread[1]):.3g} "
            f"deg about the next, which must be {np.degrees(SECOND_AXIS):.2g} at least; turn the "
            "instrument about two axes, further or faster"
        )
    hand, _ = Rotation.align_vectors(body, coils)
    return (z * hand.inv() * turns.inv()).mean(), hand


def _clustered_covariance(
    jacobian: FloatArray, residual: FloatArray, at: FloatArray
) -> tuple[FloatArray, float]:
    """Return the covariance of a fit, and Student's factor.

    Residuals are correlated within blocks.
    """
    block = max((at[-1] - at[0]) / BLOCKS, SHORTEST_BLOCK)
    number = np.repeat(((at - at[0]) / block).astype(int), 3)
    blocks = np.unique(number)
    bread = np.linalg.inv(jacobian.T @ jacobian)
    weighted = jacobian * residual[:, None]
    sums = np.array([weighted[number == k].sum(axis=0) for k in blocks])
    count = len(blocks)
    covariance = bread @ (sums.T @ sums) @ bread * count / (count - 1)
    return covariance, float(stats.t.ppf(0.975, count - 1))


def _registration(recorded: TrackedMotion, hand: Rotation) -> tuple[Rotation, FloatArray] | None:
    """Return r and the standard deviation of its error in F; None without force and field."""
    if recorded.force is None or recorded.field is None:
        return None
    period = float(np.median(np.diff(recorded.time)))
    size = max(round(AVERAGED / period), 1)
    place = np.clip(np.searchsorted(recorded.time, recorded.measured), 0, len(recorded.time) - 1)
    force, field = (
        ndimage.uniform_filter1d(values, size, axis=0)[place]
        for values in (recorded.force, recorded.field)
    )
    length = np.linalg.norm(force, axis=1)
    quiet = np.abs(length - design.SITE_GRAVITY) < QUIET
    if quiet.sum() < FEWEST:
        return None
    body = recorded.attitude[quiet] * hand.inv()
    up = body.apply(force[quiet] / length[quiet, None])
    north = body.apply(field[quiet])

    def frame(up: FloatArray, north: FloatArray) -> Rotation:
        z = up / np.linalg.norm(up)
        y = np.cross(z, north)
        y /= np.linalg.norm(y)
        return Rotation.from_matrix(np.array([np.cross(y, z), y, z]))

    registration = frame(up.mean(axis=0), north.mean(axis=0))
    parts = np.array_split(np.arange(len(up)), BLOCKS)
    deviations = [
        (registration.inv() * frame(up[part].mean(axis=0), north[part].mean(axis=0))).as_rotvec()
        for part in parts
    ]
    return registration, np.std(deviations, axis=0, ddof=1) / np.sqrt(BLOCKS)


def write_hand_eye(path: Path, found: HandEye) -> Path:
    """Write hand-eye rotation, registration and lag as a parameter file for `EmInertialEkf`.

    Raises:
        ProblemsError: the model would refuse values.
        SteadytipError: the file cannot be written.
    """
    values = {
        "tracker.mounting_sigma": float(np.sqrt(np.mean(found.mounting_sigma**2))),
        "tracker.lag": found.lag,
    }
    vectors = {"tracker.mounting": found.mounting.as_rotvec()}
    if found.registration is not None and found.registration_sigma is not None:
        vectors["tracker.registration"] = found.registration.as_rotvec()
        rms = np.sqrt(np.mean(found.registration_sigma**2))
        values["tracker.registration_sigma"] = float(rms)
    for name, vector in vectors.items():
        values |= {f"{name}[{i}]": float(v) for i, v in enumerate(vector, start=1)}
    scalars = MODEL.parameters.scalars()
    return write_parameters(path, scalars, values, "the recording does not suit the model")
