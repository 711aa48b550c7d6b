"""Parts that a board at the other end of a bus takes the place of."""

from __future__ import annotations

from harness.common.patterns import matching
from harness.parts.settings import CanSettings
from harness.scenario.schema import PartTable, Scenario

__all__ = ["can_settings", "is_on_bus", "replaced_parts"]


def is_on_bus(table: PartTable) -> bool:
    """Return whether a part is at an end of a CAN bus."""
    return isinstance(table.settings, CanSettings)


def can_settings(table: PartTable) -> CanSettings:
    """Return the settings of a part on a CAN bus."""
    assert isinstance(table.settings, CanSettings)
    return table.settings


def replaced_parts(scenario: Scenario) -> frozenset[str]:
    """Parts that are at the other end of a bus: those that a part there `replaces`."""
    names = tuple(scenario.parts)
    return frozenset(
        name
        for table in scenario.parts.values()
        if isinstance(table.settings, CanSettings)
        for name in matching(names, table.settings.replaces)
    )
