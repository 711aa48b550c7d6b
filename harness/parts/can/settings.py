"""Settings of parts on a bus."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from harness.can.database import Message, Signal
from harness.parts.ports import Port, unit_of

if TYPE_CHECKING:
    from harness.can.channel import Address

__all__ = ["Keys", "ports_of"]


class Keys(BaseModel):
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

    model_config = ConfigDict(extra="forbid", strict=True)

    can: str
    interface: str | None = None
    channel: str | None = None
    options: dict[str, Any] = {}
    node: str = "Loop"
    replaces: list[str] = []
    reconnect: Annotated[float, Field(ge=0.0)] = 10.0

    def address(self) -> Address:
        """Return the address of the bus."""
        from harness.can.channel import Address

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
