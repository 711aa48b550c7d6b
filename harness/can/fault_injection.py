"""A board that misbehaves on demand, the same way for the same seed.

A fault is written `KIND[:RATE][@START-END]`: `drop:0.01`, `silence@2-2.05`, `corrupt:0.5@1-1.2`.
RATE is the probability for each frame (1 if left out), START and END are in seconds of board time
(always, if left out).

| kind | frames |
| --- | --- |
| drop | are not sent |
| delay | are sent 1 to 5 samples later |
| duplicate | are sent twice |
| reorder | are sent after the next one |
| corrupt | have one bit changed |
| freeze | go on with the values of the first |
| stick | are the first one of their id again and again, counter and all; RATE is for the id |
| wrong-length | are a byte short or long |
| unavailable | have one value that says "not available" |
| unknown | are accompanied by one with an id that nobody knows |
| babble | are accompanied by `BABBLE` such |
| silence | are not sent, none of them |
| bus-off | neither: an error frame says that the controller is off the bus |
| unplug | neither: the board's end of the bus is gone until END |
"""

from __future__ import annotations

import math
import random
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fmu_src.errors import SteadytipError
from harness.common.errors import nearest

__all__ = ["KINDS", "FaultInjection", "InjectedFault", "parse"]

Frame = tuple[int, bytes, bool, bool]
"""Id, data, of CAN FD, with 29 bit of id."""

KINDS = (
    "drop",
    "delay",
    "duplicate",
    "reorder",
    "corrupt",
    "freeze",
    "stick",
    "wrong-length",
    "unavailable",
    "unknown",
    "babble",
    "silence",
    "bus-off",
    "unplug",
)
_SILENT = frozenset({"silence", "bus-off", "unplug"})
BABBLE = 5
"""Foreign frames for each of the board's own."""
_LONGEST_DELAY = 5  # samples
_TEXT = re.compile(
    r"(?P<kind>[a-z-]+)(:(?P<rate>[0-9.eE+-]+))?(@(?P<start>[0-9.]+)-(?P<end>[0-9.]+))?$"
)


@dataclass(frozen=True)
class InjectedFault:
    """One thing that goes wrong.

    Attributes:
        kind: one of `KINDS`.
        rate: probability for each frame.
        start, end: in board time [s].
    """

    kind: str
    rate: float = 1.0
    start: float = 0.0
    end: float = math.inf

    def covers(self, time: float) -> bool:
        """Return whether it may happen at a time [s]."""
        return self.start <= time < self.end

    def __str__(self) -> str:
        span = f"@{self.start:g}-{self.end:g}" if math.isfinite(self.end) else ""
        return f"{self.kind}:{self.rate:g}{span}"


def parse(text: str) -> InjectedFault:
    """Read a fault as it is written on the command line.

    Raises:
        SteadytipError: it is not one.

    >>> parse("drop:0.01@2-3")
    Fault(kind='drop', rate=0.01, start=2.0, end=3.0)
    """
    found = _TEXT.match(text)
    if found is None:
        raise SteadytipError(
            f"fault '{text}': write KIND[:RATE][@START-END], as in drop:0.01 or silence@2-2.5"
        )
    if found["kind"] not in KINDS:
        raise SteadytipError(f"fault '{text}': {nearest(found['kind'], KINDS)}")
    try:
        rate = float(found["rate"] or 1.0)
        start, end = float(found["start"] or 0.0), float(found["end"] or math.inf)
    except ValueError as error:
        raise SteadytipError(f"fault '{text}': {error}") from None
    if not 0.0 <= rate <= 1.0 or not start < end:
        raise SteadytipError(
            f"fault '{text}': RATE is a probability, 0 to 1, and START comes before END"
        )
    return InjectedFault(found["kind"], rate, start, end)


class FaultInjection:
    """Stands between a board and its bus."""

    def __init__(self, faults: Sequence[InjectedFault], seed: int, ids: Sequence[int]) -> None:
        """Plan.

        Args:
            faults: what is to go wrong.
            seed: of all chance in it.
            ids: that somebody knows.
        """
        self._faults = faults
        self._random = random.Random(seed)
        self._known = frozenset(ids)
        self._time = 0.0
        self._active: tuple[InjectedFault, ...] = ()
        self._started: set[InjectedFault] = set()
        self._delayed: list[tuple[int, Frame]] = []
        self._sample = 0
        self._reordered: Frame | None = None
        self._frozen: dict[str, float] = {}
        self._stuck: dict[int, bytes | None] = {}

    def begin(self, channel: Any, sample: int, time: float) -> None:
        """Begin a sample that is due.

        Args:
            channel: of the board.
            sample: its number.
            time: of the board [s].
        """
        self._sample, self._time = sample, time
        self._active = tuple(fault for fault in self._faults if fault.covers(time))
        kinds = {fault.kind for fault in self._active}
        if "freeze" not in kinds:
            self._frozen.clear()
        if "stick" not in kinds:
            self._stuck.clear()
        for fault in self._active:
            if fault not in self._started:
                self._started.add(fault)
                if fault.kind == "bus-off":
                    channel.declare_bus_off()
                elif fault.kind == "unplug":
                    channel.unplug(fault.end - time)
        due = [content for at, content in self._delayed if at <= sample]
        self._delayed = [(at, content) for at, content in self._delayed if at > sample]
        for content in due:
            channel.send(*content)

    def values(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Return the values of a sample, or what the faults make of them."""
        for fault in self._active:
            if fault.kind == "freeze":
                self._frozen = self._frozen or dict(values)
                values = self._frozen
            elif fault.kind == "unavailable" and self._random.random() < fault.rate:
                name = self._random.choice(sorted(values))
                values = {**values, name: math.nan}
        return values

    def __call__(self, channel: Any, id: int, data: bytes, is_fd: bool, extended: bool) -> None:
        """Send a frame, or what the active faults make of it."""
        reordered, self._reordered = self._reordered, None
        frames: list[Frame] = [(id, data, is_fd, extended)]
        for fault in self._active:
            if fault.kind in _SILENT:
                return
            if fault.kind == "stick":
                frames = self._sticky(fault.rate, frames)
            elif self._random.random() < fault.rate:
                frames = [changed for frame in frames for changed in self._apply(fault.kind, frame)]
        for frame in frames:
            channel.send(*frame)
        if reordered is not None:
            channel.send(*reordered)

    def _apply(self, kind: str, frame: Frame) -> list[Frame]:
        """Return what the faults make of a frame."""
        id, data, is_fd, extended = frame
        chance = self._random
        if kind == "drop":
            return []
        if kind == "delay":
            self._delayed.append((self._sample + chance.randint(1, _LONGEST_DELAY), frame))
            return []
        if kind == "duplicate":
            return [frame, frame]
        if kind == "reorder" and self._reordered is None:
            self._reordered = frame
            return []
        if kind == "corrupt":
            at = chance.randrange(8 * len(data))
            changed = bytearray(data)
            changed[at // 8] ^= 1 << at % 8
            return [(id, bytes(changed), is_fd, extended)]
        if kind == "wrong-length":
            length = max(0, len(data) + chance.choice((-1, 1)))
            most = 64 if is_fd else 8
            return [(id, (data + bytes(1))[: min(length, most) or 1], is_fd, extended)]
        if kind in {"unknown", "babble"}:
            count = BABBLE if kind == "babble" else 1
            return [frame, *(self._unknown_frame() for _ in range(count))]
        return [frame]

    def _sticky(self, rate: float, frames: list[Frame]) -> list[Frame]:
        """Frames of ids that stick are those that they were at first."""
        for id, data, _, _ in frames:
            if id not in self._stuck:
                self._stuck[id] = data if self._random.random() < rate else None
        return [(id, self._stuck[id] or data, fd, extended) for id, data, fd, extended in frames]

    def _unknown_frame(self) -> Frame:
        while True:
            id = self._random.randrange(1, 0x7FF)
            if id not in self._known:
                return id, self._random.randbytes(8), False, False
