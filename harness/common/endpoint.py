"""Read and write the name of a port of a part: `part.port`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

__all__ = ["Endpoint"]


class Endpoint(NamedTuple):
    """A port of a part.

    Attributes:
        part: name of the part.
        port: name of the port.
    """

    part: str
    port: str

    @classmethod
    def find(cls, text: str, parts: Iterable[str]) -> Endpoint | None:
        """Return the endpoint that `text` names; None if it begins with no part's name.

        Names of ports have dots, as `frame.x` of imported FMUs, and so have those of sibling parts,
        as `hand.motion`: the longest name of a part that fits is taken.
        """
        fitting = [name for name in parts if text.startswith(f"{name}.")]
        if not fitting:
            return None
        part = max(fitting, key=len)
        return cls(part, text[len(part) + 1 :])

    def __str__(self) -> str:
        return f"{self.part}.{self.port}"
