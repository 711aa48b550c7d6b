"""What the parts at both ends of a bus have in common.

What comes in are the outputs of the part on the bus; what goes out are the inputs of its sibling.
Both have one node. It is made by whoever knows how the run keeps to the wall clock; until then the
parts have their ports only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

from harness.can.bus_node import BusNode
from harness.can.database import Database
from harness.common.errors import FaultError
from harness.common.types import FloatArray
from harness.parts.ports import Port
from harness.parts.protocols import Part, RunContext
from harness.parts.settings import CanSettings

__all__ = ["BusPart", "BusSibling"]

NodeT = TypeVar("NodeT", bound=BusNode)


class _OnBus(Generic[NodeT]):
    """A part that uses a node."""

    kind: str
    inputs: Sequence[Port] = ()
    outputs: Sequence[Port] = ()
    seconds = math.inf

    def __init__(
        self, name: str, keys: CanSettings, database: Database, node: NodeT | None
    ) -> None:
        self.name = name
        self.keys = keys
        self.database = database
        self._node = node

    @property
    def node(self) -> NodeT:
        """At this end of the bus.

        Raises:
            FaultError: the part is not on the bus.
        """
        if self._node is None:
            raise FaultError("is on a CAN bus, which keeps to the wall clock: steadytip hil")
        return self._node

    def start(
        self,
        run: RunContext,
        connected: Sequence[str],
        initialised: Sequence[bool],
        u: FloatArray,
        y: FloatArray,
    ) -> None:
        """Take inputs and outputs over; see `Part.start`."""
        self._u, self._y, self._connected = u, y, tuple(connected)
        self._y[:] = 0.0
        self._prepare()

    def _prepare(self) -> None:
        """Do what else has to be done before the first tick."""

    def close(self) -> None:
        """Do nothing: one part leaves the bus for all."""

    def metadata(self) -> dict[str, Any]:
        """Kind of the part and file of its messages."""
        return {"kind": self.kind, "file": self.database.path.name}


class BusSibling(_OnBus[NodeT]):
    """The part whose inputs go out on the bus."""

    def __init__(self, owner: BusPart[NodeT], name: str) -> None:
        super().__init__(f"{owner.name}.{name}", owner.keys, owner.database, owner._node)
        self.kind = owner.kind
        self._owner = owner.name

    def metadata(self) -> dict[str, Any]:
        """Name the part that it belongs to."""
        return {**super().metadata(), "of": self._owner}


class BusPart(_OnBus[NodeT]):
    """The part whose outputs come in from the bus; see `harness.parts.protocols.OnBus`."""

    takes_by_name = False
    siblings: Mapping[str, Part]

    def on_bus(self, node: NodeT) -> dict[str, Part]:
        """Return this part and its siblings with a node, ready to start."""
        part = type(self)(self.name, self.keys, self.database, node)
        return {part.name: part, **part.siblings}  # type: ignore[dict-item]

    def _prepare(self) -> None:
        """Go on the bus."""
        self.node.open()

    def close(self) -> None:
        """Leave the bus."""
        if self._node is not None:
            self._node.close()

    def metadata(self) -> dict[str, Any]:
        """Kind, file, and node of this end."""
        return {**super().metadata(), "node": self.keys.node}
