"""Boards on a CAN bus as parts: what comes in is one part, what goes out its companion.

    part `sensors`            outputs: values of all messages that come in, `age`, `valid`,
                              `sample`, `load`, and how often each fault of
                              `harness.can.reception.FAULTS` occurred
    part `sensors.command`    inputs: values of the command; outputs: what was sent

`replaces` names parts that are at the other end of the bus, too: the world that the board is in.
They leave the loop, and a wire between the two sides goes over the bus where a signal has the name
of the wire's output.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from harness.can.database import Database
from harness.can.timing import Timing
from harness.common.errors import FaultError
from harness.common.types import FloatArray
from harness.parts.can.address import address_of, port_of
from harness.parts.ports import Port, unit_of
from harness.parts.protocols import RunContext
from harness.parts.settings import CanSettings

if TYPE_CHECKING:
    from harness.can.controller_node import ControllerNode
    from harness.can.reception import ReceivedMessage, Reception

__all__ = ["CommandPart", "FeedPart", "received_ports"]

OLDEST = 1e4
"""What `age` is at most [s]: before the first sample it would be infinite."""


def received_ports(database: Database, node: str) -> list[Port]:
    """Signals of all messages that a node hears, those of the samples first."""
    heard = sorted(database.heard_by(node), key=lambda m: m.role != "sample")
    return [port_of(signal) for message in heard for signal in message.ports]


class Inlet:
    """Lays what was received into a part's outputs, in the order of `received_ports`."""

    def __init__(self, reception: Reception, y: FloatArray) -> None:
        """Begin with the middle of each range: nothing has been received."""
        heard = sorted(reception.heard.values(), key=lambda h: h.message.role != "sample")
        self.width = sum(len(h.message.ports) for h in heard)
        parts = [h for h in heard if h.part >= 0]
        names = [s for h in parts for s in h.message.signals]
        ports = {s.name for h in parts for s in h.message.ports}
        self._pick = [i for i, s in enumerate(names) if s.name in ports]
        self._whole = len(self._pick) == len(names)
        self._count = len(self._pick)
        self._y = y
        self._seen: dict[int, int | None] = {}
        self._others: list[tuple[ReceivedMessage, int, list[int]]] = []
        at = self._count
        for h in heard:
            if h.part < 0:
                pick = [i for i, s in enumerate(h.message.signals) if s in h.message.ports]
                self._others.append((h, at, pick))
                at += len(pick)
        signals = [s for h in heard for s in h.message.ports]
        y[: self.width] = [(s.low + s.high) // 2 * s.scale + s.offset for s in signals]

    def sample(self, values: tuple[float, ...]) -> None:
        """Lay out the values of a sample."""
        if not self._whole:
            values = tuple(values[i] for i in self._pick)
        self._y[: self._count] = values

    def others(self) -> None:
        """Lay out the last values of all other messages, where they are new."""
        for h, at, pick in self._others:
            if h.last != self._seen.get(at):
                self._seen[at] = h.last
                for offset, index in enumerate(pick):
                    self._y[at + offset] = h.values[index]


def _node_on_bus(feed: FeedPart, step: float) -> ControllerNode:
    from harness.can.controller_node import ControllerNode

    return ControllerNode(feed.database, feed.keys.node, address_of(feed.keys), feed.policy, step)


class FeedPart:
    """What a board sends, as the outputs of a part.

    Attributes:
        node: at this end of the bus; there from `start` on.
        policy: for late ticks; set before `start`.
        make_node: of this part and the period [s]; on the bus, unless set before `start`.
        companion: the part that sends.
    """

    def __init__(self, name: str, keys: CanSettings, database: Database) -> None:
        from harness.can.reception import FAULTS

        self.name = name
        self.keys = keys
        self.database = database
        self.policy = Timing()
        self.seconds = math.inf
        self.inputs: Sequence[Port] = ()
        self.outputs: Sequence[Port] = (
            *received_ports(database, keys.node),
            Port("age", "Real", unit_of("s"), "age of the sample that the values are of"),
            Port("valid", "Boolean", description="whether the sample may be used"),
            Port("sample", "Integer", description="its number, counted by the board"),
            Port("due", "Integer", description="number of the sample that is due"),
            Port("load", "Real", description="share of the bus that frames take"),
            *(Port(fault, "Integer", description=f"{fault} so far") for fault in FAULTS),
        )
        self.companion = CommandPart(f"{name}.command", self)
        self.node: ControllerNode | None = None
        self.make_node: Callable[[FeedPart, float], ControllerNode] = _node_on_bus

    @property
    def siblings(self) -> Mapping[str, CommandPart]:
        """Parts that stand beside this one in the loop."""
        return {self.companion.name: self.companion} if self.companion.inputs else {}

    def start(
        self,
        run: RunContext,
        connected: Sequence[str],
        initialised: Sequence[bool],
        u: FloatArray,
        y: FloatArray,
    ) -> None:
        """Go on the bus; see `Part.start`."""
        node = self.node = self.make_node(self, run.step)
        self._inlet = Inlet(node.reception, y)
        self._more = y[self._inlet.width :]
        self._more[:] = 0.0
        self._more[0] = OLDEST
        node.open()

    def advance(self, t: float, h: float) -> None:
        """Put out what the tick's turn has found; see `Part.advance`."""
        node = self.node
        assert node is not None
        if node.held is not None:
            self._inlet.sample(node.held.values)
        self._inlet.others()
        reception = node.reception
        held = node.held.number if node.held is not None else -1
        self._more[:] = (
            min(node.age, OLDEST),
            not node.fault,
            held,
            node.number,
            reception.load,
            *reception.counts.values(),
        )

    def close(self) -> None:
        """Bring the command to rest and leave the bus."""
        if self.node is not None:
            self.node.close()

    def metadata(self) -> dict[str, Any]:
        """Bus, messages."""
        return {
            "kind": "can",
            "file": self.database.path.name,
            "node": self.keys.node,
            "interface": self.keys.interface,
            "channel": self.keys.channel,
            "replaces": list(self.keys.replaces),
        }


class CommandPart:
    """What a node commands, as the inputs of a part."""

    def __init__(self, name: str, feed: FeedPart) -> None:
        self.name = name
        self._feed = feed
        self.seconds = math.inf
        sent = feed.database.sent_by(feed.keys.node)
        ports = [port_of(s) for m in sent if m.role == "command" for s in m.ports]
        self.inputs: Sequence[Port] = ports
        self.outputs: Sequence[Port] = (
            *(
                Port(_sent(port.name), port.type, port.unit, f"{port.description}, as sent")
                for port in ports
            ),
            Port("mode", "Integer", description="of the command: 0 off, 1 hold, 2 run"),
            Port(
                "latency",
                "Real",
                unit_of("s"),
                "since the last frame of a new sample; 0: no new one",
            ),
        )

    def start(
        self,
        run: RunContext,
        connected: Sequence[str],
        initialised: Sequence[bool],
        u: FloatArray,
        y: FloatArray,
    ) -> None:
        """See `Part.start`."""
        names = [port.name for port in self.inputs]
        self._u = u
        self._y = y
        self._y[:] = 0.0
        self._order = [connected.index(name) for name in names if name in connected]
        missing = [name for name in names if name not in connected]
        if connected and missing:
            raise FaultError(
                f"a command is sent as a whole, and nothing drives {', '.join(missing)}"
            )

    def advance(self, t: float, h: float) -> None:
        """Send the command; see `Part.advance`."""
        node = self._feed.node
        assert node is not None
        if not self._order:
            node.beat()
            return
        u = self._u.tolist()
        node.transmit([u[i] for i in self._order])
        assert node.drive is not None
        self._y[:] = (*node.drive.volts, node.mode, node.latency)

    def close(self) -> None:
        """Do nothing: the other part leaves the bus for both."""

    def metadata(self) -> dict[str, Any]:
        """Name the part that it belongs to."""
        return {"kind": "can", "file": self._feed.database.path.name, "of": self._feed.name}


def _sent(name: str) -> str:
    """Name of what was sent of a port.

    >>> _sent("volts_1")
    'volts_sent_1'
    """
    stem, _, number = name.rpartition("_")
    return f"{stem}_sent_{number}" if stem and number.isdigit() else f"{name}_sent"
