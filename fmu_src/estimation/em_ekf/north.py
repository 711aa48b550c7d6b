"""Correction of the heading by the magnetic field, weaker where it is disturbed."""

from typing import Any, NamedTuple

import casadi as ca

from fmu_src.estimation import attitude_sources as sources
from fmu_src.estimation.em_ekf.gravity import Gravity
from fmu_src.estimation.em_ekf.interface import Params, X
from fmu_src.estimation.em_ekf.prediction import Due
from fmu_src.estimation.em_ekf.state import FILTER, Nominal, heading, heading_residual
from fmu_src.filters.error_state import correct_if
from fmu_src.math import rotations

DOUBT = 3.0
"""Seconds that a field must fit for each one that it did not (chosen on the BROAD trials)."""


def disturbance(site: Any, q: Any, field: Any) -> Any:
    """Return whether strength or dip of a field are not those of the site.

    Args:
        site: strength [T] and dip [rad], and how far a field may depart from them, (4,).
        q: attitude.
        field: in B, (3,) [T].
    """
    size = ca.sqrt(ca.sumsqr(field) + 1e-24)
    dip = ca.asin(ca.fmax(ca.fmin(-(rotations.matrix(q)[2, :] @ field) / size, 1), -1))
    return ca.logic_or(ca.fabs(size / site[0] - 1) > site[2], ca.fabs(dip - site[1]) > site[3])


class Heading(NamedTuple):
    """Correction by the magnetic field.

    Attributes:
        nominal, P: state and covariance after it.
        nis: normalised innovation squared.
        by: whether it was made.
        usable: whether the field may be used.
        doubt: time for which a field that was strange is not believed [s].
        disturbed: whether it is strange.
    """

    nominal: Any
    P: Any
    nis: Any
    by: Any
    usable: Any
    doubt: Any
    disturbed: Any


def correct_by_field(p: Params, x: X, d: Due, gravity: Gravity) -> Heading:
    """Return the correction of the heading, weaker where the field is disturbed."""
    m, e, g = p.magnetic, p.tracker, d.g
    nominal, field = gravity.nominal, d.mean[3:]
    site = ca.vertcat(m.strength, m.inclination, m.strength_limit, m.dip_limit)
    (strange,) = sources.recorded(
        "disturbance", disturbance, site, Nominal.unpack(nominal).attitude, field
    )
    grown = ca.fmin(x.doubt + DOUBT * g.waited, ca.if_else(e.hard_switching, 0, m.hold))
    left_over = ca.fmax(x.doubt - g.waited, 0)
    doubt = ca.if_else(d.aided, ca.if_else(strange, grown, left_over), x.doubt)
    disturbed = ca.if_else(d.aided, ca.logic_or(strange, doubt > 0), x.disturbed)
    horizontal = m.strength * ca.cos(m.inclination)
    heading_density = ca.if_else(disturbed, m.disturbed_density, m.heading_density)
    R_h = ((m.noise / horizontal) ** 2 + heading_density**2) / (2 * g.waited)
    usable = ca.logic_and(m.used, ca.logic_not(disturbed))
    by_heading = ca.logic_and(gravity.by, ca.if_else(e.hard_switching, usable, m.used))
    q = Nominal.unpack(nominal).attitude
    (measured,) = sources.recorded("heading", heading, q, field)
    known = ca.vertcat(measured, q, m.inclination)
    nominal, P, nis = correct_if(
        by_heading, FILTER, heading_residual, nominal, gravity.P, known, R_h, e.gate
    )
    return Heading(nominal, P, nis, by_heading, usable, doubt, disturbed)
