"""Kinds of parts by their key in a scenario."""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points

__all__ = ["kinds"]


_GROUP = "steadytip.parts"


_BUILT_IN = {
    "can": "harness.parts.can.kind:KIND",
    "fmu": "harness.parts.fmu:FmuPart",
    "recorded": "harness.parts.recorded:RecordedPart",
    "replay": "harness.parts.replay:ReplayPart",
}


@cache
def kinds() -> dict[str, EntryPoint]:
    """Known kinds of parts by their key in a scenario; built-in ones cannot be replaced."""
    found = {point.name: point for point in entry_points(group=_GROUP)}
    return found | {key: EntryPoint(key, value, _GROUP) for key, value in _BUILT_IN.items()}
