"""Ports of parts, their units, and the columns that are recorded of them."""

from __future__ import annotations

from dataclasses import dataclass

from fmu_src.kit import units
from harness.common.types import PortType

__all__ = ["DIMENSIONLESS", "Column", "Port", "Unit", "unit_of"]


@dataclass(frozen=True)
class Unit:
    """A unit and what it is made of.

    Attributes:
        name: as the part writes it, `m/s2`.
        exponents: of kg, m, s, A, K, mol, cd, rad; None where the part does not say.
        factor: to the SI base unit.
        offset: to the SI base unit.
    """

    name: str
    exponents: tuple[int, ...] | None = None
    factor: float = 1.0
    offset: float = 0.0

    def same_as(self, other: Unit) -> bool:
        """Return whether values pass between both unchanged; by name if a base unit is missing."""
        if self.exponents is None or other.exponents is None:
            return self.name == other.name
        return (self.exponents, self.factor, self.offset) == (
            other.exponents,
            other.factor,
            other.offset,
        )


DIMENSIONLESS = Unit("1", (0,) * 8)


def unit_of(name: str) -> Unit:
    """Return a unit by its name, as the models write units.

    Raises:
        SteadytipError: the name does not parse.

    >>> unit_of("V").exponents
    (1, 2, -3, -1, 0, 0, 0, 0)
    """
    if name == DIMENSIONLESS.name:
        return DIMENSIONLESS
    found = units.base_exponents(name)
    powers = None if found is None else tuple(found.get(base, 0) for base in units.BASE)
    return Unit(name, powers, 1.0, units.OFFSETS.get(name, 0.0))


@dataclass(frozen=True)
class Port:
    """One scalar that a part takes or gives.

    Attributes:
        name: unique within the part.
        type: `Real`, `Integer` or `Boolean`; values travel as float64 whatever the type.
        unit: None where the part declares no units at all.
        description: one sentence.
        depends_on: inputs that an output depends on within one sample; None: perhaps on all.
    """

    name: str
    type: PortType = "Real"
    unit: Unit | None = DIMENSIONLESS
    description: str = ""
    depends_on: frozenset[str] | None = None

    @property
    def unit_name(self) -> str:
        """Unit for people: the name, `1` without dimension, empty for Boolean and Integer."""
        return self.unit.name if self.unit is not None and self.type == "Real" else ""


@dataclass(frozen=True)
class Column:
    """One recorded signal; see `harness.parts.ports.Port`."""

    name: str
    type: PortType
    unit: str
    description: str
