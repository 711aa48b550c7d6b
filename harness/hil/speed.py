"""Figures of speed on the wall clock: loop and board on each transport, codec, pacing.

They are of the machine as it is at the time, which others may use as well: the share of processor
time that its owner took stands in the setting of each. Nothing is judged here.
"""

from __future__ import annotations

import time
import timeit
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from fmu_src.errors import SteadytipError
from harness.can.codec import Codec
from harness.can.database import Database, Message, load
from harness.can.precise_sleep import sleep_until
from harness.common.figures import Figure
from harness.hil.realtime import realtime
from harness.hil.session import hil
from harness.scenario.schema import Hil

__all__ = ["LINKS", "BusLink", "codec_figures", "loop_figures", "pacing_figures"]

SCENARIO = "closed_loop_can"
DBCS = ("instrument", "instrument_fd")
PRIORITIES = (Hil().priority, 0)
"""Of the loop's thread: that of a scenario which says nothing of it, and an ordinary one."""
_SOURCE = "steadytip bench hil"
_MICRO = 1e6
_METRICS = {
    "latency_p50": ("latency, median", "us", _MICRO),
    "latency_p99": ("latency, 99 %", "us", _MICRO),
    "wake_up_p50": ("wake-up, median", "us", _MICRO),
    "wake_up_p99": ("wake-up, 99 %", "us", _MICRO),
    "lost_samples": ("lost samples", "", 1),
    "overruns": ("overruns", "", 1),
}
"""Figures of a run: words, unit, and the factor to it."""
_CALLS, _REPEATS = 2000, 5
_PACED = 1e-3  # s


@dataclass(frozen=True)
class BusLink:
    """What stands between loop and board.

    Attributes:
        interface: of python-can.
        board: which emulated board is at the other end.
    """

    interface: str
    board: str

    def __str__(self) -> str:
        return f"{self.interface}, {self.board} board"


LINKS = (BusLink("unixbus", "python"), BusLink("slcanbulk", "python"), BusLink("slcanbulk", "c"))
"""All that an emulated board speaks."""


def loop_figures(
    link: BusLink, priority: int, seconds: float, status: Callable[[str], None] = lambda _: None
) -> list[Figure]:
    """Latency and wake-up of the closed loop on the wall clock.

    Args:
        link: between loop and board.
        priority: of the loop's thread; 0: an ordinary one.
        seconds: length of the run [s].
        status: told in a few words what is being done.

    Raises:
        SteadytipError: there is no such link here, or the run ended early.
    """
    overrides: dict[str, Any] = {
        "seconds": seconds,
        "warm_up": 0.0,
        "hil.priority": priority,
        "hil.board": link.board,
        "part.sensors.interface": link.interface,
    }
    with TemporaryDirectory(prefix="steadytip-bench-", ignore_cleanup_errors=True) as folder:
        result = hil(SCENARIO, overrides=overrides, out=Path(folder), report=False, status=status)
        metrics, conditions = result.metrics, (result.metadata.hil or {})["conditions"]
    if not _METRICS.keys() <= metrics.keys():
        raise SteadytipError(f"{link}: no sample of {seconds:g} s came in time to be measured")
    setting = f"{SCENARIO}, {link}, {seconds:g} s, {_words(conditions)}"
    return [
        Figure(_SOURCE, words, unit, None, factor * metrics[name].value, setting)
        for name, (words, unit, factor) in _METRICS.items()
    ]


def pacing_figures(priority: int, seconds: float) -> list[Figure]:
    """Measure how late a loop at 1 kHz comes back from waiting for an instant.

    Args:
        priority: of the thread; 0: an ordinary one.
        seconds: how long it is done [s].
    """
    count = round(seconds / _PACED)
    late = np.empty(count)
    with realtime(priority) as conditions:
        begun = time.monotonic_ns() + round(_PACED * 1e9)
        for tick in range(count):
            instant = begun + round(tick * _PACED * 1e9)
            sleep_until(instant)
            late[tick] = time.monotonic_ns() - instant
    setting = f"1 kHz, {seconds:g} s, {_words(conditions.metadata())}"
    return [
        Figure(_SOURCE, f"pacing, late by, {words}", "us", None, value, setting)
        for words, value in (
            ("median", float(np.median(late)) * 1e-3),
            ("99 %", float(np.percentile(late, 99.0)) * 1e-3),
        )
    ]


def codec_figures(dbc: str) -> Iterator[Figure]:
    """Time to check and decode, and to encode, each message of a DBC file."""
    database = load(dbc)
    for message in database.messages:
        yield from _codec(database, message)


def _codec(database: Database, message: Message) -> Iterator[Figure]:
    codec = Codec(message)
    values = [sum(signal.range) / 2 for signal in message.signals]
    frame = codec.encode(values, 1)
    is_intact, counter = codec.is_intact, codec.counter
    decode, encode = codec.decode, codec.encode

    def receive() -> None:
        is_intact(frame)
        counter(frame)
        decode(frame)

    def send() -> None:
        encode(values, 1)

    setting = f"{database.path.name}, E2E profile {message.profile}"
    for what, action in (("decode", receive), ("encode", send)):
        best = min(timeit.repeat(action, number=_CALLS, repeat=_REPEATS)) / _CALLS
        yield Figure(_SOURCE, f"{what} {message.name}", "us", None, _MICRO * best, setting)


def _words(conditions: dict[str, Any]) -> str:
    """Describe how a thread was scheduled, and what the machine took meanwhile."""
    thread = f"SCHED_FIFO {conditions['priority']}" if conditions["priority"] else "ordinary thread"
    reason = f" ({conditions['reason']})" if conditions["reason"] else ""
    stolen = conditions["stolen"]
    share = "not told" if stolen is None else f"{100 * stolen:.2g} %"
    return f"{thread}{reason}, stolen CPU {share}"
