"""Display units: what people read in place of the SI units that everything is computed in."""

from __future__ import annotations

import math

__all__ = ["DISPLAY", "shown"]

DISPLAY: dict[str, tuple[str, float]] = {
    "m": ("µm", 1e6),
    "rad": ("deg", math.degrees(1.0)),
    "1": ("", 1.0),
}
"""SI unit: unit that people read, and the factor to it."""


def shown(value: float, unit: str) -> tuple[str, str]:
    """A value with four digits, and its unit, for people.

    >>> shown(1.25e-05, "m")
    ('12.5', 'µm')
    """
    name, factor = DISPLAY.get(unit, (unit, 1.0))
    return f"{value * factor:.4g}", name
