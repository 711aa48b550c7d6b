"""Start of the filter from TRIAD, and a new start after a long time without a vertical."""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from fmu_src.estimation.micron import attitude_filter, plausibility
from fmu_src.estimation.micron.sample import Sample
from fmu_src.filters import triad

AGREEMENT = np.radians(10.0)
"""Within which TRIAD of two samples must agree for the filter to start [rad]."""


class Start(NamedTuple):
    """Start of the filter, and whether it goes on.

    Attributes:
        z: TRIAD's attitude of this sample, (4,).
        dip: of the field, from this sample alone [rad].
        young: whether the filter settles, nearly at rest.
        lost: whether there has been no vertical for too long.
        going: whether the filter goes on.
        anew: whether it starts with this sample, or waits for one.
        age: time since the start [s].
    """

    z: Any
    dip: Any
    young: Any
    lost: Any
    going: Any
    anew: Any
    age: Any


def follow_start(p: Any, s: Sample, x: Any, T: float) -> Start:
    """Return whether the filter goes on, and since when."""
    gates = p.gates
    z = triad.attitude(s.z_B, s.n_B)
    dip = plausibility.dip(ca.dot(s.z_B, s.n_B))
    # Nearly at rest, a start without a vertical was a wrong one.
    young = x.age < p.settling
    lost = x.off_vertical > ca.if_else(young, gates.start_patience, gates.tilt_patience)
    familiar = plausibility.as_it_was(s.strength, dip, gates, x.field)
    again = ca.logic_and(ca.logic_and(lost, s.complete), ca.logic_or(young, familiar))
    agrees = ca.sumsqr(attitude_filter.innovation(x.q, z)) < AGREEMENT**2
    going = ca.logic_and(
        ca.logic_and(x.started, ca.logic_or(x.confirmed, agrees)), ca.logic_not(again)
    )
    age = ca.if_else(going, x.age + T, T * s.complete)
    return Start(z, dip, young, lost, going, ca.logic_not(going), age)
