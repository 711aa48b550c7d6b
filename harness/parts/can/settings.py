"""Settings of parts on a bus."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import Field

from harness.can.channel import Address
from harness.can.database import Message, Signal
from harness.common.strict_model import StrictModel
from harness.parts.ports import Port, unit_of

__all__ = ["Keys", "ports_of"]


class Keys(StrictModel):
    """Settings of a part on a bus.

    Attributes:
        can: path of a DBC file, or name of a shipped one.
        interface: of python-can; as its own configuration has it, if left out.
        channel: of that interface, likewise.
        options: all else that the interface takes, `{ bitrate = 1000000 }`.
        node: who this end of the bus is, in the DBC file.
        replaces: parts that are at the other end as well; names, or patterns with `*`.
        reconnect: how long an unplugged bus is waited for [s].
    """

    can: str
    interface: str | None = None
    channel: str | None = None
    options: dict[str, Any] = Field(default_factory=dict)
    node: str = "Loop"
    replaces: list[str] = Field(default_factory=list)
    reconnect: Annotated[float, Field(ge=0.0)] = 10.0

    def address(self) -> Address:
        """Return the address of the bus."""
        return Address(self.interface, self.channel, self.options, self.reconnect)


def _port_of(signal: Signal) -> Port:
    """Return a signal as a port."""
    if signal.length == 1:
        return Port(signal.name, "Boolean", description=signal.description)
    if signal.is_whole:
        return Port(signal.name, "Integer", description=signal.description)
    return Port(signal.name, "Real", unit_of(signal.unit or "1"), signal.description)


def ports_of(messages: Iterable[Message], *roles: str) -> list[Port]:
    """Return the signals of messages as ports; of those with one of `roles`, if any are given."""
    return [_port_of(s) for m in messages if not roles or m.role in roles for s in m.ports]
