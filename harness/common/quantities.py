"""Display units: what people read in place of the SI units that everything is computed in."""

from __future__ import annotations

import math

__all__ = ["DISPLAY", "format_quantity"]

DISPLAY: dict[str, tuple[str, float]] = {
    "m": ("µm", 1e6),
    "rad": ("deg", math.degrees(1.0)),
    "1": ("", 1.0),
}
"""SI unit: unit that people read, and the factor to it."""


_SHORT = ((1e-3, "µs", 1e6), (1.0, "ms", 1e3))
"""Of times below a limit [s]: unit, and the factor to it."""


def format_quantity(value: float, unit: str) -> tuple[str, str]:
    """Return a value with four digits and its unit for people; short times in ms or µs.

    >>> shown(1.25e-05, "m")
    ('12.5', 'µm')
    >>> shown(0.000215, "s")
    ('215', 'µs')
    """
    name, factor = DISPLAY.get(unit, (unit, 1.0))
    if unit == "s" and value:
        name, factor = next(((n, f) for below, n, f in _SHORT if abs(value) < below), ("s", 1.0))
    return f"{value * factor:.4g}", name
