"""Attitude and rate bias by the augmented-state filter in error-state form (A04 4.4, AKR IV).

| symbol | meaning |
| --- | --- |
| q | attitude q_WB, unit quaternion |
| b | bias of the integrated rate [rad/s] |
| dtheta | attitude error in B, q = q_hat (x) exp(dtheta / 2) [rad] |
| P | covariance of (dtheta, b error), (6, 6) |
| w | rate with its bias taken off [rad/s] |
| W | process noise of one sample: of the rate T^2 Xi_w, of the bias Xi_b |
| z, V | measurement and the covariance of its error |
| H | Jacobian of a measurement's residual by (dtheta, b) |
| dtheta_W | the attitude error in W, R(q) dtheta [rad] |

A04 carries the quaternion's four components in the covariance, which is then singular (4.20, 4.35
have rank 3); here the error is the rotation vector, and nothing is singular. Its measurement is the
attitude of TRIAD, H = [I 0]. That is made of three numbers, two of the vertical and one of the
field, whose errors are independent: taken in one after the other by `tilt_innovation` and
`north_innovation` they correct as TRIAD does, but each can be left out where it is disturbed.
"""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from fmu_src.math import rotations

LEAST = 1e-9
"""Added to lengths that may vanish: angles and their derivatives are finite everywhere."""


def predict_attitude(q: Any, w: Any, T: float) -> ca.SX:
    """Attitude one sample later at the rate w, (4,) (A04 4.16)."""
    return rotations.multiply(q, rotations.from_rotation_vector(w * T))


def transition(w: Any, T: float) -> ca.SX:
    """Jacobian of the error's way through `predict_attitude`, (6, 6).

    dtheta' = R(exp(w T))^T dtheta - J_r(w T) T b, whose right Jacobian J_r is the identity to the
    first order of an angle of some microradians.
    """
    turned = rotations.matrix(rotations.from_rotation_vector(w * T)).T
    return ca.vertcat(
        ca.horzcat(turned, -T * ca.SX.eye(3)),
        ca.horzcat(ca.SX.zeros(3, 3), ca.SX.eye(3)),
    )


def innovation(q: Any, z: Any) -> ca.SX:
    """Attitude error that the measured attitude shows, (3,) [rad]."""
    return rotations.to_rotation_vector(rotations.multiply(rotations.conjugate(q), z))


def tilt_innovation(up_W: Any) -> ca.SX:
    """Attitude error about the two level axes that the measured vertical shows, (2,) [rad].

    Args:
        up_W: measured vertical by the predicted attitude, R(q) z_B, a unit vector; it is e_z where
            the prediction is right. What turns it there by the shortest way is the error, exact at
            every angle; at 180 deg, where every way is, about x.
    """
    squared = ca.sumsqr(up_W[:2])
    across = ca.sqrt(squared + LEAST**2)
    ratio = ca.atan2(across, up_W[2]) / across
    vanished = ca.logic_and(squared < LEAST**2, up_W[2] < 0)
    turned = ca.if_else(vanished, np.pi, ratio * up_W[1])
    return ca.vertcat(turned, -ratio * up_W[0])


def north_innovation(field_W: Any) -> tuple[ca.SX, ca.SX]:
    """Attitude error that the measured field shows: [rad], and its Jacobian by dtheta_W, (1, 3).

    The angle of the field's level part from x, so that neither strength nor dip counts. A tilt
    error turns it as well, by the tangent of the dip.

    Args:
        field_W: measured field by the predicted attitude, R(q) n_B, a unit vector.
    """
    lean = -field_W[2] / (ca.sumsqr(field_W[:2]) + LEAST**2)
    return (
        -ca.atan2(field_W[1], field_W[0] + LEAST),
        ca.horzcat(lean * field_W[0], lean * field_W[1], 1),
    )


def predict_covariance(P: Any, w: Any, W: Any, T: float) -> ca.SX:
    """P one sample later, (6, 6) (A04 4.37)."""
    return _mirrored(_half(transition(w, T), P) + ca.tril(W))


class Correction(NamedTuple):
    """Result of a correction.

    Attributes:
        change: of (dtheta, b), (6,).
        P: covariance, (6, 6).
        nis: normalised innovation squared, whether taken in or not.
        taken: whether it was taken in.
    """

    change: ca.SX
    P: ca.SX
    nis: ca.SX
    taken: ca.SX


def correct(
    P: Any,
    residual: Any,
    H: Any,
    V: Any,
    usable: Any = 1,
    gate: Any = np.inf,
    onto: Any = None,
) -> Correction:
    """Take in a measurement of some of the errors (A04 4.38 to 4.40).

    TRIAD gives the measurement with H = [I 0] and V of `triad.covariance`. The covariance is
    updated in Joseph's form, which stays positive in long runs and holds for every gain.

    Args:
        P: covariance of (dtheta, b), (6, 6).
        residual: measured minus predicted, (m,).
        H: Jacobian of the residual by (dtheta, b), (m, 6).
        V: covariance of the measurement, (m, m).
        usable: whether it is to be taken in at all.
        gate: standard deviations, beyond which it is not.
        onto: projection, (6, 6), of what the measurement may change; everything without one.
    """
    S = H @ P @ H.T + V
    S_inverse = 1 / S if S.shape == (1, 1) else ca.inv_minor(S)
    nis = ca.dot(residual, S_inverse @ residual)
    taken = ca.logic_and(usable, nis <= gate**2)
    K = taken * (P @ H.T @ S_inverse)
    if onto is not None:
        K = onto @ K
    A = ca.SX.eye(6) - K @ H
    return Correction(K @ residual, _mirrored(_half(A, P) + _half(K, V)), nis, taken)


def _half(A: Any, P: Any) -> ca.SX:
    """Return A P A^T on and below the diagonal, P symmetric."""
    left = A @ P
    rows = range(A.shape[0])
    return ca.vertcat(
        *(ca.horzcat(left[i, :] @ A[: i + 1, :].T, ca.SX(1, len(rows) - 1 - i)) for i in rows)
    )


def _mirrored(half: Any) -> ca.SX:
    """Return the symmetric matrix whose lower half is given."""
    return ca.densify(ca.tril(half) + ca.tril(half, False).T)


def moved(q: Any, change: Any) -> ca.SX:
    """Attitude after the change that a correction asks for, (4,) (A04 4.39)."""
    turned = rotations.multiply(q, rotations.from_rotation_vector(change[:3]))
    return rotations.normalize(turned)


def unscented_covariance(transform: Any, roots: Any, kappa: float = 0.0) -> ca.SX:
    """Covariance of `transform(s)` for zero-mean s, by sigma points (A04 4.23 to 4.26).

    Args:
        transform: from a column (n,) to a column.
        roots: square root of the covariance of s, (n, n).
        kappa: spread; n + kappa = 3 matches the fourth moment of a Gaussian.
    """
    n = roots.shape[0]
    spread = ca.sqrt(n + kappa)
    points = [ca.SX.zeros(n)]
    points += [sign * spread * roots[:, i] for sign in (1, -1) for i in range(n)]
    weights = [kappa / (n + kappa)] + [1 / (2 * (n + kappa))] * (2 * n)
    images = [transform(point) for point in points]
    mean = sum(w * image for w, image in zip(weights, images, strict=True))
    return sum(
        w * (image - mean) @ (image - mean).T for w, image in zip(weights, images, strict=True)
    )
