"""Rotations by Hamilton quaternions, scalar first.

| symbol | meaning |
| --- | --- |
| q_WB | (w, x, y, z), rotates body vectors into the world: v_W = R(q_WB) v_B |
| w_B | body rate, q' = 1/2 q (x) [0, w_B] |
| theta | rotation vector [rad], axis times angle |

All functions take and return CasADi columns.
"""

from typing import Any

import casadi as ca


def skew(v: Any) -> ca.SX:
    """Matrix of the cross product with v: its product with w is v x w, (3, 3)."""
    return ca.vertcat(
        ca.horzcat(0, -v[2], v[1]), ca.horzcat(v[2], 0, -v[0]), ca.horzcat(-v[1], v[0], 0)
    )


def multiply(a: Any, b: Any) -> ca.SX:
    """Hamilton product a (x) b, (4,)."""
    scalar = a[0] * b[0] - ca.dot(a[1:], b[1:])
    return ca.vertcat(scalar, a[0] * b[1:] + b[0] * a[1:] + ca.cross(a[1:], b[1:]))


def conjugate(q: Any) -> ca.SX:
    """Inverse of a unit quaternion, (4,)."""
    return ca.vertcat(q[0], -q[1:])


def normalize(v: Any) -> ca.SX:
    """Scale a column to unit length."""
    return v / ca.sqrt(ca.sumsqr(v))


def matrix(q: Any) -> ca.SX:
    """Rotation matrix R(q) of a unit quaternion, (3, 3) (A04 eq. 2.13)."""
    w, v = q[0], q[1:]
    return (w * w - ca.sumsqr(v)) * ca.DM.eye(3) + 2 * (v @ v.T) + 2 * w * skew(v)


def from_rotation_vector(theta: Any) -> ca.SX:
    """Return the unit quaternion of a rotation vector, exact at every angle, (4,).

    sin(a/2)/a is smooth at zero; its series takes over below 1e-4 rad, where the next term is
    beneath the rounding.
    """
    squared = ca.sumsqr(theta)
    small = squared < 1e-8
    angle = ca.sqrt(ca.if_else(small, 1.0, squared))
    ratio = ca.if_else(small, 0.5 - squared / 48, ca.sin(angle / 2) / angle)
    return ca.vertcat(ca.if_else(small, 1 - squared / 8, ca.cos(angle / 2)), ratio * theta)


def to_rotation_vector(q: Any) -> ca.SX:
    """Shortest rotation vector of a unit quaternion, (3,) [rad]."""
    w = ca.fabs(q[0])
    v = ca.if_else(q[0] < 0, -1.0, 1.0) * q[1:]
    squared = ca.sumsqr(v)
    small = squared < 1e-12
    length = ca.sqrt(ca.if_else(small, 1.0, squared))
    return ca.if_else(small, 2.0 / w, 2 * ca.atan2(length, w) / length) * v


def from_matrix(R: Any) -> ca.SX:
    """Return the unit quaternion of a rotation matrix, scalar part not negative, (4,).

    The row with the largest component divides, so no angle is singular (Shepperd's choice; A04 eq.
    4.27 divides by zero at 180 degrees).
    """
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    # 4 q q^T, whose diagonal tells which component is largest.
    squares = ca.vertcat(1 + trace, *(1 + 2 * R[i, i] - trace for i in range(3)))
    off = {
        (0, 1): R[2, 1] - R[1, 2],
        (0, 2): R[0, 2] - R[2, 0],
        (0, 3): R[1, 0] - R[0, 1],
        (1, 2): R[0, 1] + R[1, 0],
        (1, 3): R[0, 2] + R[2, 0],
        (2, 3): R[1, 2] + R[2, 1],
    }
    rows = [
        ca.vertcat(*(squares[i] if i == j else off[min(i, j), max(i, j)] for j in range(4)))
        for i in range(4)
    ]
    best, largest = rows[0], squares[0]
    for row, square in zip(rows[1:], ca.vertsplit(squares)[1:], strict=True):
        best = ca.if_else(square > largest, row, best)
        largest = ca.fmax(square, largest)
    return canonical(normalize(best))


def canonical(q: Any) -> ca.SX:
    """Return the one of q and -q whose scalar part is not negative, (4,); for outputs only."""
    return ca.if_else(q[0] < 0, -1.0, 1.0) * q
