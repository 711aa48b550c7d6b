"""Differential sensing kinematics of the six-channel all-accelerometer unit (A04 2.3.1, 2.3.3).

| symbol | meaning |
| --- | --- |
| P_i | site i in B [m], i = 1, 2, 3 |
| P_ij | P_j - P_i |
| f | specific force of the channels (a1x, a1z, a2y, a2z, a3x, a3y) [m/s2] |
| A_D | differences (a13x, a23y, a12z) = M f [m/s2] (2.42) |
| alpha, w | angular acceleration and rate of B, in B [rad/s2, rad/s] |
| P_D | alpha to A_D without centripetal terms (2.16, with its erratum) |
| S_A | one-sided spectral density of a channel's noise [m2/s3] |
| S_r | spectral density of the hand's roll acceleration, prior knowledge [rad2/s3] |

With six channels and six unknowns the three differences determine alpha, but badly: the sum of
alpha_x and alpha_y rests on d1 = 20 mm, and alpha_z amplifies that. A hand rolls its instrument
little, so alpha minimises

    |A_D - P_D alpha|^2 / S_AD + alpha_z^2 / S_r,       S_AD = 2 S_A

which for S_r to infinity is A04 2.15. The tip's specific force follows from every channel through
alpha; the two channels that share an axis are compounded by their variances (2.31). Both steps
together are the generalised least squares of all six channels, solved by elimination.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.kit.records import Parameters, real

CHANNELS = ("a1x", "a1z", "a2y", "a2z", "a3x", "a3y")
"""Accelerometer channels in the order of all vectors of six."""
PLACES = ((0, 0), (0, 2), (1, 1), (1, 2), (2, 0), (2, 1))
"""Site and axis of each channel, both from 0."""
PAIRS = ((0, 4), (2, 5), (1, 3))
"""Channels that share the axis x, y, z; A_D is the second of a pair minus the first."""


ROLL_DENSITY = 0.17 / np.sqrt(10.0)
"""A hand's roll acceleration: 0.17 rad/s2 rms, taken as white up to 10 Hz [rad/s2/Hz0.5]."""
DENSITY = real(
    "m/s2/Hz0.5",
    "noise density",
    start=design.ACCELEROMETER_NOISE,
    shape=6,
    min=1e-6,
    max=1.0,
)
LAG = real("s", "tau, output filter", start=design.SENSOR_LAG, min=0.0, max=0.1)
"""Declarations for the accelerometers: noise, and the filter ahead of the converter."""


class Layout(Parameters):
    """Places of the sites and the tip in B."""

    d1 = real("m", "d1, sites 1 and 2 across the axis", start=design.D1, min=1e-3, max=1.0)
    d2 = real("m", "d2, site 3 across the axis", start=design.D2, min=1e-3, max=1.0)
    d3 = real("m", "d3, site 3 along the axis", start=design.D3, min=1e-3, max=1.0)
    tip = real("m", "tip in B", start=design.TIP, shape=3, within=1.0)


@dataclass(frozen=True)
class Geometry:
    """Places of the sites and the tip in B, columns of three [m]."""

    sites: tuple[Any, Any, Any]
    tip: Any

    @classmethod
    def of_design(cls, d1: Any, d2: Any, d3: Any, tip: Any) -> "Geometry":
        """Sites from the three distances of A04 2.54."""
        return cls(
            (ca.vertcat(d1, 0, 0), ca.vertcat(0, d1, 0), ca.vertcat(d2, d2, d3)),
            tip,
        )

    @classmethod
    def of(cls, layout: Layout) -> "Geometry":
        """Return the geometry of a layout given as parameters."""
        return cls.of_design(layout.d1, layout.d2, layout.d3, layout.tip)

    def baselines(self) -> list[Any]:
        """P_13, P_23, P_12: from the first to the second site of each pair."""
        return [self.sites[PLACES[j][0]] - self.sites[PLACES[i][0]] for i, j in PAIRS]


def differences(f: Any) -> ca.SX:
    """A_D of six specific forces, (3,) (A04 2.42)."""
    return ca.vertcat(*(f[j] - f[i] for i, j in PAIRS))


def lever_matrix(geometry: Geometry) -> ca.SX:
    """P_D, (3, 3): row i is axis i of alpha x P (A04 2.16; the lower right entry is -p12x)."""
    rows = []
    for axis, p in enumerate(geometry.baselines()):
        unit = ca.DM.zeros(3)
        unit[axis] = 1
        rows.append(ca.cross(p, unit).T)  # e . (alpha x p) = alpha . (p x e)
    return ca.vertcat(*rows)


def centripetal(w: Any, p: Any) -> ca.SX:
    """Acceleration of the point p from the rate alone, w x (w x p), (3,)."""
    return w * ca.dot(w, p) - p * ca.dot(w, w)


def rate_gain(geometry: Geometry, accelerometer_density: Any, roll_density: Any) -> ca.SX:
    """Gain from A_D to alpha, (3, 3).

    Args:
        geometry: sites.
        accelerometer_density: S_A [m2/s3].
        roll_density: S_r [rad2/s3]; very large is A04's plain inverse of P_D.
    """
    P_D = lever_matrix(geometry)
    prior = ca.diag(ca.vertcat(0, 0, 2 * accelerometer_density / roll_density))
    return ca.inv_minor(P_D.T @ P_D + prior) @ P_D.T


def angular_acceleration(
    A_D: Any,
    w_before: Any,
    geometry: Geometry,
    densities: tuple[Any, Any],
    T: float,
    iterations: int = 2,
) -> ca.SX:
    """Angular acceleration by nonlinear least squares, (3,) (A04 2.5 to 2.8).

    Centripetal terms are included: Gauss-Newton on w, started at the rate before; then alpha =
    (w - w_before) / T. The centripetal terms change by w T over a sample, so two iterations are
    exact to rounding at every rate of a hand.

    Args:
        A_D: differences (3,).
        w_before: body rate at the sample before, without its bias (3,).
        geometry: sites.
        densities: (S_A, S_r) as in `rate_gain`.
        T: sample period.
        iterations: Gauss-Newton steps.
    """
    P_D = lever_matrix(geometry)
    baselines = geometry.baselines()
    ridge = 2 * densities[0] / densities[1] / T**2
    w = w_before
    for _ in range(iterations):
        curved = ca.vertcat(*(centripetal(w, p)[i] for i, p in enumerate(baselines)))
        slope = ca.vertcat(*(_centripetal_slope(w, p)[i, :] for i, p in enumerate(baselines)))
        residual = A_D - P_D @ (w - w_before) / T - curved
        J = P_D / T + slope
        normal = J.T @ J + ca.diag(ca.vertcat(0, 0, ridge))
        gradient = J.T @ residual - ca.vertcat(0, 0, ridge * (w[2] - w_before[2]))
        w = w + ca.inv_minor(normal) @ gradient
    return (w - w_before) / T


def _centripetal_slope(w: Any, p: Any) -> ca.SX:
    """d/dw of `centripetal`, (3, 3)."""
    return ca.dot(w, p) * ca.SX.eye(3) + w @ p.T - 2 * p @ w.T


def compound(f: Any, variances: Any) -> ca.SX:
    """One specific force from both channels of each axis, levers ignored, (3,) (A04 2.53)."""
    return ca.vertcat(
        *(
            (variances[j] * f[i] + variances[i] * f[j]) / (variances[i] + variances[j])
            for i, j in PAIRS
        )
    )


def tip_force(f: Any, alpha: Any, w: Any, geometry: Geometry, variances: Any) -> ca.SX:
    """Specific force at the tip in B, (3,): each channel moved to the tip, then compounded.

    Args:
        f: specific forces (6,).
        alpha: angular acceleration (3,).
        w: body rate (3,).
        geometry: sites and tip.
        variances: of the channels, in any common unit (6,).
    """
    moved = []
    for channel, (site, axis) in enumerate(PLACES):
        lever = geometry.tip - geometry.sites[site]
        rotation = ca.cross(alpha, lever) + centripetal(w, lever)
        moved.append(f[channel] + rotation[axis])
    return compound(ca.vertcat(*moved), variances)
