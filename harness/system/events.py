"""Turn the changes and faults of a scenario into events between ticks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from harness.common.endpoint import Endpoint
from harness.parts.protocols import Adjustable, Part, Reusable
from harness.scenario.events import Change

__all__ = ["Event", "events_of", "trouble_of"]


@dataclass(frozen=True)
class Event:
    """Values of one part that change before a tick.

    Attributes:
        tick: which one.
        part: its name.
        values: by the part's own names.
    """

    tick: int
    part: str
    values: Mapping[str, Any]


def events_of(
    changes: Sequence[Change],
    parts: Mapping[str, Part],
    unconnected: Sequence[str],
    step: float,
    problems: list[str],
) -> tuple[Event, ...]:
    """Turn changes into events, in their order in time.

    Args:
        changes: in any order.
        parts: by name.
        unconnected: `part.port` of the inputs that no wire drives.
        step: period of the loop [s].
        problems: what is wrong is appended here.
    """
    found: list[Event] = []
    for change in sorted(changes, key=lambda each: each.at):
        tick = max(1, math.ceil(change.at / step - 1e-6))
        for name, value in change.set.items():
            place = Endpoint.find(name, parts)
            if place is None:
                problems.append(f"change of '{name}': write part.variable; {', '.join(parts)}")
                continue
            trouble = trouble_of(parts[place.part], place.port, value, unconnected)
            if trouble:
                problems.append(f"change of '{name}' at {change.at:g} s: {trouble}")
            else:
                found.append(Event(tick, place.part, {place.port: value}))
    if found:
        problems += [
            f"part '{name}' cannot stop in the middle of a run, which changes and faults need"
            for name, part in parts.items()
            if not (isinstance(part, Reusable) and part.can_pause())
        ]
    return tuple(found)


def trouble_of(part: Part, name: str, value: Any, unconnected: Sequence[str]) -> str:
    """Return why a value of a part cannot change in a run; empty if it can."""
    if not isinstance(part, Adjustable):
        return f"nothing of '{part.name}' can change in a run: it is no FMU"
    if any(port.name == name for port in part.inputs) and f"{part.name}.{name}" not in unconnected:
        return f"'{name}' is driven by a wire"
    return part.trouble_with(name, value)
