"""Columns that play the roles of a scenario."""

from __future__ import annotations

from collections.abc import Sequence

from harness.common.endpoint import Endpoint
from harness.common.errors import ProblemsError, nearest
from harness.common.patterns import matching
from harness.scenario.replaced import replaced_parts
from harness.scenario.schema import Scenario

__all__ = ["roles"]


_COUNTS = {
    "tip_uncompensated": 3,
    "tip": 3,
    "intent": 3,
    "attitude_true": 4,
    "attitude_estimated": 4,
    "position_true": 3,
    "position_estimated": 3,
    "saturated": 1,
}


def roles(scenario: Scenario, columns: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Find the columns that play each role of the scenario's `signals`.

    A role is left out where the parts that would play it are at the other end of a bus.

    Raises:
        ProblemsError: no column fits, or too many or too few do.
    """
    found: dict[str, tuple[str, ...]] = {}
    gone = tuple(replaced_parts(scenario))
    problems: list[str] = []
    for role, patterns in scenario.signals:
        if patterns is None:
            continue
        names = matching(columns, patterns)
        wanted = _COUNTS.get(role)
        texts = [patterns] if isinstance(patterns, str) else patterns
        heads = [Endpoint.parse(text).part for text in texts]
        if not names and matching(tuple(gone), heads):
            continue
        if not names:
            problems.append(
                f"signals.{role} = {patterns!r}: no output fits; {nearest(str(patterns), columns)}"
            )
        elif wanted is not None and len(names) != wanted:
            problems.append(
                f"signals.{role} = {patterns!r} has to name {wanted} outputs, "
                f"it names {len(names)}: {', '.join(names)}"
            )
        else:
            found[role] = names
    if problems:
        raise ProblemsError(scenario.name, problems)
    return found
