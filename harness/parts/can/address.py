"""The bus and the ports that the settings of a part name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from harness.can.database import Message, Signal
from harness.parts.ports import Port, unit_of
from harness.parts.settings import CanSettings

if TYPE_CHECKING:
    from harness.can.channel import Address

__all__ = ["address_of", "ports_of"]


def address_of(settings: CanSettings) -> Address:
    """Return the address of the bus of a part."""
    from harness.can.channel import Address

    return Address(settings.interface, settings.channel, settings.options, settings.reconnect)


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
