"""Correction by the vertical, whose covariance follows what the hand does."""

from typing import Any, NamedTuple

import casadi as ca

from fmu_src.estimation.micron import attitude_filter
from fmu_src.estimation.micron.prediction import Prediction, Turn
from fmu_src.estimation.micron.sample import Sample
from fmu_src.estimation.micron.start import Start


class Vertical(NamedTuple):
    """Correction of the tilt.

    Attributes:
        residual: of the vertical, (2,) [rad].
        correction: see `attitude_filter.Correction`.
        agitation: mean square of the hand's acceleration, for an axis [m2/s4].
        excess: of it beyond what sigma_C, noise and tilt explain [m2/s4].
        off_vertical: time without a vertical [s].
        sigma: of the vertical in a sample, the hand's usual acceleration included [rad].
    """

    residual: Any
    correction: attitude_filter.Correction
    agitation: Any
    excess: Any
    off_vertical: Any
    sigma: Any


def correct_tilt(
    p: Any, s: Sample, start: Start, turn: Turn, before: Prediction, x: Any, T: float
) -> Vertical:
    """Return the correction of the tilt by the vertical of this sample."""
    gates, R = p.gates, before.R
    P_W = R @ before.P[:3, :3] @ R.T
    strange = ca.sumsqr(s.gravity_B - p.gravity * before.up_B) / 3
    share = T / gates.agitation_time * turn.usable
    agitation = ca.if_else(start.anew, 0, x.agitation + share * (strange - x.agitation))
    hand = p.hand_acceleration**2
    tilted = p.gravity**2 * (P_W[0, 0] + P_W[1, 1]) / 3
    excess = ca.fmax(agitation - 2 * (hand + before.white) - tilted, 0)
    excess = ca.fmin(excess, gates.force**2)
    still = ca.logic_and(turn.usable, ca.fabs(s.weight - p.gravity) < gates.force)
    residual = attitude_filter.tilt_innovation(R @ s.z_B)
    variance = (before.white + hand) / s.weight**2
    everything = ca.SX.eye(6)
    correction = attitude_filter.correct(
        before.P,
        residual,
        ca.horzcat(R[:2, :], ca.SX.zeros(2, 3)),
        (variance + excess * gates.coherence / T / s.weight**2) * ca.SX.eye(2),
        ca.logic_and(start.going, still),
        gates.sigma,
        ca.if_else(p.decoupled, everything - before.heading, everything),
    )
    # A wrong vertical stays wrong, whatever acceleration it is mistaken for; a hand turns back.
    spread = variance + ca.fmax(P_W[0, 0], P_W[1, 1])
    met = ca.logic_and(still, ca.sumsqr(residual) < gates.sigma**2 * spread)
    off_vertical = ca.if_else(ca.logic_or(start.anew, met), 0, x.off_vertical + T)
    sigma = ca.sqrt(before.white + hand) / s.weight
    return Vertical(residual, correction, agitation, excess, off_vertical, sigma)
