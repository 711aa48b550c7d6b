"""A node on a CAN bus: opening, receiving, sending, heartbeats."""

from __future__ import annotations

from typing import Any

from harness.can.channel import Address, CanChannel, now
from harness.can.database import Database
from harness.can.reception import Reception
from harness.can.transmission import SentMessage, sent_messages

__all__ = ["BusNode"]

_HEARTBEAT = 100_000  # us, until the other node is there


class BusNode:
    """What the nodes at both ends of a bus have in common.

    Attributes:
        database: of the bus.
        address: of the bus.
        reception: state of what comes in.
    """

    def __init__(
        self, database: Database, name: str, address: Address, step: float, reception: Reception
    ) -> None:
        """Get ready; `open` goes on the bus.

        Args:
            database: of the bus.
            name: of this node in it.
            address: of the bus.
            step: period of the samples [s].
            reception: state of what comes in.
        """
        self.database = database
        self.address = address
        self.reception = reception
        self._heartbeats = sent_messages(database, name, step, "heartbeat")
        self._next_heartbeat = 0
        self._channel: CanChannel | None = None

    def open(self) -> None:
        """Go on the bus.

        Raises:
            FaultError: it does not open.
        """
        self._channel = CanChannel(self.address, self.database)

    @property
    def channel(self) -> CanChannel:
        """The open channel."""
        assert self._channel is not None
        return self._channel

    def _receive_one(self, timeout: float) -> bool:
        """Receive and decode a frame; False if none comes in time [s]."""
        frame = self._next_frame(timeout)
        if frame is None:
            return False
        self.reception.receive(frame)
        return True

    def _next_frame(self, timeout: float) -> Any:
        """Return the next frame as it is; None if there is none in time [s]."""
        return self.channel.receive(timeout)

    def _receive_all(self) -> None:
        """Receive and decode what has arrived."""
        while self._receive_one(0.0):
            pass

    def _wait_with_heartbeat(self, state: int, timeout: float) -> None:
        """Receive a frame, if one comes in time [s], and send a heartbeat each 100 ms."""
        time = now()
        if time >= self._next_heartbeat:
            self._send_heartbeat(state)
            self._next_heartbeat = time + _HEARTBEAT
        self._receive_one(timeout)

    def _send_heartbeat(self, state: int) -> None:
        for heartbeat in self._heartbeats:
            self._send(heartbeat, heartbeat.frame([float(state)]))

    def close(self) -> None:
        """Leave the bus."""
        raise NotImplementedError

    def _send(self, sent: SentMessage, data: bytes) -> int | None:
        """Send a frame; return when it went [us], None if the bus did not take it."""
        raise NotImplementedError
