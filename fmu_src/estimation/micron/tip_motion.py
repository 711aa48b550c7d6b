"""Tip velocity and displacement from its acceleration, free of drift.

| symbol | meaning |
| --- | --- |
| a | tip acceleration in W, as lagged by the sensors' output filter [m/s2] |
| c | corner of the wash-out [rad/s] |
| m | slow mean of a [m/s2] |
| v, d | velocity and displacement, lagged as a is [m/s, m] |
| tau | time constant of the output filter [s] |

    m' = c (a - m),     v' = (a - m) - c v - c^2 d,     d' = v

is double integration with a third-order Butterworth high-pass: an offset of a, as a tilt error of
gravity leaves, dies out of d, and slow noise stays bounded. The price is a phase lead of 2 c / w at
the frequency w. Trapezoidal rule: no phase of its own.

A signal behind a lag, y = x - tau y', is put right without differentiating: the displacement is one
integral behind the velocity, so x_d = d + tau v, x_v = v + tau a. Only the acceleration needs a
derivative, x_a = a + tau a', band-limited.
"""

from typing import Any

import casadi as ca

STATES = 3
"""m, v, d for each axis."""


def discretise(corner: Any, T: float) -> tuple[ca.SX, ca.SX]:
    """Trapezoidal rule: x[k] = A x[k-1] + B (a[k] + a[k-1]), A (3, 3), B (3,)."""
    A = ca.vertcat(
        ca.horzcat(-corner, 0, 0), ca.horzcat(-1, -corner, -(corner**2)), ca.horzcat(0, 1, 0)
    )
    B = ca.vertcat(corner, 1, 0)
    left = ca.inv_minor(ca.SX.eye(3) - A * (T / 2))
    return left @ (ca.SX.eye(3) + A * (T / 2)), left @ B * (T / 2)


def advance(x: Any, A: Any, B: Any, a: Any, a_before: Any) -> ca.SX:
    """States one sample later for all axes, (3 states, 3 axes)."""
    return A @ x + B @ (a + a_before).T
