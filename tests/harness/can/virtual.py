"""Loop and board on a bus without a wire and without a clock: as fast as it goes, always the same.

A sample says its own number in all of its values, so that a mixed or a misnumbered one shows.
"""

import math
from collections.abc import Callable, Sequence

import can

from harness.can.channel import Address, ChannelState
from harness.can.cycle import ControllerCycle, CycleInput, Tick
from harness.can.database import Database, load
from harness.can.device_node import DeviceNode
from harness.can.fault_injection import InjectedFault
from harness.scenario.schema import Hil

STEP = 1e-3
MS = 1000  # us
TRANSIT = 300  # us from the instant of a sample to its last frame
NOWHERE = Address("virtual", None)


class Wire:
    """What the board sees of the channel."""

    def __init__(self) -> None:
        self.state = ChannelState.OPEN
        self.frames: list[tuple[int, bytes, bool, bool]] = []
        self.bus_off = False
        self.away = 0.0

    def send(self, id: int, data: bytes, is_fd: bool, extended: bool = False) -> None:
        self.frames.append((id, data, is_fd, extended))

    def declare_bus_off(self) -> None:
        self.bus_off = True

    def unplug(self, seconds: float) -> None:
        self.away = seconds


def truth(number: int, index: int) -> float:
    """Value of a signal in a sample: tells both apart."""
    return 0.2 + 4.6 * ((number * 37 + index * 101) % 997) / 997


def asked(tick: int) -> list[float]:
    """What the controller wants."""
    return [50 + 40 * math.sin(2 * math.pi * 3 * tick * STEP + i) for i in range(3)]


class Rig:
    """Both ends.

    Attributes:
        modes, volts: of the command at each tick, as they were on the bus.
        applied: by the board.
        wanted: of the controller.
    """

    def __init__(
        self,
        dbc: str = "instrument",
        faults: Sequence[InjectedFault] = (),
        seed: int = 0,
        policy: Hil | None = None,
        each: Callable[["Rig"], None] = lambda _: None,
    ) -> None:
        self.database: Database = load(dbc)
        self.board = DeviceNode(self.database, "Board", NOWHERE, STEP, faults=faults, seed=seed)
        self.loop = ControllerCycle(self.database, "Loop", policy or Hil(), STEP)
        self.input: CycleInput | None = None
        self.wire = Wire()
        self.board._channel = self.wire  # type: ignore[assignment]
        self.board._start = 1
        self.each = each
        self.tick = 0
        self.time = 1_000_000
        self.modes: list[int] = []
        self.volts: list[list[float]] = []
        self.applied: list[list[float]] = []
        self.wanted: list[list[float]] = []
        self.names = self.loop.reception.signals
        self._command = next(m for m in self.database.sent_by("Loop") if m.role == "command")
        self._decode = self.board.reception.messages[self._command.id].decode
        self._beat = next(m for m in self.database.sent_by("Loop") if m.role == "heartbeat")
        self.inject: list[tuple[int, bytes, bool, bool]] = []
        """Further frames of the next sample."""
        self.deaf = False
        """The loop's commands do not arrive."""

    def receive(self, frame: can.Message) -> None:
        """A frame arrives at the loop."""
        self.loop.reception.receive(frame)

    def begin(self, tick: Tick) -> None:
        """A tick of the loop begins."""
        self.input = self.loop.cycle((), tick)

    def run(self, ticks: int) -> None:
        for _ in range(ticks):
            self.step()

    def step(self) -> None:
        """One sample, one tick, one command."""
        board, wire = self.board, self.wire
        state = ChannelState.OPEN
        if self._is_active("bus-off"):
            state = ChannelState.BUS_OFF
        elif self._is_active("unplug"):
            state = ChannelState.UNPLUGGED
        board.begin_cycle(self.tick, self.time)
        values = {n: truth(self.tick, i) for i, n in enumerate(self.names)}
        values.pop("field_new", None)
        wire.frames = []
        board.transmit({**values, "temperature": 25.0})
        arrivals, self.inject = [*wire.frames, *self.inject], []
        for index, (id, data, is_fd, extended) in enumerate(arrivals):
            if state is ChannelState.OPEN:
                self.receive(
                    can.Message(
                        timestamp=self.time + TRANSIT * (index + 1) // (len(arrivals) + 1),
                        arbitration_id=id,
                        data=data,
                        is_fd=is_fd,
                        is_extended_id=extended,
                    )
                )
        self.begin(Tick(self.tick, self.time + TRANSIT, state))
        u = asked(self.tick)
        command = self.loop.command(u)
        assert command is not None
        data = command.data
        if state is ChannelState.OPEN and not self.deaf:
            board.reception.take(
                self.time + TRANSIT + 50, self._command.id, data, False, self._command.is_fd
            )
            if self.tick % 100 == 0:
                board.reception.take(self.time, self._beat.id, bytes([5]))
        sent, bad = self._decode(data)
        assert not bad
        given = dict(zip((s.name for s in self._command.signals), sent, strict=True))
        self.modes.append(int(given["mode"]))
        self.volts.append([given[f"volts_{i}"] for i in (1, 2, 3)])
        self.applied.append(list(board.ramp.volts))
        self.wanted.append(u)
        self.each(self)
        self.tick += 1
        self.time += MS

    def _is_active(self, kind: str) -> bool:
        return any(f.kind == kind and f.covers(self.tick * STEP) for f in self.board.faults)
