"""Correction of the heading by the magnetic field, where the field is believed."""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from fmu_src.estimation.micron import attitude_filter, plausibility
from fmu_src.estimation.micron.prediction import Prediction
from fmu_src.estimation.micron.sample import LEAST_NORTH, Sample
from fmu_src.estimation.micron.start import Start
from fmu_src.estimation.micron.vertical import Vertical


class North(NamedTuple):
    """Correction of the heading.

    Attributes:
        residual: of the heading [rad].
        H: its derivative by the attitude error in W, (1, 3).
        level: squared level part of the unit field, not below `LEAST_NORTH` squared.
        correction: see `attitude_filter.Correction`.
        believed: whether the field is the earth's.
        state: next `plausibility.Field`.
    """

    residual: Any
    H: Any
    level: Any
    correction: attitude_filter.Correction
    believed: Any
    state: plausibility.Field


def correct_heading(
    p: Any, s: Sample, start: Start, before: Prediction, tilt: Vertical, x: Any, T: float
) -> North:
    """Return the correction of the heading after that of the tilt."""
    gates, R, heard = p.gates, before.R, s.alive.field
    field_W = R @ s.n_B
    residual, H = attitude_filter.north_innovation(field_W)
    dip = ca.if_else(ca.logic_or(start.lost, start.anew), start.dip, plausibility.dip(field_W[2]))
    accepted = plausibility.accepted(gates, x.field)
    as_it_was = ca.logic_or(accepted, plausibility.as_it_was(s.strength, dip, gates, x.field))
    level = ca.sumsqr(field_W[:2])
    level_of_north = ca.fmax(level, LEAST_NORTH**2)
    opened = (np.pi / 2) ** 2 * accepted
    # Far from level the vertical's turn is one about the wrong axis by its square.
    opened = opened + ca.sumsqr(tilt.correction.change[:3]) ** 2
    correction = attitude_filter.correct(
        tilt.correction.P + opened * ca.diagcat(before.heading[:3, :3], ca.SX.zeros(3, 3)),
        residual - H @ (R @ tilt.correction.change[:3]),
        ca.horzcat(H @ R, ca.SX.zeros(1, 3)),
        before.sigma_N**2 / level_of_north,
        ca.logic_and(
            ca.logic_and(start.going, ca.logic_and(heard, level > LEAST_NORTH**2)),
            ca.logic_and(as_it_was, ca.logic_or(accepted, x.field.doubt <= 0)),
        ),
        gates.sigma,
        ca.if_else(p.decoupled, before.heading, ca.SX.eye(6)),
    )
    believed = ca.logic_and(as_it_was, correction.nis <= gates.sigma**2)
    state = plausibility.follow_field(
        s.strength, dip, start.dip, heard, s.dead_field, believed, start.anew, x.age, gates,
        x.field, T,
    )  # fmt: skip
    return North(residual, H, level_of_north, correction, believed, state)
