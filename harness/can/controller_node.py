"""The loop's node: samples in, commands out, one turn for each tick.

    n            number of the tick's sample: the one before, plus one
    deadline     when n should arrive, plus the slack
    age          now less the arrival of the sample that is held

A tick begins when sample n or a later one is complete, or at the deadline. What follows is a
function of the frames and of the time at which the tick began alone, so a log that holds both (the
ticks as frames of their own, on a lane that is no bus) gives the same run again, bit for bit.

| at the tick there is | it does |
| --- | --- |
| sample n | takes it |
| a later one | n is missing: holds, one tick for each such sample; with `skip` one long tick |
| none | holds |
| one from before n | takes it, with its age |

Where nobody sends samples, as with a board that only drives, ticks keep to this machine's clock.

A command is sent in every tick. It follows the controller while the sample is fresh and nothing is
wrong, and is on its way to rest otherwise.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from harness.can.channel import Address, CanChannel, ChannelState, now
from harness.can.codec import Codec
from harness.can.database import HOLD, OFF, OPERATIONAL, RUN, STOPPED, Database, Message
from harness.can.precise_sleep import sleep_until
from harness.can.reception import Reception, ReceptionEvent, Sample
from harness.can.timing import Timing
from harness.can.voltage_ramp import VoltageRamp
from harness.common.errors import FaultError

__all__ = ["ControllerNode", "Journal", "Outgoing", "Turn"]

_AGAIN = 50
"""Samples that may be missing and still have a tick each (chosen)."""
_BAD_IN_A_ROW = 3
_MOST_EVENTS = 10_000
_FAREWELLS = 3
"""Frames that say `off`: one may be lost."""

TURN = struct.Struct("<IHBB")
"""Tick, steps, state of the medium, whether it began too late."""


class Journal(Protocol):
    """Takes all that happens on a bus, in its order."""

    def frame(self, message: Any) -> None:
        """Log a frame that came or went; its time is in [us]."""

    def turn(self, time: int, content: bytes) -> None:
        """Log that a tick began."""


@dataclass(frozen=True, slots=True)
class Turn:
    """A tick as it begins.

    Attributes:
        index: of the tick.
        time: [us].
        steps: sample periods that it spans.
        state: of the medium.
        overran: the tick before it took too long.
    """

    index: int
    time: int
    steps: int
    state: ChannelState
    overran: bool

    def packed(self) -> bytes:
        """As a frame's data."""
        return TURN.pack(self.index & 0xFFFFFFFF, self.steps, self.state, self.overran)


class Outgoing:
    """One message that this node sends."""

    def __init__(self, message: Message, database: Database, step: float) -> None:
        self.message = message
        self.seconds = database.seconds(message)
        self.every = max(1, round(message.cycle / step)) if message.cycle else 0
        """Ticks from one to the next; 0: only when there is a reason."""
        self._encode = Codec(message).encode
        self._modulus = message.modulus or 1
        self._counter = -1

    def frame(self, values: Sequence[float]) -> bytes:
        """Return the next frame.

        Raises:
            FaultError: a value does not fit.
        """
        self._counter = (self._counter + 1) % self._modulus
        return self._encode(values, self._counter)

    def numbered(self, values: Sequence[float], number: int) -> bytes:
        """Return a frame whose counter is the remainder of a number."""
        self._counter = number % self._modulus
        return self._encode(values, self._counter)


class _NoJournal:
    def frame(self, message: Any) -> None:
        pass

    def turn(self, time: int, content: bytes) -> None:
        pass


class ControllerNode:
    """The node of estimator and controller.

    Attributes:
        reception: what comes in.
        held: sample that the parts see.
        number: n.
        age: of the held sample [s].
        fault: why the sample is not to be used, a name of `FAULTS`; empty if it is.
        mode: of the last command.
        drive: voltages of the last command; None where nothing is commanded.
        latency: of the last command [s]; 0 where it did not follow a sample.
        events: faults with their times.
        journal: takes frames and ticks.
        idle: called when there is time.
    """

    def __init__(
        self, database: Database, name: str, address: Address, policy: Timing, step: float
    ) -> None:
        """Get ready; `open` goes on the bus.

        Args:
            database: of the bus.
            name: of this node in it.
            address: of the bus.
            policy: for late ticks, and how long the board is waited for.
            step: period of samples and ticks [s].
        """
        self.database = database
        self.address = address
        self.policy = policy
        self.step = step
        self._period = step * 1e6
        self._slack = policy.sample_deadline * 1e6
        self.reception = Reception(database, name, self._period)
        sent = database.sent_by(name)
        self._command = next(
            (Outgoing(m, database, step) for m in sent if m.role == "command"), None
        )
        self._beats = [Outgoing(m, database, step) for m in sent if m.role == "heartbeat"]
        self.drive: VoltageRamp | None = None
        if self._command is not None:
            signals = self._command.message.signals
            self._names = [s.name for s in signals]
            ports = self._command.message.ports
            self._limits = [s.range for s in ports]
            self.drive = VoltageRamp(self._limits, database.ramp_rate * step)
        self._wanted: list[float] = []
        self._bad = 0
        self.number: int | None = None
        self.held: Sample | None = None
        self.mode = OFF
        self.fault = ""
        self.age = 0.0
        self.latency = 0.0
        self.events: list[ReceptionEvent] = []
        self._event_ticks: list[int] = []
        self.journal: Journal = _NoJournal()
        self.idle: Callable[[], None] = lambda: None
        self._medium: CanChannel | None = None
        self._state = ChannelState.OPEN
        self._turn = Turn(0, 0, 1, ChannelState.OPEN, False)
        self._fresh = False
        self._beaten: int | None = None
        self._begun = 0

    # On the wall clock.

    def open(self) -> None:
        """Go on the bus.

        Raises:
            FaultError: it does not open.
        """
        self._medium = CanChannel(self.address, self.database)

    def meet(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Say that this node is operational, and wait for the board's first sample.

        Args:
            stopped: asked now and then whether to give up.

        Raises:
            FaultError: nothing complete comes in time.
        """
        assert self._medium is not None
        begun = now()
        beat = 0
        self._begun = time.monotonic_ns()
        if not self.reception.has_samples:
            return
        while not self.reception.ready and not stopped():
            there = now()
            if there - begun > self.policy.startup_timeout * 1e6:
                raise FaultError(self._nobody())
            if there >= beat:
                self._beat(OPERATIONAL)
                beat = there + 100_000
            self._take_one(0.01)
            if self._medium.state is ChannelState.FAILED:
                raise FaultError(f"the CAN bus ({self.address}): {self._medium.reason}")
        # What came with the sample, a heartbeat that says operational.
        while self._take_one(0.0):
            pass

    def _nobody(self) -> str:
        counts = {k: v for k, v in self.reception.counts.items() if v}
        heard = [h.message.name for h in self.reception.heard.values() if h.last is not None]
        seen = f"heard were {', '.join(heard)}" if heard else "nothing of the DBC file was heard"
        more = f"; dropped: {counts}" if counts else ""
        return (
            f"no complete sample within {self.policy.startup_timeout:g} s on the CAN bus "
            f"({self.address}): {seen}{more}. Is the board powered, its bit rate "
            f"{self.database.bitrate:g} bit/s, and {self.database.path.name} its message set?"
        )

    def wait(self, index: int) -> Turn:
        """Wait for the tick's sample or its deadline, and begin the tick.

        Raises:
            FaultError: the bus has failed, or the loop is too late and `stop` is its policy.
        """
        assert self._medium is not None
        reception, medium = self.reception, self._medium
        number = self.number
        began = now()
        deadline = began
        overran = False
        if number is not None:
            deadline = int(reception.clock.predict(number + 1) + self._slack)
            overran = began - self._turn.time > self._period
        ready = reception.ready
        if not ready:
            self.idle()
        if not reception.has_samples:
            sleep_until(self._begun + round(index * self._period * 1e3))
        while reception.has_samples and not (
            ready and (number is None or ready[-1].number > number)
        ):
            left = deadline - now()
            if not self._take_one(max(left, 0) * 1e-6) and left <= 0:
                break
        behind = not ready or now() - ready[-1].time > self._period / 2
        if overran or behind:
            while self._take_one(0.0):
                pass
        medium.tick()
        there = now()
        turn = self.turn(index, there, medium.state, overran)
        if medium.state is ChannelState.FAILED:
            raise FaultError(f"the CAN bus ({self.address}) failed: {medium.reason}")
        return turn

    def _take_one(self, timeout: float) -> bool:
        assert self._medium is not None
        message = self._medium.receive(timeout)
        if message is None:
            return False
        self.journal.frame(message)
        self.hear(message)
        return True

    def transmit(self, wanted: Sequence[float]) -> None:
        """Send the tick's command, and what else is due."""
        data = self.command(wanted)
        if data is not None:
            assert self._command is not None
            sent, held = self._send(self._command, data), self.held
            if self._fresh and held is not None and sent is not None:
                self.latency = (sent - held.time) * 1e-6
        self.beat()

    def beat(self) -> None:
        """Say that this node is there, when it is time to."""
        index, last = self._turn.index, self._beaten
        if last is None or any(beat.every and index - last >= beat.every for beat in self._beats):
            self._beaten = index
            self._beat(OPERATIONAL)

    def _send(self, outgoing: Outgoing, data: bytes) -> int | None:
        """Send a frame; when it went [us], None if the bus did not take it."""
        assert self._medium is not None
        m = outgoing.message
        message = self._medium.send(m.id, data, m.is_fd, m.extended)
        if message is None:
            return None
        self.reception.sent(outgoing.seconds)
        time = message.timestamp = now()
        self.journal.frame(message)
        return time

    def _beat(self, state: int) -> None:
        for beat in self._beats:
            self._send(beat, beat.frame([float(state)]))

    def metadata(self) -> dict[str, Any]:
        """Return what the report says about the bus; JSON types only."""
        reception = self.reception
        return {
            "messages": {
                h.message.name: {"id": h.message.id, **h.counts} for h in reception.heard.values()
            },
            "counts": dict(reception.counts),
            "events": [[e.time, e.kind, e.text] for e in self.events],
            "event_ticks": self._event_ticks,
            "peak_load": reception.peak_load,
            "drift": reception.clock.drift,
        }

    def close(self) -> None:
        """Command on its way to rest, then off, then leave the bus."""
        medium = self._medium
        if medium is None:
            return
        self._medium_closing(medium)
        medium.close()
        self._medium = None

    def _medium_closing(self, medium: CanChannel) -> None:
        if self._command is None or self.drive is None or not self._wanted:
            return
        at = time.monotonic()
        farewells = 0
        while farewells < _FAREWELLS and medium.state is ChannelState.OPEN:
            self.drive.step(None)
            self.mode = OFF if self.drive.is_at_rest else HOLD
            farewells += self.mode == OFF
            self._send(self._command, self._encoded())
            at += self.step
            while self._take_one(max(0.0, at - time.monotonic())):
                pass
        self._beat(STOPPED)

    # Functions of what came in alone.

    def hear(self, message: Any) -> None:
        """Take a frame; its time is in [us]."""
        id = message.arbitration_id | message.is_extended_id << 31
        odd = message.is_remote_frame or message.is_error_frame
        self.reception.take(message.timestamp, id, bytes(message.data), odd, message.is_fd)

    def turn(self, index: int, time: int, state: ChannelState, overran: bool) -> Turn:
        """Begin a tick: which sample the parts see, how old it is, and whether it may be used."""
        reception = self.reception
        reception.tick(time)
        counts = reception.counts
        if state is not self._state:
            self._changed(time, state)
        ready = reception.ready
        if ready and (
            self.number is None or ready[0].anew or ready[0].number - self.number > _AGAIN
        ):
            self.number = ready[0].number - 1
        number = (self.number if self.number is not None else -1) + 1
        steps = 1
        self._fresh = False
        if overran:
            counts["overruns"] += 1
            if self.policy.overrun == "stop":
                raise FaultError(
                    f"overrun: the tick before took longer than a period of {self.step:g} s, and "
                    "'overrun' is 'stop'"
                )
        while ready and ready[0].number < number:
            counts["late"] += 1
            self.held = ready.popleft()
        if ready and self.policy.overrun == "skip" and ready[-1].number > number:
            steps = ready[-1].number - number + 1
            self.held = ready.pop()
            self._fresh = True
            ready.clear()
        elif ready and ready[0].number == number:
            self.held = ready.popleft()
            self._fresh = True
        self.number = number + steps - 1
        self._judge(time, state)
        self._event_ticks += [index] * (len(self.events) - len(self._event_ticks))
        self._turn = Turn(index, time, steps, state, overran)
        self.journal.turn(time, self._turn.packed())
        return self._turn

    def _changed(self, time: int, state: ChannelState) -> None:
        kind = {ChannelState.BUS_OFF: "bus_off", ChannelState.GONE: "unplugged"}.get(state)
        if kind is not None:
            self.reception.counts[kind] += 1
            reason = self._medium.reason if self._medium is not None else ""
            self._happened(ReceptionEvent(time, kind, reason or kind.replace("_", "-")))
        if state is ChannelState.OPEN:
            self.reception.restart()
        self._state = state

    def _judge(self, time: int, state: ChannelState) -> None:
        """Age and fault of the held sample."""
        held, was = self.held, self.fault
        self._happened(*self.reception.events)
        self.reception.events.clear()
        if state is not ChannelState.OPEN:
            self.fault = "bus_off" if state is ChannelState.BUS_OFF else "unplugged"
        elif not self.reception.has_samples:
            self.fault = self.reception.fault
        elif held is None or self.number is None:
            self.fault = "timeouts"
        else:
            behind = (self.number - held.number) * self._period
            silent = behind > self.reception.timeout
            self.fault = self.reception.fault or ("timeouts" if silent else "")
        silent_by_nature = 0.0 if not self.reception.has_samples else math.inf
        self.age = (time - held.time) * 1e-6 if held is not None else silent_by_nature
        if self._fresh and not self.fault and self._medium is not None:
            self._medium.recovered()
        if self.fault != was:
            words = f"invalid: {self.fault}" if self.fault else f"valid again after {was}"
            self._happened(ReceptionEvent(time, self.fault or was, words))

    def _happened(self, *events: ReceptionEvent) -> None:
        """Keep events, as many as anybody can read; their counts go on."""
        self.events += events[: max(0, _MOST_EVENTS - len(self.events))]

    @property
    def valid(self) -> bool:
        """True if the held sample may be used."""
        return not self.fault

    def command(self, wanted: Sequence[float]) -> bytes | None:
        """Return the tick's command; None where nothing is commanded.

        Args:
            wanted: voltages that the controller asks for [V].
        """
        drive = self.drive
        if drive is None or self._command is None:
            return None
        self.latency = 0.0
        for value, (low, high) in zip(wanted, self._limits, strict=True):
            if not low <= value <= high:
                self._bad += 1
                self.reception.counts["range"] += 1
                break
        else:
            self._bad = 0
            self._wanted = [*wanted]
        stale = self.age * 1e6 > self.reception.timeout
        if self.fault or stale or not self._wanted or self._bad >= _BAD_IN_A_ROW:
            drive.step(None)
            self.mode = HOLD
        else:
            drive.step(self._wanted)
            self.mode = RUN
        return self._encoded()

    def _encoded(self) -> bytes:
        assert self.drive is not None
        assert self._command is not None
        volts = iter(self.drive.volts)
        given = {"mode": float(self.mode), "echo": float(max(self.number or 0, 0))}
        values = [given[n] if n in given else next(volts) for n in self._names]
        return self._command.frame(values)
