"""Units as FMI 2.0 writes them: `m/s2`, `rad/s`, `V`, products with a dot, powers as digits.

A unit is a name; its seven base exponents (and `rad`) follow from parsing the name, so that no
table of compound units has to be kept. Ports carry SI only, so every factor is 1; temperatures are
in degC, the one unit with an offset, and what goes with a temperature is per K.
"""

import re
from collections import Counter
from collections.abc import Mapping
from functools import cache

from fmu_src.errors import SteadytipError

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_DERIVED: Mapping[str, Mapping[str, int]] = {
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "T": {"kg": 1, "s": -2, "A": -1},
    "degC": {"K": 1},
}
OFFSETS: Mapping[str, float] = {"degC": 273.15}
"""Number added to a value to have it in base units."""
_FACTOR = re.compile(r"(?P<symbol>[A-Za-z]+)(?P<power>\d+(\.\d+)?)?$")


@cache
def exponents(unit: str) -> dict[str, float]:
    """Exponents of the SI base units, without zeros, whole or not.

    Raises:
        SteadytipError: the name does not parse, or holds an unknown symbol.

    >>> exponents("m/s2/Hz0.5")
    {'m': 1.0, 's': -1.5}
    """
    total: Counter[str] = Counter()
    for sign, part in _signed_factors(unit):
        found = _FACTOR.match(part)
        symbol = found["symbol"] if found else part
        if found is None or (symbol not in BASE and symbol not in _DERIVED):
            known = ", ".join((*BASE, *_DERIVED))
            raise SteadytipError(
                f"unit '{unit}': '{part}' is not one of {known}, with or without a power"
            )
        power = float(found["power"] or 1)
        for base, exponent in _DERIVED.get(symbol, {symbol: 1}).items():
            total[base] += sign * power * exponent  # type: ignore[assignment]
    return {base: float(total[base]) for base in BASE if total[base]}


@cache
def base_exponents(unit: str) -> dict[str, int] | None:
    """Exponents of the SI base units, without zeros; None where one is not a whole number.

    FMI 2.0 has integer exponents only, so `V/Hz0.5` is a legal unit without a base unit.

    Raises:
        SteadytipError: the name does not parse, or holds an unknown symbol.

    >>> base_exponents("m/s2")
    {'m': 1, 's': -2}
    """
    found = exponents(unit)
    if any(power != int(power) for power in found.values()):
        return None
    return {base: int(power) for base, power in found.items()}


def _signed_factors(unit: str) -> list[tuple[int, str]]:
    # A dot between digits belongs to a power (Hz0.5); any other dot multiplies.
    parts = re.split(r"(/|(?<!\d)\.|\.(?!\d))", unit)
    signs = {"/": -1, ".": 1}
    factors = [(1, parts[0])]
    factors += [(signs[mark], part) for mark, part in zip(parts[1::2], parts[2::2], strict=True)]
    return [(sign, part) for sign, part in factors if part != "1"]
