"""What all sessions beside a loop have in common: a clock of the ticks, and perhaps a ring."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

from harness.can.precise_sleep import sleep_until
from harness.hil.realtime import Conditions, realtime
from harness.loop.loop import LoopOutcome, RealTimeClock

if TYPE_CHECKING:
    import pyarrow as pa

    from harness.hil.ring import RingWriter

__all__ = ["Session", "TickClock", "WallClock"]


class TickClock:
    """Ticks that a subclass waits for; see `harness.loop.loop.RealTimeClock`.

    Attributes:
        name: part that is waited for; empty: the clock.
        watchdog: wall-clock time that the step of any part may take [s].
        conditions: of the loop's thread, from `begin` on.
        is_stopped: whether the user wants the run to end.
    """

    def __init__(
        self,
        thread: AbstractContextManager[Conditions | None],
        name: str = "",
        watchdog: float = math.inf,
    ) -> None:
        """Get ready.

        Args:
            thread: context in which the loop's thread runs; see `realtime`.
            name: part that is waited for.
            watchdog: see the attributes.
        """
        self.name = name
        self.watchdog = watchdog
        self.conditions: Conditions | None = None
        self.is_stopped = False
        self._thread = thread

    def begin(self, idle: Callable[[], None]) -> None:
        """Prepare for the first tick; see `RealTimeClock.begin`."""
        self._idle = idle
        self.conditions = self._thread.__enter__()

    def wait(self, tick: int) -> int:
        """Wait until a tick is to begin; see `RealTimeClock.wait`."""
        return 0 if self.is_stopped else self._wait(tick)

    def _wait(self, tick: int) -> int:
        raise NotImplementedError

    def stop(self) -> None:
        """End the run and any waiting; see `RealTimeClock.stop`."""
        self.is_stopped = True

    def end(self) -> None:
        """Make the loop's thread an ordinary one again."""
        self._thread.__exit__(None, None, None)


class WallClock(TickClock):
    """Ticks by this machine's clock, for a loop without a bus."""

    def __init__(self, step: float, watchdog: float, priority: int) -> None:
        """Get ready; see `TickClock` and `realtime`."""
        super().__init__(realtime(priority), watchdog=watchdog)
        self._step = step

    def begin(self, idle: Callable[[], None]) -> None:
        """Take the time of the first tick."""
        super().begin(idle)
        self._start = time.monotonic_ns()

    def _wait(self, tick: int) -> int:
        self._idle()
        sleep_until(self._start + round(tick * self._step * 1e9))
        return 0 if self.is_stopped else 1


class Session:
    """A clock, and perhaps a ring that shows each tick; see `harness.running.HilSession`."""

    def __init__(self, clock: RealTimeClock, ring: RingWriter | None = None) -> None:
        """Take clock and ring over."""
        self.clock = clock
        self.observe = ring.append if ring is not None else None
        self._ring = ring

    def closed(self, outcome: LoopOutcome) -> dict[str, Any]:
        """Close the ring; see `HilSession.closed`."""
        if self._ring is not None:
            self._ring.close()
        return {}

    def extra_columns(self) -> tuple[pa.Table | None, dict[str, Any]]:
        """Add no columns; see `HilSession.extra_columns`."""
        return None, {}
