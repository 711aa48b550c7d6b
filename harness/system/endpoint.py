"""Names of the ends of wires."""

from __future__ import annotations

from collections.abc import Mapping

from harness.parts.protocols import Part

__all__ = ["split"]


def split(text: str, parts: Mapping[str, Part]) -> tuple[str, str] | None:
    """Part and port of `part.port`; None if it starts with no part's name.

    Port names may hold dots and so may the names of parts that were brought along, so the longest
    name that fits is taken.
    """
    fitting = [name for name in parts if text.startswith(f"{name}.")]
    if not fitting:
        return None
    name = max(fitting, key=len)
    return name, text[len(name) + 1 :]
