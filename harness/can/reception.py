"""State of reception: frames checked, samples put together, ages and faults kept. No I/O, no clock.

All times are integer microseconds of one clock, and all that happens follows from the calls with
their times, so that a log of them gives the same again.

| fault | what it is | what happens |
| --- | --- | --- |
| lost | counter jumps by 2 or 3 | the last value is held |
| sequence | counter jumps further | invalid until two good frames follow |
| repeated | same counter again | frame dropped |
| crc | CRC wrong, or of another id | frame dropped, counter kept |
| timeouts | nothing within the timeout | invalid |
| range | not available, or out of range | value held; invalid with three in a row |
| incomplete | a part of a sample missing | sample dropped |
| length | wrong length, remote or error frame with an id of ours | frame dropped |
| unknown | id that is not in the file | nothing; above a rate it is babbling |
| heartbeat | none within its timeout, or a state that is not operational | invalid |
| late | a sample that came after its tick | taken, with its age, at the next tick |

A sample is complete when its frames with one counter are there; frames of different counters never
meet. Its number continues the one before as the counter does. After a gap the counter leaves open
whether samples are missing or late; where it and the clock do not tell the same number, samples are
dropped until the board's own sample counter comes by.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from harness.can.clock import BoardClock
from harness.can.codec import Codec
from harness.can.database import OPERATIONAL, Database, Message, frame_time
from harness.can.protection import USABLE, CheckStatus, Counter

__all__ = ["FAULTS", "Reception", "ReceptionEvent", "Sample"]

FAULTS = (
    "lost",
    "repeated",
    "sequence",
    "crc",
    "timeouts",
    "range",
    "incomplete",
    "length",
    "unknown",
    "heartbeat",
    "bus_off",
    "unplugged",
    "late",
    "overruns",
)
"""Counted since the start, in the order of a part's ports."""
PER_MESSAGE = ("received", "lost", "repeated", "sequence", "crc", "timeouts", "range", "length")
"""Counted for each message."""

_IN_A_ROW = 3
"""Bad values of a signal that make a fault."""
_FAR = 128  # samples back: further is a board that counts anew, less is a late frame
_WINDOW = 100_000  # us over which rates are taken
_BABBLE = 500.0  # unknown frames a second that are babbling (chosen: half of a message of 1 kHz)


@dataclass(frozen=True)
class ReceptionEvent:
    """A fault begins.

    Attributes:
        time: [us].
        kind: one of `FAULTS`, or `babbling`.
        text: in words.
    """

    time: int
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class Sample:
    """One complete sample.

    Attributes:
        number: samples since the board began.
        time: of its last frame [us].
        values: of all its messages, one after the other.
        restarted: the board has begun to count anew with it.
    """

    number: int
    time: int
    values: tuple[float, ...]
    restarted: bool = False


class ReceivedMessage:
    """One message that others send."""

    def __init__(self, message: Message, codec: Codec, time: float) -> None:
        self.message = message
        self.length = message.length
        self.seconds = time
        self.modulus = message.modulus
        self.decode = codec.decode
        self.is_intact = codec.is_intact
        self.counter_of = codec.counter
        self.counter = Counter(self.modulus) if self.modulus else None
        self.timeout = message.timeout * 1e6
        self.last: int | None = None
        """Time of the last intact frame that was new [us]."""
        self.silent = False
        self.values: tuple[float, ...] = ()
        self.bad_runs = [0] * len(message.signals)
        """Bad values in a row."""
        self.counts = dict.fromkeys(PER_MESSAGE, 0)
        self.part = -1
        """Place in the sample; -1: in none."""

    @property
    def in_sequence(self) -> bool:
        return self.counter is None or self.counter.in_sequence


@dataclass(slots=True)
class _Slot:
    """A sample that is being put together."""

    begun: int
    left: int
    parts: list[tuple[float, ...] | None]


class Reception:
    """State of what one node receives.

    Attributes:
        messages: of all other nodes, by id, bit 31 set for an extended one.
        other_messages: those among them that are no part of a sample.
        ready: complete samples that nobody has taken yet.
        clock: the board's.
        counts: of each fault.
        events: what happened, oldest first; the caller takes them away.
        load: share of the bus that frames took, over the last whole window.
    """

    def __init__(self, database: Database, node: str, period: float) -> None:
        """Get ready for the messages of all other nodes.

        Args:
            database: of the bus.
            node: this one.
            period: of the samples [us].
        """
        self._database = database
        self._period = period
        self.messages = {
            m.id: ReceivedMessage(m, Codec(m), database.seconds(m))
            for m in database.received_by(node)
        }
        self._parts = [h for h in self.messages.values() if h.message.role == "sample"]
        self.other_messages = [m for m in self.messages.values() if m.message.role != "sample"]
        for index, part in enumerate(self._parts):
            part.part = index
        self._slots: dict[int, _Slot] = {}
        self._stale = (self._parts[0].modulus // 2 if self._parts else 7) * period
        self._numbered = self.signals.index("sample") if "sample" in self.signals else None
        """Place of the sample's own number among its values."""
        self._gap = True
        """Whether the counter alone does not tell the next sample's number."""
        self._number: int | None = None
        """Of the last complete sample, or the one before what the board first stated."""
        self._stated: tuple[int, int] | None = None
        """What the board last stated of its counter, and when."""
        self._restarted = False
        self.ready: deque[Sample] = deque()
        self.clock = BoardClock(period)
        self.counts = dict.fromkeys(FAULTS, 0)
        self.events: list[ReceptionEvent] = []
        self.load = 0.0
        self.peak_load = 0.0
        self._window: int | None = None
        self._busy = 0.0
        self._foreign = 0
        self._babbling = False
        self._lengths: dict[tuple[int, bool], float] = {}

    @property
    def timeout(self) -> float:
        """Age beyond which a sample is not to be used [us]."""
        return min((part.timeout for part in self._parts), default=float("inf"))

    @property
    def has_samples(self) -> bool:
        """True if anybody sends samples."""
        return bool(self._parts)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of a sample's values, in their order."""
        return tuple(s.name for part in self._parts for s in part.message.signals)

    def take(
        self, time: int, id: int, data: bytes, odd: bool = False, is_fd: bool = False
    ) -> ReceivedMessage | None:
        """Take a frame that came in.

        Args:
            time: [us].
            id: arbitration id, bit 31 set for an extended one.
            data: its bytes.
            odd: a remote or an error frame.
            is_fd: of CAN FD.

        Returns:
            The message that the frame has brought; None if the frame was dropped.
        """
        received = self.messages.get(id)
        if received is None:
            self.counts["unknown"] += 1
            self._foreign += 1
            self._busy += self._time_of(len(data), is_fd)
            return None
        self._busy += received.seconds
        if odd or len(data) != received.length or is_fd != received.message.is_fd:
            self._count(received, "length")
            return None
        if not received.is_intact(data):
            self._count(received, "crc")
            return None
        counter = received.counter
        if counter is not None:
            status = counter.take(received.counter_of(data))
            if status is not CheckStatus.REPEATED:
                received.last = time
                received.silent = False
            if status is not CheckStatus.OK and not self._usable(received, status, time):
                return None
        values, bad = received.decode(data)
        received.counts["received"] += 1
        if bad:
            values = self._held(received, values, bad, time)
        elif any(received.bad_runs):
            received.bad_runs = [0] * len(received.bad_runs)
        received.last = time
        received.silent = False
        received.values = values
        if received.part >= 0:
            self._put(received, received.counter_of(data), time)
        elif received.message.role == "status":
            self._take_status(received, time)
        return received

    def receive(self, frame: Any) -> None:
        """Take a message of python-can, its time in [us]."""
        id = frame.arbitration_id | frame.is_extended_id << 31
        odd = frame.is_remote_frame or frame.is_error_frame
        self.take(frame.timestamp, id, bytes(frame.data), odd, frame.is_fd)

    def _count(self, received: ReceivedMessage, fault: str, count: int = 1) -> None:
        """Count a fault of a message."""
        received.counts[fault] += count
        self.counts[fault] += count

    def tick(self, time: int) -> None:
        """Find messages that have been silent for too long, and measure the load of the bus."""
        for received in self.messages.values():
            if received.silent or received.last is None or time - received.last <= received.timeout:
                continue
            received.silent = True
            received.counts["timeouts"] += 1
            name = received.message.name
            kind = "heartbeat" if received.message.role == "heartbeat" else "timeouts"
            self.counts[kind] += 1
            text = f"no {name} for {(time - received.last) / 1e3:.1f} ms"
            self.events.append(
                ReceptionEvent(time, kind, f"{text}, more than {received.timeout / 1e3:g} ms")
            )
            if received.counter is not None:
                received.counter.silence()
                self._gap = self._gap or received.part >= 0
        if self._window is None:
            self._window = time
        elif time - self._window >= _WINDOW:
            self._measure(time)

    @property
    def fault(self) -> str:
        """Reason why values are not to be used, one of `FAULTS`; empty if they are."""
        for received in self.messages.values():
            if received.message.role == "heartbeat":
                if received.silent or (received.values and received.values[0] != OPERATIONAL):
                    return "heartbeat"
            elif received.part >= 0 or received.message.role == "command":
                if received.silent:
                    return "timeouts"
                if not received.in_sequence:
                    return "sequence"
                if received.bad_runs and max(received.bad_runs) >= _IN_A_ROW:
                    return "range"
        return ""

    def restart(self) -> None:
        """Drop incomplete samples and restart the counters: the channel was lost."""
        self._slots.clear()
        self.ready.clear()
        self._gap = True
        for received in self.messages.values():
            if received.counter is not None:
                received.counter.silence()

    def _usable(self, received: ReceivedMessage, status: CheckStatus, time: int) -> bool:
        """Count what the counter says, and return whether the frame is to be used all the same."""
        name = {
            CheckStatus.OK_SOME_LOST: "lost",
            CheckStatus.REPEATED: "repeated",
            CheckStatus.WRONG_SEQUENCE: "sequence",
        }.get(status)
        if name is not None:
            count = received.counter.lost if status is CheckStatus.OK_SOME_LOST else 1  # type: ignore
            self._count(received, name, count)
        if status is CheckStatus.WRONG_SEQUENCE:
            self._gap = self._gap or received.part >= 0
            text = f"the counter of {received.message.name} jumped"
            self.events.append(ReceptionEvent(time, "sequence", text))
        # What the board states of its count is right whatever was before.
        return status in USABLE or (
            received.message.role == "status" and status is not CheckStatus.REPEATED
        )

    def _held(
        self, received: ReceivedMessage, values: tuple[float, ...], bad: int, time: int
    ) -> tuple[float, ...]:
        """Values with those that are bad replaced by the ones before."""
        kept = list(values)
        for index, signal in enumerate(received.message.signals):
            if not bad >> index & 1:
                received.bad_runs[index] = 0
                continue
            received.bad_runs[index] += 1
            self._count(received, "range")
            # Before there ever was a good one, the middle of the range stands in, and is invalid.
            middle = (signal.low + signal.high) / 2 * signal.scale + signal.offset
            kept[index] = received.values[index] if received.values else middle
            if not received.values:
                received.bad_runs[index] = _IN_A_ROW
            if received.bad_runs[index] == _IN_A_ROW:
                text = f"{received.message.name}.{signal.name} not available or out of range"
                self.events.append(
                    ReceptionEvent(time, "range", f"{text}, {_IN_A_ROW} times in a row")
                )
        return tuple(kept)

    def _put(self, received: ReceivedMessage, counter: int, time: int) -> None:
        """Put a part of a sample into its place."""
        slots = self._slots
        slot = slots.get(counter)
        if slot is not None and (
            slot.parts[received.part] is not None or time - slot.begun > self._stale
        ):
            del slots[counter]
            self.counts["incomplete"] += 1
            slot = None
        if slot is None:
            slot = _Slot(time, len(self._parts), [None] * len(self._parts))
            slots[counter] = slot
        slot.parts[received.part] = received.values
        slot.left -= 1
        if slot.left:
            return
        for older in list(slots):
            del slots[older]
            if older == counter:
                break
            self.counts["incomplete"] += 1
        self._complete(counter, time, tuple(v for part in slot.parts for v in part or ()))

    def _complete(self, counter: int, time: int, values: tuple[float, ...]) -> None:
        number = self._number_of(counter, time, values)
        if number is None:
            return
        if self._number is not None and number <= self._number and not self._restarted:
            self.counts["late"] += 1
            return
        self.clock.take(number, time)
        self._number, self._gap = number, False
        self.ready.append(Sample(number, time, values, self._restarted))
        self._restarted = False

    def _number_of(self, counter: int, time: int, values: tuple[float, ...]) -> int | None:
        """Return the number of a complete sample; None if it is not known."""
        if self._numbered is not None:
            number = int(values[self._numbered])
            if self._number is not None and self._number - number > _FAR:
                self._restart_count(number, time)
            return number
        modulus = self._parts[0].modulus
        if self._number is None:
            return None
        next_one = self._number + (counter - self._number - 1) % modulus + 1
        if not self._gap:
            return next_one
        if self._stated is not None and time - self._stated[1] <= self._stale:
            stated = self._stated[0]
            return stated + (counter - stated) % modulus
        near = self.clock.at(time) if self.clock.is_locked else next_one
        by_clock = near + (counter - near + modulus // 2) % modulus - modulus // 2
        return next_one if next_one == by_clock else None

    def _take_status(self, received: ReceivedMessage, time: int) -> None:
        """Set the number of the next frames to the count of samples that the board states."""
        if self._numbered is not None:
            return
        names = [s.name for s in received.message.signals]
        if "sample" not in names:
            return
        stated = int(received.values[names.index("sample")])
        if self._number is None:
            self._number = stated - 1
        ahead = stated - self._number
        if ahead < -_FAR:
            self._restart_count(stated, time)
            self._number = stated - 1
        # Further on than it should be: samples have been dropped whose counter nobody saw.
        self._gap = self._gap or not -_FAR <= ahead <= self._parts[0].modulus // 2
        self._stated = (stated, time)

    def _restart_count(self, number: int, time: int) -> None:
        """Begin anew because the board's count is another one than it was."""
        text = f"the board counts {number} samples, {(self._number or 0) + 1} were expected"
        self.counts["sequence"] += 1
        self.events.append(ReceptionEvent(time, "sequence", text))
        self._slots.clear()
        self.ready.clear()
        self._restarted = self._gap = True
        self.clock.restart(number, time)

    def _time_of(self, length: int, is_fd: bool) -> float:
        found = self._lengths.get((length, is_fd))
        if found is None:
            database = self._database
            found = frame_time(length, is_fd, database.bitrate, database.data_bitrate)
            self._lengths[length, is_fd] = found
        return found

    def sent(self, seconds: float) -> None:
        """Count the time that a frame of this node takes on the bus [s]."""
        self._busy += seconds

    def _measure(self, time: int) -> None:
        assert self._window is not None
        span = (time - self._window) * 1e-6
        self.load = self._busy / span
        self.peak_load = max(self.peak_load, self.load)
        babbling = self._foreign / span > _BABBLE
        if babbling and not self._babbling:
            text = f"{self._foreign / span:.0f} unknown frames a second"
            self.events.append(
                ReceptionEvent(time, "babbling", f"{text}, bus load {self.load:.0%}")
            )
        self._babbling = babbling
        self._busy, self._foreign, self._window = 0.0, 0, time
