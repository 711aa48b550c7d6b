"""Inverse of the rate-dependent operator: voltage that gives a stroke at its rate (A04 7.3.3).

    y, y' = demand z and its rate, a horizon h ahead                             `demand`
    v     = inverse of the operator at the rate y'                               (7.20, 7.21)

A04's inverse is exact only while the rate holds, because its memory is that of the weights at an
earlier rate. Here the memory is the forward operator's, moved by the voltage really sent, and the
inverse's own follows from it at every sample with the weights of that sample's rate: forward and
inverse agree however the rate changes.

The rate is the demand's by its last three samples, or, with `rate_valid`, the one that comes in.
Above the singular rate the slopes stay what they are at it, and `singular` warns: the voltage is
then that of the last rate with an inverse, smaller loops than the stack's.

| symbol | field | meaning |
| --- | --- | --- |
| z, z' | stroke, rate | stroke wanted, and its rate where that is known |
| v | volts | voltage, within amplifier.lowest and amplifier.highest |
| h T | horizon | how far ahead of the demand the voltage has to be |
| others | | as in `rate_dependent` and `inverse_prandtl_ishlinskii` |
"""

from typing import Any

import casadi as ca

from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, boolean, real
from fmu_src.piezo import inverse_prandtl_ishlinskii as inverse
from fmu_src.piezo import rate_dependent
from fmu_src.piezo.demand import ahead, seen
from fmu_src.piezo.inverse_prandtl_ishlinskii import Range, X
from fmu_src.piezo.rate_dependent import Limits, RateDependence


class Params(inverse.Params):
    """The operator to invert, and the amplifier."""

    hysteresis: Any = RateDependence


class In(inverse.In):
    """Stroke wanted, and its rate."""

    rate = real("m/s", "z', its rate where the voltage acts", within=10.0)
    rate_valid = boolean("whether `rate` is given; else it is the demand's", start=False)


class Out(inverse.Out):
    """Voltage to send, and the rate it is for."""

    rate_used = real("m/s", "rate that the inverse is for")
    singular = boolean("whether that rate is above the singular one")


class Precomputed(Derived):
    """Range of the inverse, computed from the parameters."""

    limits: Any = Limits


def derive(p: Params, T: float) -> Precomputed:
    """Compute the range in which the inverse exists."""
    return Precomputed(limits=rate_dependent.derive(p.hysteresis, T))


def drive(
    p: RateDependence, limits: Limits, amplifier: Range, stroke: Any, rate: Any, plays: Any
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Find the voltage that gives a stroke at a rate.

    Args:
        p: the operator.
        limits: where it has an inverse.
        amplifier: range of the voltage.
        stroke: z [m].
        rate: z' [m/s].
        plays: H, memory of the forward operator, (PLAYS,) [V].

    Returns:
        Voltage within the range [V], whether it had to be limited, the memory after it has been
        sent, (PLAYS,) [V], and whether the rate is above the singular one.
    """
    now, singular = rate_dependent.at_rate(p, limits, rate)
    volts, limited, following = inverse.drive(now, inverse.invert(now), amplifier, stroke, plays)
    return volts, limited, following, singular


def step(p: Params, u: In, x: X, T: float, derived: Precomputed) -> tuple[X, Out]:
    """Compute one sample."""
    wanted, rise = ahead(u.stroke, x.demand, p.horizon / T)
    rate = ca.if_else(u.rate_valid, u.rate, rise / T)
    volts, limited, plays, singular = drive(
        p.hysteresis, derived.limits, p.amplifier, wanted, rate, x.plays
    )
    following = X(plays=plays, demand=seen(u.stroke, x.demand))
    return following, Out(volts=volts, limited=limited, rate_used=rate, singular=singular)


MODEL = Model.of_step("InverseRatePrandtlIshlinskii", step, sample_period=1e-3, derive=derive)
