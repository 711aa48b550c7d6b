"""Inverse kinematics of the three-legged parallel manipulator (A04 6.3).

Three legs, each a stack behind a lever, carry a platform with the shaft on it. Leg i stands on a
pin at the base, swings in the vertical plane through its pin (angle 0, 120, 240 deg about z_0) and
holds the platform at a ball joint. The constraint equations are Lee and Shah's (A04 6.7 to 6.18),
solved here without A04's quartic (6.23), which was scanned with errors.

With R_01 = [n o a] the pin planes demand (A04 6.14, 6.17, 6.18)

    n_y = o_x,   y_c = -r n_y,   x_c = r (n_x - o_y) / 2.

The first says that the platform's quaternion is (w, e_x, e_y, 0): it tilts about a horizontal axis
and never twists. With the complex numbers e = e_y - i e_x, d = d_x + i d_y the rest becomes

    x_c + i y_c = -r conj(e)^2,   a_x + i a_y = 2 w e,   w^2 = 1 - |e|^2,   a_z = 1 - 2 |e|^2,

and a tip (6.19, 6.20) at the lateral place d needs a tilt e that solves

    2 l w e - r conj(e)^2 = d,   that is   e = (d + r conj(e)^2) / (2 l w).

The right side moves by some r |e| / l of what e moves, 0.001 within reach, so that ITERATIONS of
it from e = 0 leave nothing but rounding. What remains is explicit:

    z_c = z_0 + d_z - l (a_z - 1)                                       (6.21)
    L_i = |P_1 + R_01 b_i - p_i|,   lambda_i = (L_i - L_0) / k

A04 relates the stack to the height of the ball joint (6.49 to 6.51); here it is the leg's length,
which differs by less than 0.1 nm over the workspace.

A demand that asks for strokes outside 0 .. lambda_max is flagged, and gets the nearest place that
the tip can reach. Strokes that change by u move the tip, linearised at zero stroke, by

    |delta d|^2 = (k L_0 / z_0)^2 [2/3 q |u|^2 + (1 - 2 q) / 9 (u_1 + u_2 + u_3)^2],   q = (l / r)^2

of which the mean of u goes along the axis and the rest sideways. Among the strokes in range it is
least (where its gradient is zero or pushes against a limit) for

    lambda'_i = min(max(lambda_i + mu, 0), lambda_max)
    mu = c sum_i (lambda'_i - lambda_i),   c = 1/3 - 1 / (6 q)

one shift of all strokes, which gives up some of the axial part to keep the lateral one. With m
strokes free, the right side less mu changes by c m - 1 < 0 of what mu does: there is one root, on a
line that bends only where a stroke meets a limit. The nearest two of these six places enclose the
root, and one step of Newton's method from halfway between them is exact.

The frame 0 is parallel to the body frame B, x_0 through leg 1; displacements count from the tip at
zero stroke, and longer legs push the tip to +z.

| symbol | field | meaning |
| --- | --- | --- |
| d | displacement | tip less tip at zero stroke, in frame 0 |
| lambda_i | strokes | strokes of the stacks |
| lambda_max | longest_stroke | their range starts at 0 |
| R, r | base_radius, platform_radius | pins from z_0, ball joints from z_1 |
| l | shaft_length | platform centre to tip |
| L_0 | leg_length | legs at zero stroke |
| k | lever_gain | leg extension by stack stroke |
| p_i, b_i | | pin i in frame 0, ball joint i in frame 1 |
| P_1 = (x_c, y_c, z_c) | | platform centre, z_0 the one of zero stroke |
| e_x, e_y, w | tilt | quaternion of the platform |
"""

from typing import Any

import casadi as ca
import numpy as np

from fmu_src.device import design
from fmu_src.kit import Outputs, Parameters, State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Inputs, boolean, real, vector
from fmu_src.math import rotations

LEG_ANGLES = np.radians([0.0, 120.0, 240.0])
"""Directions of the legs about z_0 (A04 6.1)."""
ITERATIONS = 6
"""Steps to find the tilt; each is worth some three digits within reach."""
LARGEST_LATERAL = 0.25
"""Lateral demand, in shaft lengths, to which a longer one is shortened so that it has a tilt.
Twenty times the reach, hence of no effect but on demands that are limited anyway."""
NEWTON_STEPS = 4
"""Steps of the forward solution, from a level platform; for stacks of six times the stroke."""
LARGEST_TILT = 0.5
"""|e| to which the forward solution is kept, so that there is one for any strokes; 60 deg."""
ROUNDING = 1e-13
"""Stroke beyond the range that does not count as such [m]."""


class Geometry(Parameters):
    """Dimensions of the mechanism."""

    base_radius = real(
        "m", "R, pins from the centre", start=design.PLATFORM_RADIUS, min=1e-3, max=20e-3
    )
    platform_radius = real(
        "m", "r, ball joints from the centre", start=design.PLATFORM_RADIUS, min=1e-3, max=20e-3
    )
    shaft_length = real(
        "m", "l, platform centre to tip", start=design.SHAFT_LENGTH, min=20e-3, max=0.2
    )
    leg_length = real(
        "m", "L_0, legs at zero stroke; of second order only", start=20e-3, min=20e-3, max=0.2
    )
    lever_gain = real(
        None,
        "k, extension of a leg by stroke of its stack",
        start=design.LEVER_GAIN,
        min=1.0,
        max=20.0,
    )
    longest_stroke = real(
        "m", "stroke that a stack can be asked for", start=design.STACK_STROKE, min=1e-6, max=1e-4
    )


class In(Inputs):
    """Place wanted of the tip."""

    displacement = vector("m", "d, tip less tip at zero stroke, in frame 0", within=0.1)


class Out(Outputs):
    """Strokes that bring it there."""

    strokes = real("m", "lambda, strokes of the stacks within their range", shape=3)
    reachable = boolean("whether no stroke had to be limited")


class Resting(State):
    """Kinematics has no memory."""


def height(p: Geometry, strokes: Any) -> ca.SX:
    """Return the platform height z_c when all stacks have the same stroke [m]."""
    lean = p.base_radius - p.platform_radius
    return ca.sqrt((p.leg_length + p.lever_gain * strokes) ** 2 - lean**2)


def tilt(p: Geometry, lateral: Any) -> ca.SX:
    """Return quaternion parts e_x, e_y of the platform whose tip is displaced sideways, (2,).

    Args:
        p: dimensions.
        lateral: d_x, d_y, (2,) [m]; shortened to LARGEST_LATERAL where it is longer.
    """
    longest = LARGEST_LATERAL * p.shaft_length
    d = lateral * longest / ca.sqrt(ca.fmax(ca.sumsqr(lateral), longest**2))
    ex: Any = 0.0
    ey: Any = 0.0
    for _ in range(ITERATIONS):
        w = ca.sqrt(1 - ex**2 - ey**2)
        ex, ey = (
            -(d[1] + 2 * p.platform_radius * ex * ey) / (2 * p.shaft_length * w),
            (d[0] + p.platform_radius * (ey**2 - ex**2)) / (2 * p.shaft_length * w),
        )
    return ca.vertcat(ex, ey)


def pose(p: Geometry, e: Any, z_c: Any) -> tuple[ca.SX, ca.SX]:
    """Return the platform that keeps the pin planes, and its tip.

    Args:
        p: dimensions.
        e: e_x, e_y, (2,).
        z_c: height of the platform centre [m].

    Returns:
        Lengths of the legs, (3,) [m], and the tip in frame 0, (3,) [m].
    """
    rotation = rotations.matrix(ca.vertcat(ca.sqrt(1 - ca.sumsqr(e)), e, 0.0))
    centre = ca.vertcat(
        p.platform_radius * (rotation[0, 0] - rotation[1, 1]) / 2,
        -p.platform_radius * rotation[1, 0],
        z_c,
    )
    outward = np.array([np.cos(LEG_ANGLES), np.sin(LEG_ANGLES), np.zeros(3)])
    legs = [
        centre + p.platform_radius * rotation @ radial - p.base_radius * radial
        for radial in map(ca.DM, outward.T)
    ]
    lengths = ca.vertcat(*(ca.sqrt(ca.sumsqr(leg)) for leg in legs))
    return lengths, centre + p.shaft_length * rotation[:, 2]


def inverse(p: Geometry, displacement: Any) -> ca.SX:
    """Return strokes that bring the tip to a place, beyond the stacks' range if need be, (3,) [m].

    Args:
        p: dimensions.
        displacement: d, tip less tip at zero stroke, in frame 0, (3,) [m].
    """
    e = tilt(p, displacement[:2])
    # a_z - 1 = -2 |e|^2
    z_c = height(p, 0.0) + displacement[2] + 2 * p.shaft_length * ca.sumsqr(e)
    lengths, _ = pose(p, e, z_c)
    return (lengths - p.leg_length) / p.lever_gain


def settle(p: Geometry, strokes: Any) -> ca.SX:
    """Solve for tilt e_x, e_y and height z_c [m] of the platform at some strokes, (3,).

    Newton's method on the legs' lengths. Where no platform fits on legs so unequal, what comes out
    is finite, and no more.

    Args:
        p: dimensions.
        strokes: lambda, (3,) [m].
    """
    unknown = ca.SX.sym("unknown", 3)
    wanted = ca.SX.sym("wanted", 3)
    dimensions = ca.SX.sym("dimensions", p.size())
    lengths, _ = pose(Geometry.unpack(dimensions), unknown[:2], unknown[2])
    residual = lengths - wanted
    better = unknown - ca.solve(ca.jacobian(residual, unknown), residual)
    better[:2] *= LARGEST_TILT / ca.sqrt(ca.fmax(ca.sumsqr(better[:2]), LARGEST_TILT**2))
    newton = ca.Function("newton", [unknown, wanted, dimensions], [better])

    now = ca.vertcat(0.0, 0.0, height(p, ca.sum1(strokes) / 3))
    for _ in range(NEWTON_STEPS):
        now = newton(now, p.leg_length + p.lever_gain * strokes, p.pack())
    return now


def tip_displacement(p: Geometry, settled: Any) -> ca.SX:
    """Return d, tip of a settled platform less tip at zero stroke, frame 0, (3,) [m].

    Args:
        p: dimensions.
        settled: e_x, e_y, z_c as from `settle`, (3,).
    """
    _, tip = pose(p, settled[:2], settled[2])
    return tip - ca.vertcat(0.0, 0.0, height(p, 0.0) + p.shaft_length)


def forward(p: Geometry, strokes: Any) -> ca.SX:
    """Return d, the displacement of the tip by strokes, frame 0, (3,) [m].

    Args:
        p: dimensions.
        strokes: lambda, (3,) [m].
    """
    return tip_displacement(p, settle(p, strokes))


def limited(p: Geometry, strokes: Any) -> tuple[ca.SX, ca.SX]:
    """Limit strokes to those in range with the nearest tip; tell whether they were in range.

    Args:
        p: dimensions.
        strokes: lambda, (3,) [m].

    Returns:
        Strokes, (3,) [m], and 1 or 0; the very strokes given, but for ROUNDING, where it is 1.
    """
    c = 1 / 3 - (p.platform_radius / p.shaft_length) ** 2 / 6
    total = ca.sum1(strokes)

    def clip(mu: Any) -> Any:
        return ca.fmin(ca.fmax(strokes + mu, 0.0), p.longest_stroke)

    def excess(mu: Any) -> Any:
        return c * (ca.sum1(clip(mu)) - total) - mu

    # From the root with all strokes at 0 to that with all at lambda_max.
    low, high = -c * total, c * (3 * p.longest_stroke - total)
    for limit in (0.0, p.longest_stroke):
        for stroke in ca.vertsplit(strokes):
            meeting = limit - stroke
            beneath = excess(meeting) > 0
            low = ca.if_else(beneath, ca.fmax(low, meeting), low)
            high = ca.if_else(beneath, high, ca.fmin(high, meeting))
    middle = (low + high) / 2
    free = ca.logic_and(strokes + middle > 0, strokes + middle < p.longest_stroke)
    mu = middle + excess(middle) / (1 - c * ca.sum1(free))

    reachable = ca.mmax(ca.fabs(strokes - clip(0.0))) <= ROUNDING
    return clip(ca.if_else(reachable, 0.0, mu)), reachable


def step(p: Geometry, u: In, x: Resting, T: float) -> tuple[Resting, Out]:
    """Compute one sample."""
    strokes, reachable = limited(p, inverse(p, u.displacement))
    return x, Out(strokes=strokes, reachable=reachable)


MODEL = Model.of_step("Parallel3Dof", step, sample_period=1e-3)
