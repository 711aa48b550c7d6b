"""Prandtl-Ishlinskii operator with creep after Krejci and Kuhnen (2001) (A04 7.5).

    K_ij' = (v - K_ij - max(-rho_i, min(rho_i, v - K_ij))) / tau_j               creep operator
    y     = sum w_i H_i + sum_i c_i sum_j K_ij
    z     = sum s_j S_j(y)                         dead zones as in `prandtl_ishlinskii`

A creep operator is a play that takes its time: it follows the voltage at a distance of rho_i, with
a lag of tau_j. One of each decade, all with one weight, make a creep that goes with the logarithm
of time; thresholds make small moves creep less than large ones. With the weights w = (1, 0, ...)
and one dead zone it is the operator of creep alone.

The stroke is that at the end of the sample that the voltage is held for. The creep in it is what
the voltages before have brought about, so that the inverse is exact and explicit.

| symbol | field | meaning |
| --- | --- | --- |
| v, z, r, w, d, s, H | | as in `prandtl_ishlinskii` |
| K_ij | crept | outputs of the creep operators, by threshold and time |
| rho_i | creep_thresholds | half widths of the creep operators |
| c_i | creep_weights | weights of the creep operators |
| tau_j | creep_time | times of creep |
"""

from typing import Any

import casadi as ca

from fmu_src.kit import State
from fmu_src.kit.model import Model
from fmu_src.kit.records import Derived, real
from fmu_src.piezo.modulated_stops import CREEP_TIMES, LAGS, In, Out
from fmu_src.piezo.prandtl_ishlinskii import NOMINAL, PLAYS, Hysteresis, remember, stops

WIDTHS = 4
"""Thresholds of creep."""


WEIGHTS = (0.4191, 0.1642, 0.1451, 0.06004, 0.1004, 0.08083, 0.1114, 0.1155, 0.09938, 0.1625)
SATURATION = (NOMINAL, -5.69e-9, 2.056e-9, -9.306e-9)
CREEP_WEIGHTS = (0.0, 0.01797, 0.007166, 0.0)

_Starting: Any = Hysteresis.starting(weights=WEIGHTS, saturation=SATURATION)


class Creeping(_Starting):
    """Thresholds and weights of one stack, and its creep.

    Starts are identified as those of `rate_dependent`.
    """

    creep_thresholds = real(
        "V",
        "rho, half widths of the creep operators",
        shape=WIDTHS,
        start=(0.0, 8.0, 20.0, 38.0),
        min=0.0,
        max=200.0,
    )
    creep_weights = real(
        None, "c, weights of the creep operators", shape=WIDTHS, start=CREEP_WEIGHTS, within=10.0
    )
    creep_time = real("s", "tau, times of creep", shape=LAGS, start=CREEP_TIMES, min=1e-3, max=1e5)


class Memory(State):
    """Memory of a stack."""

    plays = real("V", "H, outputs of the plays", shape=PLAYS)
    crept = real("V", "K, outputs of the creep operators", shape=(WIDTHS, LAGS))
    volts = real("V", "voltage of the sample before")


class Pace(Derived):
    """Creep in a sample, computed from the parameters."""

    share = real(None, "of the way that is left, crept in a sample", shape=LAGS)


def derive(p: Creeping, T: float) -> Pace:
    """Compute the creep in a sample."""
    return Pace(share=1 - ca.exp(-T / p.creep_time))


def creep(p: Creeping, pace: Pace, x: Memory) -> tuple[ca.SX, ca.SX]:
    """Return the creep at the end of a sample, which its voltage does not move yet.

    Args:
        p: thresholds and weights.
        pace: creep in a sample.
        x: memory of the stack.

    Returns:
        Outputs K of the operators, (WIDTHS, LAGS) [V], and what they add to y [V].
    """
    way = x.volts - x.crept
    width = ca.repmat(p.creep_thresholds, 1, LAGS)
    beyond = way - ca.fmax(-width, ca.fmin(width, way))
    crept = x.crept + beyond * ca.repmat(pace.share.T, WIDTHS, 1)
    return crept, ca.dot(p.creep_weights, ca.sum2(crept))


def remembered(p: Creeping, crept: Any, volts: Any, x: Memory) -> Memory:
    """Return the memory after a voltage has been held for a sample."""
    return Memory(plays=remember(p, volts, x.plays), crept=crept, volts=volts)


def step(p: Creeping, u: In, x: Memory, T: float, derived: Pace) -> tuple[Memory, Out]:
    """Compute one sample."""
    crept, added = creep(p, derived, x)
    following = remembered(p, crept, u.volts, x)
    y = ca.dot(p.weights, following.plays) + added
    return following, Out(stroke=ca.dot(p.saturation, stops(y, p.dead_zones)))


MODEL = Model.of_step("CreepPrandtlIshlinskii", step, sample_period=1e-3, derive=derive)
