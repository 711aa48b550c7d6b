"""Units as people write them into headings, and their factors to SI.

Known by heart are the units of the quantities that recordings hold; whatever else somebody writes
is looked up in Pint's registry, whose import takes a second.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING

from fmu_src.device.design import STANDARD_GRAVITY

if TYPE_CHECKING:
    import pint

__all__ = [
    "ANGLES",
    "KNOWN_UNITS",
    "LENGTHS",
    "QUANTITIES",
    "TEMPERATURES",
    "TIMES",
    "VOLTAGES",
    "factor_to_si",
    "plain_unit",
]

LENGTHS: Mapping[str, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
VOLTAGES: Mapping[str, float] = {"V": 1.0, "mV": 1e-3, "kV": 1e3}
TIMES: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLES: Mapping[str, float] = {"rad": 1.0, "deg": math.pi / 180}
TEMPERATURES: Mapping[str, float] = {"degC": 1.0}
_ACCELERATIONS = {"m/s2": 1.0, "mg": 1e-3 * STANDARD_GRAVITY, "g": STANDARD_GRAVITY}
_RATES = {"rad/s": 1.0, "deg/s": math.pi / 180}
_FIELDS = {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9, "gauss": 1e-4, "G": 1e-4}
QUANTITIES: Mapping[str, Mapping[str, float]] = {
    "m": LENGTHS,
    "V": VOLTAGES,
    "s": TIMES,
    "rad": ANGLES,
    "degC": TEMPERATURES,
    "m/s2": _ACCELERATIONS,
    "rad/s": _RATES,
    "T": _FIELDS,
}
"""For each SI unit, the known units by name and their factors to it."""

KNOWN_UNITS = frozenset(unit for units in QUANTITIES.values() for unit in units)
"""All units that are known by heart."""

_SPELLINGS = {
    **{"volt": "V", "volts": "V", "v": "V", "mv": "mV", "kv": "kV"},
    **{"degree": "deg", "degrees": "deg", "°": "deg", "radian": "rad", "radians": "rad"},
    **{"°c": "degC", "celsius": "degC", "degc": "degC", "dps": "deg/s", "°/s": "deg/s"},
    **{"m/s^2": "m/s2", "m/s²": "m/s2", "ut": "uT", "nt": "nT"},
    **{"sec": "s", "seconds": "s", "micron": "um", "microns": "um", "metre": "m", "meter": "m"},
}


def plain_unit(unit: str) -> str:
    """Return the name of a unit that is known by heart, for one of its spellings.

    >>> plain_unit("µm"), plain_unit("m/s²"), plain_unit("furlong")
    ('um', 'm/s2', 'furlong')
    """
    plain = unit.replace("µ", "u").replace("μ", "u").strip()
    return _SPELLINGS.get(plain.lower(), plain)


def factor_to_si(unit: str, units: Mapping[str, float]) -> float | None:
    """Return the factor of a unit to SI; None if it is no unit of the quantity.

    Args:
        unit: as `plain_unit` returns it.
        units: those of the quantity that are known by heart, from `QUANTITIES`.

    >>> factor_to_si("inch", LENGTHS), factor_to_si("kg", LENGTHS)
    (0.0254, None)
    """
    if unit in units:
        return units[unit]
    base = next(name for name, factor in units.items() if factor == 1.0)
    import pint

    try:
        found = _registry().Quantity(1.0, unit).to(base.replace("s2", "s**2"))
    except (pint.PintError, ValueError, AssertionError, TypeError):
        return None
    return float(found.magnitude)


@cache
def _registry() -> pint.UnitRegistry[float]:
    import pint

    return pint.UnitRegistry()
