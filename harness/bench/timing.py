"""The timer that pytest-benchmark measures with: it stands still where something is not to count.

A benchmark of a loop in another process, or of one that has to be set up each time, knows itself
how long what counts has taken.
"""

from __future__ import annotations

import time
from collections.abc import Callable

__all__ = ["counting", "now"]

_held = 0.0


def now() -> float:
    """Time that counts [s], from some instant on."""
    return time.perf_counter() - _held


def counting(action: Callable[[], float]) -> Callable[[], None]:
    """Return an action of which only the time that it returns [s] counts."""

    def act() -> None:
        global _held
        begun = time.perf_counter()
        counts = action()
        _held += time.perf_counter() - begun - counts

    return act
