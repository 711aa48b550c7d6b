"""Attitude and rate bias by the augmented-state filter in error-state form (A04 4.4, AKR IV).

| symbol | meaning |
| --- | --- |
| q | attitude q_WB, unit quaternion |
| b | bias of the integrated rate [rad/s] |
| dtheta | attitude error in B, q = q_hat (x) exp(dtheta / 2) [rad] |
| P | covariance of (dtheta, b error), (6, 6) |
| w | rate with its bias taken off [rad/s] |
| W | process noise of one sample: of the rate T^2 Xi_w, of the bias Xi_b |
| z, V | measured attitude (TRIAD) and the covariance of its error |

A04 carries the quaternion's four components in the covariance, which is then singular (4.20, 4.35
have rank 3); here the error is the rotation vector, so H = [I 0] and nothing is singular.
"""

from typing import Any

import casadi as ca

from fmu_src.kit import rotations


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


def predict_covariance(P: Any, w: Any, W: Any, T: float) -> ca.SX:
    """P one sample later, (6, 6) (A04 4.37)."""
    F = transition(w, T)
    return F @ P @ F.T + W


def correct(q: Any, b: Any, P: Any, residual: Any, V: Any) -> tuple[Any, Any, Any, Any]:
    """Take in a measured attitude (A04 4.38 to 4.40).

    The covariance is updated in Joseph's form, which stays positive in long runs.

    Returns:
        (q, b, P, normalised innovation squared).
    """
    S = P[:3, :3] + V
    S_inverse = ca.inv_minor(S)
    K = P[:, :3] @ S_inverse
    change = K @ residual
    q = rotations.normalize(rotations.multiply(q, rotations.from_rotation_vector(change[:3])))
    A = ca.SX.eye(6)
    A[:, :3] -= K
    P = A @ P @ A.T + K @ V @ K.T
    return q, b + change[3:], (P + P.T) / 2, ca.dot(residual, S_inverse @ residual)


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
