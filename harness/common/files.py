"""Files that appear whole or not at all, and what the system says where they cannot."""

from __future__ import annotations

import os
from pathlib import Path

from fmu_src.errors import SteadytipError

__all__ = ["is_path", "reason", "replacing", "write_text"]


def is_path(value: str) -> bool:
    """Return whether a kind's value is a file; a bare word is a name, as in `fmu = "Hand"`.

    >>> is_path("Hand"), is_path("Hand.fmu"), is_path("fmus/Hand")
    (False, True, True)
    """
    return "/" in value or "\\" in value or bool(Path(value).suffix)


class replacing:  # noqa: N801 - reads as a verb in `with`
    """A name to write to: becomes the target when all went well, and vanishes otherwise."""

    def __init__(self, target: Path) -> None:
        self._target = target
        self._part = target.with_name(f"{target.name}.part")

    def __enter__(self) -> Path:
        return self._part

    def __exit__(self, kind: object, error: BaseException | None, _trace: object) -> None:
        if error is None:
            self._part.replace(self._target)
            return
        self._part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename = str(self._target)  # a failing write does not know where it was


def write_text(path: Path, text: str) -> Path:
    """Write a file that the user asked for, and its folder, all at once or not at all.

    Raises:
        SteadytipError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as part:
            part.write_text(text, encoding="utf-8")
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {reason(error)}") from None
    return path


def reason(error: OSError) -> str:
    """Return what the system says of an error; Arrow wraps it into words of its own."""
    return os.strerror(error.errno) if error.errno else str(error)
