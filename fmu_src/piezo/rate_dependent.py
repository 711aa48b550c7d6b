"""Rate-dependent modified Prandtl-Ishlinskii operator: loops that widen with the rate (A04 7.3).

    f_i    = min(rho, rho_i) - min(rho_0, rho_i)
    W_i    = W_i at rho_0 + c_i f_i                slopes of the loading curve   (7.15, 7.17)
    w_0    = W_0,  w_i = W_i - W_{i-1}             weights of the plays          (7.18)
    z      = sum s_j S_j(sum w_i H_i)                                            (7.19)

The rate rho = |z'| is that of the stroke, an argument of its own (7.19): A04 counts it in um/s. The
weights of `prandtl_ishlinskii` are those at the reference rate rho_0, so that c = 0 is the operator
that does not depend on the rate. Up to its limit rho_i each slope goes with the rate, above it it
stays: the first slopes act near turning points, where nothing is fast (A04 Fig. 7.11).

Where a slope falls with the rate there is a rate at which it reaches SMALLEST_SLOPE: above it the
operator has no inverse (A04 7.5). That singular rate is computed from the parameters, and not
crossed: faster than it, all slopes are those at it, and `singular` tells. `defined` tells whether
there is an inverse from rest up to it.

| symbol | field | meaning |
| --- | --- | --- |
| v, z, r, w, d, s, H | | as in `prandtl_ishlinskii` |
| z' | rate | rate of the stroke |
| c_i | rate_slopes | change of the slope W_i with the rate |
| rho_i | rate_limits | rate up to which W_i changes |
| rho_0 | reference_rate | rate at which the weights are `weights` |
| | singular_rate | least rate without an inverse; FASTEST if there is none |
"""

from typing import Any

import casadi as ca

from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, boolean, condition, real
from fmu_src.piezo import prandtl_ishlinskii
from fmu_src.piezo.inverse_prandtl_ishlinskii import SMALLEST_SLOPE, invert
from fmu_src.piezo.prandtl_ishlinskii import (
    NOMINAL,
    PLAYS,
    UNDEFINED,
    Hysteresis,
    X,
    remember,
    respond,
)

FASTEST = 0.1
"""Largest rate that counts [m/s], a hundred times that of any tremor: larger ones act as this."""


WEIGHTS = (0.4472, 0.0, 0.2992, 0.04211, 0.09927, 0.1051, 0.09479, 0.1535, 0.0808, 0.1718)
SATURATION = (NOMINAL, -1.777e-9, -1.405e-9, -9.697e-9)
RATE_SLOPES = (372.0, -815.4, 104.0, 19.74, -75.22, -26.51, -77.51, -58.46, -125.5, 6.225)
RATE_LIMITS = (200e-6,) * 2 + (750e-6,) * (PLAYS - 2)
"""A04 Fig. 7.11 has the first two slopes up to 200 um/s, and 746 um/s is the fastest of a sine of
12.5 um p-p at 19 Hz (7.3.2)."""
REFERENCE_RATE = 250e-6
"""Largest rate of a sine of 12.5 um p-p at 10 Hz."""

_Starting: Any = Hysteresis.starting(weights=WEIGHTS, saturation=SATURATION)


class RateDependence(_Starting):
    """Thresholds and weights of one stack, and how they depend on the rate.

    Starts are what `steadytip identify hysteresis` makes of six recordings of the excitation for
    modulated stops, 0.07 um rms of sensor noise in them, from a stack that it knows nothing else
    of.
    """

    rate_slopes = real(
        "s/m",
        "c, change of the slopes of the loading curve with the rate",
        shape=PLAYS,
        start=RATE_SLOPES,
        within=1e6,
    )
    rate_limits = real(
        "m/s",
        "rho_i, rates up to which they change",
        shape=PLAYS,
        start=RATE_LIMITS,
        min=0.0,
        max=FASTEST,
    )
    reference_rate = real(
        "m/s", "rho_0, rate at which the weights hold", start=REFERENCE_RATE, min=0.0, max=FASTEST
    )


class In(prandtl_ishlinskii.In):
    """Drive, and how fast it moves the stack."""

    rate = real("m/s", "z', rate of the stroke", within=10.0)


class Out(prandtl_ishlinskii.Out):
    """Response."""

    singular = boolean("whether the rate is above the singular one")


class Limits(Derived):
    """Range in which the operator has an inverse."""

    singular_rate = real("m/s", "least rate without an inverse", start=FASTEST)
    defined = condition("whether there is an inverse from rest up to that rate", UNDEFINED)


def slopes(p: RateDependence, rate: Any) -> ca.SX:
    """Return W, slopes of the loading curve at a rate not below 0, (PLAYS,), unlimited (7.17)."""
    moved = ca.fmin(rate, p.rate_limits) - ca.fmin(p.reference_rate, p.rate_limits)
    return ca.cumsum(p.weights) + p.rate_slopes * moved


def weights(curve: Any) -> ca.SX:
    """Return w, weights of the plays that make slopes W, (PLAYS,) (7.18)."""
    return ca.vertcat(curve[0], curve[1:] - curve[:-1])


def derive(p: RateDependence, T: float) -> Limits:
    """Compute the singular rate, and whether there is an inverse below it."""
    resting = slopes(p, 0.0)
    falling = ca.logic_and(p.rate_slopes < 0, slopes(p, p.rate_limits) < SMALLEST_SLOPE)
    fall = ca.if_else(falling, p.rate_slopes, -1.0)
    reached = ca.if_else(falling, (SMALLEST_SLOPE - resting) / fall, FASTEST)
    return Limits(
        singular_rate=ca.fmax(ca.fmin(ca.mmin(reached), FASTEST), 0.0),
        defined=invert(p.replace(weights=weights(resting))).defined,
    )


def at_rate(p: RateDependence, limits: Limits, rate: Any) -> tuple[RateDependence, ca.SX]:
    """Return the operator at a rate, or at the singular rate where that is lower.

    Args:
        p: thresholds, weights and their dependence.
        limits: the singular rate.
        rate: z' [m/s].

    Returns:
        The operator with the weights that it has then, and 1 where the rate is above the singular
        one, else 0.
    """
    fast = ca.fabs(rate)
    now = p.replace(weights=weights(slopes(p, ca.fmin(fast, limits.singular_rate))))
    return now, ca.logic_and(fast > limits.singular_rate, limits.singular_rate < FASTEST)


def step(p: RateDependence, u: In, x: X, T: float, derived: Limits) -> tuple[X, Out]:
    """Compute one sample."""
    now, singular = at_rate(p, derived, u.rate)
    plays = remember(p, u.volts, x.plays)
    return X(plays=plays), Out(stroke=respond(now, plays), singular=singular)


MODEL = Model.of_step("RatePrandtlIshlinskii", step, sample_period=1e-3, derive=derive)
