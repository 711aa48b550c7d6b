"""The controller node's cycle: what a tick takes from the bus, as a function of frames and time.

    n            number of the tick's sample: the one before, plus one
    age          time of the tick less the arrival of the last sample taken

| at the tick there is | it does |
| --- | --- |
| sample n | takes it |
| a later one | n is missing: holds, one tick for each such sample; with `skip` one long tick |
| none | holds |
| one from before n | takes it, with its age |

There is no socket, no clock and no thread here. A log that holds the frames and the beginnings of
the ticks gives the same inputs and commands again, bit for bit.

A command is made in every tick. It follows the controller while the sample is fresh and nothing is
wrong, and is on its way to rest otherwise.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from harness.can.channel import ChannelState
from harness.can.database import HOLD, OFF, RUN, Database
from harness.can.reception import Reception, ReceptionEvent, Sample
from harness.can.timing import Timing
from harness.can.transmission import sent_messages
from harness.can.voltage_ramp import VoltageRamp
from harness.common.errors import FaultError

__all__ = ["TICK", "Command", "ControllerCycle", "CycleInput", "Tick"]

_LARGEST_GAP = 50
"""Samples that may be missing and still have a tick each (chosen)."""
_BAD_IN_A_ROW = 3
_MOST_EVENTS = 10_000

TICK = struct.Struct("<IHBB")
"""Of a tick in a log: index, steps, state of the channel, whether the tick before overran."""


@dataclass(frozen=True, slots=True)
class Tick:
    """The beginning of a tick.

    Attributes:
        index: of the tick.
        time: at which it begins [us].
        state: of the CAN channel.
        overran: whether the tick before took too long.
        reason: why the channel is not open, in words.
    """

    index: int
    time: int
    state: ChannelState = ChannelState.OPEN
    overran: bool = False
    reason: str = ""


class CycleInput(NamedTuple):
    """All that a tick takes from the bus.

    Attributes:
        tick: its beginning.
        steps: sample periods that it spans.
        number: n.
        sample: the last one that was taken; None before the first.
        is_fresh: whether it was taken in this tick, on time.
        age: of the sample [s].
        fault: why the sample is not to be used, one of `FAULTS`; empty if it may be used.
        messages: last values of each of `Reception.other_messages`; empty before the first.
        load: share of the bus that frames take.
        counts: of each of `FAULTS`.
    """

    tick: Tick
    steps: int
    number: int
    sample: Sample | None
    is_fresh: bool
    age: float
    fault: str
    messages: tuple[tuple[float, ...], ...]
    load: float
    counts: tuple[int, ...]

    def packed(self) -> bytes:
        """Return the tick as the data of a frame in a log."""
        tick = self.tick
        return TICK.pack(tick.index & 0xFFFFFFFF, self.steps, tick.state, tick.overran)


class Command(NamedTuple):
    """The command of a tick.

    Attributes:
        data: of its frame.
        volts: that it asks for [V].
        mode: `OFF`, `HOLD` or `RUN`.
    """

    data: bytes
    volts: list[float]
    mode: int


class ControllerCycle:
    """The cycle of estimator and controller.

    Attributes:
        reception: state of what comes in.
        command_message: None where nothing is commanded.
        events: faults with their times, as many as anybody can read; their counts go on.
    """

    def __init__(self, database: Database, node: str, timing: Timing, step: float) -> None:
        """Begin without a frame.

        Args:
            database: of the bus.
            node: name of this node in it.
            timing: what to do about late ticks.
            step: period of samples and ticks [s].
        """
        self._timing = timing
        self._step = step
        self._period = step * 1e6
        self.reception = Reception(database, node, self._period)
        self.command_message = next(iter(sent_messages(database, node, step, "command")), None)
        message = self.command_message.message if self.command_message is not None else None
        self._names = [s.name for s in message.signals] if message is not None else []
        self._limits = [s.range for s in message.ports] if message is not None else []
        self._ramp = VoltageRamp(self._limits, database.ramp_rate * step)
        self._wanted: list[float] = []
        self._bad = 0
        self._input: CycleInput | None = None
        self._number: int | None = None
        self._sample: Sample | None = None
        self._state = ChannelState.OPEN
        self._fault = ""
        self.events: list[ReceptionEvent] = []
        self._event_ticks: list[int] = []

    @property
    def is_commanding(self) -> bool:
        """True once there has been a good command."""
        return bool(self._wanted)

    def cycle(self, frames: Iterable[Any], tick: Tick) -> CycleInput:
        """Return what a tick takes from the bus.

        Args:
            frames: messages of python-can since the tick before, times in [us]. Those that were
                given to `reception.receive` as they arrived are left out: then nothing is left to
                decode when the tick begins.
            tick: its beginning.

        Raises:
            FaultError: the tick before was too long, and `stop` is the policy.
        """
        reception = self.reception
        for frame in frames:
            reception.receive(frame)
        reception.tick(tick.time)
        if tick.state is not self._state:
            self._change_state(tick)
        if tick.overran:
            self._overrun()
        steps, is_fresh = self._advance()
        if reception.events:
            self._log_events(*reception.events)
            reception.events.clear()
        fault = self._find_fault(tick.state)
        if fault != self._fault:
            words = f"invalid: {fault}" if fault else f"valid again after {self._fault}"
            self._log_events(ReceptionEvent(tick.time, fault or self._fault, words))
            self._fault = fault
        self._event_ticks += [tick.index] * (len(self.events) - len(self._event_ticks))
        assert self._number is not None
        sample = self._sample
        before_first = math.inf if reception.has_samples else 0.0
        self._input = CycleInput(
            tick,
            steps,
            self._number,
            sample,
            is_fresh,
            (tick.time - sample.time) * 1e-6 if sample is not None else before_first,
            fault,
            tuple([message.values for message in reception.other_messages]),
            reception.load,
            tuple(reception.counts.values()),
        )
        return self._input

    def command(self, wanted: Sequence[float]) -> Command | None:
        """Return the tick's command; None where nothing is commanded.

        Args:
            wanted: voltages that the controller asks for [V].
        """
        taken = self._input
        if self.command_message is None or taken is None:
            return None
        for value, (low, high) in zip(wanted, self._limits, strict=True):
            if not low <= value <= high:
                self._bad += 1
                self.reception.counts["range"] += 1
                break
        else:
            self._bad = 0
            self._wanted = [*wanted]
        is_stale = taken.age * 1e6 > self.reception.timeout
        if taken.fault or is_stale or not self._wanted or self._bad >= _BAD_IN_A_ROW:
            return self._encoded(self._ramp.step(None), HOLD)
        return self._encoded(self._ramp.step(self._wanted), RUN)

    def shutdown_command(self) -> Command:
        """Return the next command on the way to rest, `OFF` once it is reached."""
        volts = self._ramp.step(None)
        return self._encoded(volts, OFF if self._ramp.is_at_rest else HOLD)

    def metadata(self) -> dict[str, Any]:
        """Return what the report says about the bus; JSON types only."""
        reception = self.reception
        return {
            "messages": {
                m.message.name: {"id": m.message.id, **m.counts}
                for m in reception.messages.values()
            },
            "counts": dict(reception.counts),
            "events": [[e.time, e.kind, e.text] for e in self.events],
            "event_ticks": self._event_ticks,
            "peak_load": reception.peak_load,
            "drift": reception.clock.drift,
        }

    def _change_state(self, tick: Tick) -> None:
        """Count and log that the channel was lost; begin anew when it is there again."""
        state, self._state = tick.state, tick.state
        kind = {ChannelState.BUS_OFF: "bus_off", ChannelState.UNPLUGGED: "unplugged"}.get(state)
        if kind is not None:
            self.reception.counts[kind] += 1
            self._log_events(ReceptionEvent(tick.time, kind, tick.reason or kind.replace("_", "-")))
        if state is ChannelState.OPEN:
            self.reception.restart()

    def _overrun(self) -> None:
        self.reception.counts["overruns"] += 1
        if self._timing.overrun == "stop":
            raise FaultError(
                f"overrun: the tick before took longer than a period of {self._step:g} s, and "
                "'overrun' is 'stop'"
            )

    def _advance(self) -> tuple[int, bool]:
        """Take the tick's sample; return steps and whether it is fresh."""
        ready, last = self.reception.ready, self._number
        if ready and (last is None or ready[0].restarted or ready[0].number - last > _LARGEST_GAP):
            last = ready[0].number - 1
        number = (last if last is not None else -1) + 1
        steps, is_fresh = 1, False
        while ready and ready[0].number < number:
            self.reception.counts["late"] += 1
            self._sample = ready.popleft()
        if ready and self._timing.overrun == "skip" and ready[-1].number > number:
            steps, is_fresh = ready[-1].number - number + 1, True
            self._sample = ready.pop()
            ready.clear()
        elif ready and ready[0].number == number:
            self._sample, is_fresh = ready.popleft(), True
        self._number = number + steps - 1
        return steps, is_fresh

    def _find_fault(self, state: ChannelState) -> str:
        """Return why the sample is not to be used; empty if it may be used."""
        if state is not ChannelState.OPEN:
            return "bus_off" if state is ChannelState.BUS_OFF else "unplugged"
        reception, sample = self.reception, self._sample
        if not reception.has_samples:
            return reception.fault
        if sample is None or self._number is None:
            return "timeouts"
        behind = (self._number - sample.number) * self._period
        return reception.fault or ("timeouts" if behind > reception.timeout else "")

    def _log_events(self, *events: ReceptionEvent) -> None:
        self.events += events[: max(0, _MOST_EVENTS - len(self.events))]

    def _encoded(self, volts: list[float], mode: int) -> Command:
        assert self.command_message is not None
        remaining = iter(volts)
        given = {"mode": float(mode), "echo": float(max(self._number or 0, 0))}
        values = [given[n] if n in given else next(remaining) for n in self._names]
        return Command(self.command_message.frame(values), volts, mode)
