"""A python-can bus whose failures are states and not exceptions.

| state | how it comes about | what is done |
| --- | --- | --- |
| `OPEN` | | |
| `BUS_OFF` | an error frame or the driver says so | silent for 100 ms, begin anew; three times |
| `UNPLUGGED` | reading or writing fails: unplugged | try each 100 ms until `reconnect_timeout` |
| `FAILED` | all of that in vain | nothing any more |

Times are microseconds of the real-time clock, carried on by the monotonic one, so that setting the
clock disturbs nothing.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from fmu_src.errors import SteadytipError
from harness.can.database import Database
from harness.common.errors import FaultError

__all__ = ["Address", "CanChannel", "ChannelState", "now"]

RETRY = 100_000  # us between two tries to begin anew
TRIES = 3
"""Times that a controller may go off the bus before it has failed."""
_TRUSTED = 500_000  # us; an older stamp, or one from ahead, is by another clock

_base = time.time_ns() - time.monotonic_ns()


def now() -> int:
    """Time of this machine [us]."""
    return (_base + time.monotonic_ns()) // 1000


class ChannelState(IntEnum):
    """Of a CAN channel."""

    OPEN = 0
    BUS_OFF = 1
    UNPLUGGED = 2
    FAILED = 3


@dataclass(frozen=True)
class Address:
    """How python-can finds a bus.

    Attributes:
        interface: of python-can; None: as its own configuration has it.
        channel: of the interface; None: as its own configuration has it.
        options: all else that the interface takes.
        reconnect_timeout: how long an unplugged bus is waited for [s].
    """

    interface: str | None
    channel: str | None
    options: Mapping[str, Any] = field(default_factory=dict)
    reconnect_timeout: float = 10.0

    def __str__(self) -> str:
        return (
            f"{self.interface or 'the configured interface'}, channel {self.channel or 'default'}"
        )


class CanChannel:
    """An open bus.

    Attributes:
        state: see the module's table.
        reason: why it is not open, in words.
    """

    def __init__(self, address: Address, database: Database) -> None:
        """Open the bus.

        Raises:
            FaultError: python-can is not there, does not know the interface, or cannot open it.
        """
        try:
            import can

            from harness.can import transport
        except ImportError:
            raise FaultError(
                "boards on a CAN bus need python-can: pip install 'steadytip[hil]'"
            ) from None
        self._can, self._transport = can, transport
        self._address = address
        self._options: dict[str, Any] = dict(address.options)
        if database.is_fd:
            self._options.setdefault("fd", True)
        self.state = ChannelState.OPEN
        self.reason = ""
        self.bus_offs = 0
        self._since = 0
        self._next_try = 0
        self._bus = self._open()

    def _is_shut(self) -> bool:
        return self.state is not ChannelState.OPEN

    def _open(self) -> Any:
        can, address = self._can, self._address
        named = {"interface": address.interface, "channel": address.channel}
        try:
            return can.Bus(**{k: v for k, v in named.items() if v}, **self._options)
        except (
            can.CanError,
            OSError,
            ValueError,
            TypeError,
            ImportError,
            NotImplementedError,
        ) as e:
            raise FaultError(
                f"the CAN bus ({address}) does not open: {type(e).__name__}: {e}. Is the adapter "
                "there, its driver installed, and does python-can find it by the same names?"
            ) from None

    def receive(self, timeout: float) -> Any:
        """Return the next `can.Message`, its time in `timestamp` [us]; None if there is none.

        Args:
            timeout: how long to wait for it [s].
        """
        if self._is_shut():
            self._restore()
            if self._is_shut():
                time.sleep(min(max(timeout, 0.0), 1e-3))
                return None
        try:
            message = self._bus.recv(timeout)
        except (self._can.CanError, OSError) as error:
            self._leave(ChannelState.UNPLUGGED, f"reading failed: {error}")
            return None
        if message is None:
            return None
        stamp, time_now = round(message.timestamp * 1e6), now()
        message.timestamp = stamp if 0 <= time_now - stamp < _TRUSTED else time_now
        if self._transport.is_bus_off(message):
            self._leave(ChannelState.BUS_OFF, "the controller is off the bus")
            return None
        return message

    def send(self, id: int, data: bytes, is_fd: bool, extended: bool = False) -> Any:
        """Send a frame.

        Returns:
            The message as it was sent; None if the bus does not take it.
        """
        if self.state is not ChannelState.OPEN:
            return None
        message = self._can.Message(
            arbitration_id=id,
            is_extended_id=extended,
            data=data,
            is_fd=is_fd,
            bitrate_switch=is_fd,
            is_rx=False,
        )
        try:
            self._bus.send(message)
        except (self._can.CanError, OSError) as error:
            self._leave(ChannelState.UNPLUGGED, f"writing failed: {error}")
            return None
        return message

    def tick(self) -> None:
        """Look how the controller is, where its driver tells without being asked by a frame."""
        if self.state is ChannelState.OPEN and self._bus.state is self._can.BusState.ERROR:
            self._leave(ChannelState.BUS_OFF, "the controller is off the bus")

    def declare_bus_off(self) -> None:
        """Send the error frame with which a controller says that it leaves the bus."""
        with contextlib.suppress(self._can.CanError, OSError):
            self._bus.send(self._transport.bus_off_frame())

    def unplug(self, seconds: float) -> None:
        """Leave the bus as if the plug was pulled, and come back later [s]."""
        self.close()
        self._leave(ChannelState.UNPLUGGED, "unplugged")
        self._next_try = self._since + round(seconds * 1e6)

    def recovered(self) -> None:
        """Count restarts anew after a whole sample."""
        self.bus_offs = 0

    def _leave(self, state: ChannelState, reason: str) -> None:
        self.state, self.reason = state, reason
        self._since = now()
        self._next_try = self._since + RETRY
        if state is ChannelState.BUS_OFF:
            self.bus_offs += 1
            if self.bus_offs > TRIES:
                self.state = ChannelState.FAILED
                self.reason = f"off the bus again after {TRIES} restarts without a whole sample"

    def _restore(self) -> None:
        time_now = now()
        if self.state is ChannelState.FAILED or time_now < self._next_try:
            return
        self._next_try = time_now + RETRY
        if self._came_back():
            self.state = ChannelState.OPEN
        elif time_now - self._since > self._address.reconnect_timeout * 1e6:
            self.reason += (
                f", and it did not come back within {self._address.reconnect_timeout:g} s"
            )
            self.state = ChannelState.FAILED

    def _came_back(self) -> bool:
        try:
            reconnect = getattr(self._bus, "reconnect", None)
            if reconnect is not None and reconnect():
                return True
            self._bus.shutdown()
            self._bus = self._open()
        except (self._can.CanError, OSError, SteadytipError):
            return False
        return True

    def close(self) -> None:
        """Leave the bus."""
        with contextlib.suppress(self._can.CanError, OSError):
            self._bus.shutdown()
