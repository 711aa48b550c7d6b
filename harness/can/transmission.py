"""Messages that a node sends: when each is due, and its frames with their counter."""

from __future__ import annotations

from collections.abc import Sequence

from harness.can.codec import Codec
from harness.can.database import Database, Message

__all__ = ["SentMessage", "sent_messages"]


class SentMessage:
    """One message that this node sends.

    Attributes:
        message: from the database.
        seconds: time that a frame takes on the bus [s].
        every: ticks from one frame to the next; 0: only when there is a reason.
    """

    def __init__(self, message: Message, database: Database, step: float) -> None:
        self.message = message
        self.seconds = database.seconds(message)
        self.every = max(1, round(message.cycle / step)) if message.cycle else 0
        self._encode = Codec(message).encode
        self._modulus = message.modulus or 1
        self._counter = -1

    def frame(self, values: Sequence[float]) -> bytes:
        """Return the next frame.

        Raises:
            FaultError: a value does not fit.
        """
        return self.numbered(values, self._counter + 1)

    def numbered(self, values: Sequence[float], number: int) -> bytes:
        """Return a frame whose counter is the remainder of a number."""
        self._counter = number % self._modulus
        return self._encode(values, self._counter)


def sent_messages(database: Database, node: str, step: float, *roles: str) -> list[SentMessage]:
    """Return the messages of a node that have one of some roles, role by role.

    Args:
        database: of the bus.
        node: its name.
        step: period of the ticks [s].
        roles: of messages, in the order in which they are sent.
    """
    sent = database.sent_by(node)
    return [SentMessage(m, database, step) for role in roles for m in sent if m.role == role]
