"""The board's end of a bus as parts: what it applies is one part, what it samples its companion.

part `bus`            outputs: values of the command as they are applied, `mode`, `valid`
part `bus.samples`    inputs: values of the samples and of the status
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from harness.can.database import Database
from harness.can.device_node import DeviceNode
from harness.can.fault_injection import InjectedFault
from harness.common.types import FloatArray
from harness.parts.can.address import address_of, port_of
from harness.parts.ports import Port
from harness.parts.protocols import RunContext
from harness.parts.settings import CanSettings

__all__ = ["BoardPart"]


class BoardPart:
    """What the loop commands, as the outputs of a part.

    Attributes:
        node: at this end of the bus; there from `start` on.
        drift, faults, seed: of `DeviceNode`; set before `start`.
    """

    def __init__(self, name: str, keys: CanSettings, database: Database) -> None:
        self.name = name
        self.keys = keys
        self.database = database
        self.seconds = math.inf
        self.drift = 0.0
        self.faults: Sequence[InjectedFault] = ()
        self.seed = 0
        self.node: DeviceNode | None = None
        self.inputs: Sequence[Port] = ()
        heard = [m for m in database.heard_by(keys.node) if m.role == "command"]
        self.outputs: Sequence[Port] = (
            *(port_of(signal) for m in heard for signal in m.ports),
            Port("mode", "Integer", description="of the last command: 0 off, 1 hold, 2 run"),
            Port("valid", "Boolean", description="whether there is a good command"),
        )
        self._samples = SamplesPart(f"{name}.samples", self)

    @property
    def siblings(self) -> Mapping[str, SamplesPart]:
        """Parts that stand beside this one in the loop."""
        return {self._samples.name: self._samples}

    def start(
        self,
        run: RunContext,
        connected: Sequence[str],
        initialised: Sequence[bool],
        u: FloatArray,
        y: FloatArray,
    ) -> None:
        """Go on the bus; see `Part.start`."""
        self._y = y
        self._y[:] = 0.0
        address = address_of(self.keys)
        self.node = DeviceNode(
            self.database, self.keys.node, address, run.step, self.drift, self.faults, self.seed
        )
        self.node.open()

    def advance(self, t: float, h: float) -> None:
        """Put out what is applied; see `Part.advance`."""
        node = self.node
        assert node is not None
        self._y[:] = (*node.drive.volts, node.mode, node.is_commanded)

    def close(self) -> None:
        """Leave the bus."""
        if self.node is not None:
            self.node.close()

    def metadata(self) -> dict[str, Any]:
        """Bus, messages, faults."""
        return {
            "kind": "board",
            "file": self.database.path.name,
            "node": self.keys.node,
            "faults": [str(fault) for fault in self.faults],
            "seed": self.seed,
        }


class SamplesPart:
    """What a board samples, as the inputs of a part; what nothing drives is not available."""

    takes_by_name = True
    """An input that no wire drives is driven by the output of the same name, if there is one."""

    def __init__(self, name: str, board: BoardPart) -> None:
        self.name = name
        self._board = board
        self.seconds = math.inf
        sent = board.database.sent_by(board.keys.node)
        self.inputs: Sequence[Port] = [
            port_of(s) for m in sent if m.role in {"sample", "status"} for s in m.ports
        ]
        self.outputs: Sequence[Port] = ()

    def start(
        self,
        run: RunContext,
        connected: Sequence[str],
        initialised: Sequence[bool],
        u: FloatArray,
        y: FloatArray,
    ) -> None:
        """See `Part.start`."""
        self._u, self._driven = u, tuple(connected)

    def advance(self, t: float, h: float) -> None:
        """Send the sample; see `Part.advance`."""
        node = self._board.node
        assert node is not None
        node.transmit(dict(zip(self._driven, self._u.tolist(), strict=True)))

    def close(self) -> None:
        """Do nothing: the other part leaves the bus for both."""

    def metadata(self) -> dict[str, Any]:
        """Name the part that it belongs to."""
        return {"kind": "board", "file": self._board.database.path.name, "of": self._board.name}
