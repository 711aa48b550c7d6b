"""A thread that keeps to the wall clock, and the settings of Python and kernel that it needs.

| what hurts | what is done |
| --- | --- |
| the garbage collector | run once, then off until the end; what is there is frozen |
| other threads of the process | they may hold the interpreter for 50 us instead of 5 ms |
| other processes | SCHED_FIFO, where the system allows it |
| the processor's owner | nothing; the share of time that was stolen is reported |

All threads of the process get SCHED_FIFO, the loop's own the highest: one that is put aside while
it holds the interpreter would hold up the loop.
"""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

__all__ = ["Conditions", "cpu_times", "realtime"]

_SWITCH = 50e-6
_STAT, _TASKS = Path("/proc/stat"), Path("/proc/self/task")


@dataclass
class Conditions:
    """What a thread got of what it asked for, and what the machine took.

    Attributes:
        priority: of SCHED_FIFO; 0: an ordinary thread.
        reason: why it is an ordinary one; empty if it was not to be another.
        stolen: share of the machine's processor time that its owner took meanwhile; None where the
            system does not tell.
    """

    priority: int = 0
    reason: str = ""
    stolen: float | None = None

    def metadata(self) -> dict[str, Any]:
        """For the record; JSON types only."""
        return asdict(self)


def cpu_times() -> tuple[int, int] | None:
    """Stolen and all processor time so far, in ticks; None where the system does not tell."""
    try:
        fields = _STAT.read_text().split("\n", 1)[0].split()[1:]
        values = [int(field) for field in fields[:8]]
    except (OSError, ValueError):
        return None
    return values[7], sum(values)


def _threads() -> list[int]:
    """Return the threads of this process, by the kernel's numbers."""
    return [int(entry.name) for entry in _TASKS.iterdir()]


@contextmanager
def realtime(priority: int) -> Iterator[Conditions]:
    """Make the calling thread one for the wall clock, and an ordinary one again afterwards.

    Args:
        priority: of SCHED_FIFO, 1 to 99; 0: leave the scheduler alone.
    """
    conditions = Conditions()
    before, interval = cpu_times(), sys.getswitchinterval()
    was: dict[int, tuple[int, Any]] = {}
    if priority:
        try:
            for thread in _threads():
                was[thread] = os.sched_getscheduler(thread), os.sched_getparam(thread)
                own = thread == threading.get_native_id()
                param = os.sched_param(priority if own else max(1, priority - 1))
                os.sched_setscheduler(thread, os.SCHED_FIFO, param)
            conditions.priority = priority
        except (OSError, AttributeError) as error:
            conditions.reason = getattr(error, "strerror", None) or "this system has no SCHED_FIFO"
    collected = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(_SWITCH)
    try:
        yield conditions
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if collected:
            gc.enable()
        for thread, scheduling in was.items():
            with contextlib.suppress(OSError):
                os.sched_setscheduler(thread, *scheduling)
        after = cpu_times()
        if before and after and after[1] > before[1]:
            conditions.stolen = (after[0] - before[0]) / (after[1] - before[1])
