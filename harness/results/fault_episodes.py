"""What went wrong in a run on the wall clock, and what the loop did about it.

A trouble is a stretch of ticks in which the sample was not to be used or the command did not follow
the controller, with the events around it; an event that did neither is one for itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from harness.can.database import RUN
from harness.results.can_feed import feed_of

if TYPE_CHECKING:
    from harness.common.types import FloatArray
    from harness.results.result import Result

__all__ = ["Trouble", "mode_of", "troubles"]

_APART = 5
"""Ticks of calm between two troubles; with fewer they are one (chosen)."""


@dataclass(frozen=True)
class Trouble:
    """One thing that went wrong.

    Attributes:
        tick: of the first sign.
        time: of that in the run [s].
        kinds: of the events, each once, in their order.
        texts: of the events, each once, in their order; empty where nothing was told.
        age: of the sample, at the most [s].
        answer: from the first event to the command that did not follow the controller any more [s];
            None where it always did.
        held: how long the command did not follow the controller [s].
        invalid: how long the sample was not to be used [s].
    """

    tick: int
    time: float
    kinds: tuple[str, ...]
    texts: tuple[str, ...]
    age: float
    answer: float | None
    held: float
    invalid: float


def mode_of(result: Result, feed: str) -> FloatArray | None:
    """(n,) mode of the command; None where nothing is commanded."""
    name = f"{feed}.command.mode"
    return result.signals(name) if name in result.table.column_names else None


def troubles(result: Result) -> list[Trouble]:
    """Everything that went wrong, in its order; nothing without a part on a bus."""
    feed, metadata = feed_of(result), result.metadata.hil or {}
    if feed is None or "events" not in metadata:
        return []
    invalid = result.signals(f"{feed}.valid") == 0.0
    mode = mode_of(result, feed)
    held = np.zeros(len(invalid), bool) if mode is None else mode != RUN
    age = result.signals(f"{feed}.age")
    ticks = np.clip(np.array(metadata["event_ticks"], int), 0, len(invalid) - 1)
    # A tick that ends a stretch tells so: "valid again".
    marked = np.unique([*np.flatnonzero(invalid | held), *ticks]).astype(int)
    groups = np.split(marked, np.flatnonzero(np.diff(marked) > _APART) + 1)
    step = result.metadata.step_size
    found = []
    for group in groups if len(marked) else []:
        first, last = int(group[0]), int(group[-1])
        span = slice(first, last + 1)
        inside = [i for i, tick in enumerate(ticks) if first <= tick <= last]
        events = [metadata["events"][i] for i in inside]
        since = int(ticks[inside[0]]) if inside else first
        away = first + np.flatnonzero(held[span])
        found.append(
            Trouble(
                tick=first,
                time=first * step,
                kinds=tuple(dict.fromkeys(kind for _, kind, _ in events)),
                texts=tuple(dict.fromkeys(text for _, _, text in events)),
                age=float(age[span].max()),
                answer=max(0, int(away[0]) - since) * step if len(away) else None,
                held=int(held[span].sum()) * step,
                invalid=int(invalid[span].sum()) * step,
            )
        )
    return found
