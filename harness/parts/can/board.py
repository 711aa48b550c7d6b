"""The board's end of a bus as parts: what it applies is one part, what it samples its sibling.

part `bus`            outputs: values of the command as they are applied, `mode`, `valid`
part `bus.samples`    inputs: values of the samples and of the status
"""

from __future__ import annotations

from typing import Any

from harness.can.database import Database
from harness.can.device_node import DeviceNode
from harness.parts.can.address import ports_of
from harness.parts.can.part import BusPart, BusSibling
from harness.parts.ports import Port
from harness.parts.settings import CanSettings

__all__ = ["BoardPart"]


class BoardPart(BusPart[DeviceNode]):
    """What the loop commands, as the outputs of a part."""

    kind = "board"
    takes_by_name = True

    def __init__(
        self, name: str, keys: CanSettings, database: Database, node: DeviceNode | None = None
    ) -> None:
        super().__init__(name, keys, database, node)
        self.outputs = (
            *ports_of(database.received_by(keys.node), "command"),
            Port("mode", "Integer", description="of the last command: 0 off, 1 hold, 2 run"),
            Port("valid", "Boolean", description="whether there is a good command"),
        )
        samples = SamplesPart(self)
        self.siblings = {samples.name: samples}

    def advance(self, t: float, h: float) -> None:
        """Put out what is applied; see `Part.advance`."""
        node = self.node
        self._y[:] = (*node.ramp.volts, node.mode, node.is_commanded)

    def metadata(self) -> dict[str, Any]:
        """Bus, messages, faults."""
        about = super().metadata()
        if self._node is not None:
            about |= {"faults": [str(fault) for fault in self.node.faults], "seed": self.node.seed}
        return about


class SamplesPart(BusSibling[DeviceNode]):
    """What a board samples, as the inputs of a part; what nothing drives is not available."""

    def __init__(self, board: BoardPart) -> None:
        super().__init__(board, "samples")
        sent = self.database.sent_by(self.keys.node)
        self.inputs = ports_of(sent, "sample", "status")

    def advance(self, t: float, h: float) -> None:
        """Send the sample; see `Part.advance`."""
        self.node.transmit(dict(zip(self._connected, self._u.tolist(), strict=True)))
