"""Boards on a CAN bus as parts: what comes in is one part, what goes out its sibling.

    part `sensors`            outputs: values of all messages that come in, `age`, `valid`,
                              `sample`, `load`, and how often each fault of
                              `harness.can.reception.FAULTS` occurred
    part `sensors.command`    inputs: values of the command; outputs: what was sent

`replaces` names parts that are at the other end of the bus, too: the world that the board is in.
They leave the loop, and a wire between the two sides goes over the bus where a signal has the name
of the wire's output.
"""

from __future__ import annotations

from typing import Any

from harness.can.controller_node import ControllerNode
from harness.can.cycle import CycleInput
from harness.can.database import Database
from harness.can.reception import FAULTS, Reception
from harness.common.errors import FaultError
from harness.common.types import FloatArray
from harness.parts.can.address import ports_of
from harness.parts.can.part import BusPart, BusSibling
from harness.parts.ports import Port, unit_of
from harness.parts.settings import CanSettings

__all__ = ["CommandPart", "FeedPart", "received_ports"]

OLDEST = 1e4
"""What `age` is at most [s]: before the first sample it would be infinite."""


def received_ports(database: Database, node: str) -> list[Port]:
    """Signals of all messages that a node receives, those of the samples first."""
    received = sorted(database.received_by(node), key=lambda m: m.role != "sample")
    return ports_of(received)


class RxMapper:
    """Writes what was received to a part's outputs, in the order of `received_ports`."""

    def __init__(self, reception: Reception, y: FloatArray) -> None:
        """Begin with the middle of each range: nothing has been received."""
        others = [message.message for message in reception.other_messages]
        samples = [m.message for m in reception.messages.values() if m.message.role == "sample"]
        ports = [s for message in (*samples, *others) for s in message.ports]
        self.width = len(ports)
        y[: self.width] = [(s.low + s.high) // 2 * s.scale + s.offset for s in ports]
        self._y = y
        names = [s for message in samples for s in message.signals]
        inner = {s.name for message in samples for s in message.ports}
        self._picked = [i for i, s in enumerate(names) if s.name in inner]
        self._takes_all = len(self._picked) == len(names)
        self._written: list[tuple[float, ...]] = [()] * len(others)
        self._others = []
        begin = len(self._picked)
        for message in others:
            picked = [i for i, s in enumerate(message.signals) if s in message.ports]
            self._others.append((slice(begin, begin + len(picked)), picked))
            begin += len(picked)

    def write(self, taken: CycleInput) -> None:
        """Write the values of the sample, and those of other messages where they are new."""
        if taken.sample is not None:
            values = taken.sample.values
            if not self._takes_all:
                values = tuple([values[i] for i in self._picked])
            self._y[: len(self._picked)] = values
        for place, values in enumerate(taken.messages):
            if values is not self._written[place]:
                self._written[place] = values
                span, picked = self._others[place]
                self._y[span] = [values[i] for i in picked]


class FeedPart(BusPart[ControllerNode]):
    """What a board sends, as the outputs of a part.

    Attributes:
        companion: the part that sends.
    """

    kind = "can"

    def __init__(
        self, name: str, keys: CanSettings, database: Database, node: ControllerNode | None = None
    ) -> None:
        super().__init__(name, keys, database, node)
        self.outputs = (
            *received_ports(database, keys.node),
            Port("age", "Real", unit_of("s"), "age of the sample that the values are of"),
            Port("valid", "Boolean", description="whether the sample may be used"),
            Port("sample", "Integer", description="its number, counted by the board"),
            Port("due", "Integer", description="number of the sample that is due"),
            Port("load", "Real", description="share of the bus that frames take"),
            *(Port(fault, "Integer", description=f"{fault} so far") for fault in FAULTS),
        )
        self.companion = CommandPart(self)
        self.siblings = {self.companion.name: self.companion} if self.companion.inputs else {}

    def _prepare(self) -> None:
        super()._prepare()
        self._mapper = RxMapper(self.node.reception, self._y)
        self._status = self._y[self._mapper.width :]
        self._status[0] = OLDEST

    def advance(self, t: float, h: float) -> None:
        """Put out what the tick has taken from the bus; see `Part.advance`."""
        taken = self.node.input
        assert taken is not None, "a tick begins before its parts advance"
        self._mapper.write(taken)
        sample = taken.sample
        self._status[:] = (
            min(taken.age, OLDEST),
            not taken.fault,
            sample.number if sample is not None else -1,
            taken.number,
            taken.load,
            *taken.counts,
        )

    def metadata(self) -> dict[str, Any]:
        """Bus, messages."""
        return {
            **super().metadata(),
            "interface": self.keys.interface,
            "channel": self.keys.channel,
            "replaces": list(self.keys.replaces),
        }


class CommandPart(BusSibling[ControllerNode]):
    """What a node commands, as the inputs of a part."""

    def __init__(self, feed: FeedPart) -> None:
        super().__init__(feed, "command")
        self.inputs = ports_of(self.database.sent_by(self.keys.node), "command")
        self.outputs = (
            *(
                Port(_sent(port.name), port.type, port.unit, f"{port.description}, as sent")
                for port in self.inputs
            ),
            Port("mode", "Integer", description="of the command: 0 off, 1 hold, 2 run"),
            Port(
                "latency",
                "Real",
                unit_of("s"),
                "since the last frame of a new sample; 0: no new one",
            ),
        )

    def _prepare(self) -> None:
        connected = self._connected
        names = [port.name for port in self.inputs]
        self._order = [connected.index(name) for name in names if name in connected]
        missing = [name for name in names if name not in connected]
        if connected and missing:
            raise FaultError(
                f"a command is sent as a whole, and nothing drives {', '.join(missing)}"
            )

    def advance(self, t: float, h: float) -> None:
        """Send the command; see `Part.advance`."""
        if not self._order:
            self.node.send_heartbeat_if_due()
            return
        u = self._u.tolist()
        sent = self.node.transmit([u[i] for i in self._order])
        assert sent is not None
        command, latency = sent
        self._y[:] = (*command.volts, command.mode, latency)


def _sent(name: str) -> str:
    """Name of what was sent of a port.

    >>> _sent("volts_1")
    'volts_sent_1'
    """
    stem, _, number = name.rpartition("_")
    return f"{stem}_sent_{number}" if stem and number.isdigit() else f"{name}_sent"
