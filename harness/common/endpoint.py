"""Parse and write the name of a port of a part: `part.port`."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Endpoint"]


class Endpoint(NamedTuple):
    """A port of a part.

    The name of a part has no dot, so the first dot of the text ends it; the name of a port may have
    dots of its own, as `loop.body.frame[2]` has.

    Attributes:
        part: name of the part.
        port: name of the port; empty where the text has no dot.
    """

    part: str
    port: str

    @classmethod
    def parse(cls, text: str) -> Endpoint:
        """Return the endpoint that `text` names."""
        part, _, port = text.partition(".")
        return cls(part, port)

    def __str__(self) -> str:
        return f"{self.part}.{self.port}" if self.port else self.part
