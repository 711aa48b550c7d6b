"""Parts that a board at the other end of a bus takes the place of."""

from __future__ import annotations

from harness.common.patterns import matching
from harness.scenario.schema import Scenario

__all__ = ["replaced_parts"]


def replaced_parts(scenario: Scenario) -> frozenset[str]:
    """Parts that are at the other end of a bus: those that a part there `replaces`."""
    names = tuple(scenario.parts)
    return frozenset(
        name
        for table in scenario.parts.values()
        if table.kind == "can"
        for name in matching(names, table.settings.get("replaces", ()))
    )
