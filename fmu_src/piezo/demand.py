"""Demand of an inverse, looked ahead: what is computed now acts a horizon later.

    y  = d + h d' + h (h + 1) / 2 d''             demand a horizon h ahead, h in samples
    y' = (d' + (h + 1 / 2) d'') / T               its rate there

d' and d'' are the first and second backward differences of the demand d: y is the parabola through
the last three demands. A voltage computed from the demand of one instant acts until the next one,
where its effect is measured, hence a horizon of one sample where the demand is of now, more for an
amplifier or a mechanism that lags, and 0 where the demand is ahead already.

| symbol | field | meaning |
| --- | --- | --- |
| d | stroke | stroke wanted, now |
| h T | horizon | how far ahead of the demand the voltage has to be |
| | before, earlier | demand one and two samples ago |
"""

from typing import Any

import casadi as ca

from fmu_src.kit import State
from fmu_src.kit.records import real

LONGEST = 20e-3
"""Largest horizon [s]: a parabola says nothing of a tremor farther ahead."""


def horizon(start: float) -> Any:
    """Declare a horizon [s].

    Args:
        start: its start value [s].
    """
    return real("s", "h T, how far ahead of the demand to be", start=start, min=0.0, max=LONGEST)


class Demand(State):
    """Demands that have been."""

    before = real("m", "demand one sample ago")
    earlier = real("m", "demand two samples ago")
    started = real(None, "samples of the demand seen, up to 2", min=0.0, max=2.0)


def ahead(stroke: Any, x: Demand, samples: Any) -> tuple[ca.SX, ca.SX]:
    """Return the demand a horizon later, y [m], and its rise there [m/sample].

    Args:
        stroke: demand of now [m].
        x: demands before it; those that there are not yet count as none.
        samples: h, horizon in samples.
    """
    first = ca.if_else(x.started >= 1, stroke - x.before, 0.0)
    second = ca.if_else(x.started >= 2, stroke - 2 * x.before + x.earlier, 0.0)
    wanted = stroke + samples * (first + (samples + 1) / 2 * second)
    return wanted, first + (samples + 0.5) * second


def seen(stroke: Any, x: Demand) -> Demand:
    """Return the demands after this one."""
    return Demand(before=stroke, earlier=x.before, started=ca.fmin(x.started + 1, 2.0))
