"""The bus and the ports that the settings of a part name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.can.database import Signal
from harness.parts.ports import Port, unit_of
from harness.parts.settings import CanSettings

if TYPE_CHECKING:
    from harness.can.channel import Address

__all__ = ["address_of", "port_of"]


def address_of(settings: CanSettings) -> Address:
    """Return the address of the bus of a part."""
    from harness.can.channel import Address

    return Address(settings.interface, settings.channel, settings.options, settings.reconnect)


def port_of(signal: Signal) -> Port:
    """Return a signal as a port."""
    if signal.length == 1:
        return Port(signal.name, "Boolean", description=signal.description)
    if signal.is_whole:
        return Port(signal.name, "Integer", description=signal.description)
    return Port(signal.name, "Real", unit_of(signal.unit or "1"), signal.description)
