"""TRIAD: attitude from the vertical and the magnetic field, and its covariance.

| symbol | meaning |
| --- | --- |
| z_B | unit vector up, in B: specific force at rest over its length |
| n_B | unit magnetic field in B |
| sigma_G, sigma_N | standard deviation of a component of z_B, n_B across it [1] |
| Xi | covariance of the attitude error, a rotation vector in B [rad2] |

World axes: z up, y = z x n, x = y x z, which is horizontal magnetic north (A04 2.22 to 2.25).
"""

from typing import Any

import casadi as ca

from fmu_src.math import rotations


def attitude(z_B: Any, n_B: Any) -> ca.SX:
    """Attitude q_WB, (4,).

    The field's part across the vertical must not vanish: at the poles there is no north. A guard
    keeps the result finite there; `dip_sine` tells.
    """
    east = ca.cross(z_B, n_B)
    y_B = east / ca.fmax(ca.sqrt(ca.sumsqr(east)), 1e-9)
    # Rows of R_WB are the world's axes in B; a vanished row would not leave a rotation.
    R = ca.vertcat(ca.cross(y_B, z_B).T, y_B.T, z_B.T)
    lost = ca.sumsqr(east) < 1e-12
    return ca.if_else(lost, ca.vertcat(1, 0, 0, 0), rotations.from_matrix(R))


def covariance(z_B: Any, n_B: Any, sigma_G: Any, sigma_N: Any) -> ca.SX:
    """Covariance of the attitude error in B, (3, 3) (A04 4.34)."""
    east = ca.cross(z_B, n_B)
    across = ca.fmax(ca.sumsqr(east), 1e-6)
    zz, zn = z_B @ z_B.T, z_B @ n_B.T
    mixed = ca.dot(z_B, n_B) * (zn + zn.T)
    G, N = sigma_G**2, sigma_N**2
    return G * ca.SX.eye(3) + ((N - G) * zz + G * mixed) / across
