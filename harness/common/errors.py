"""What goes wrong at the edges of a run, in words for the person at the keyboard.

Everything here is a `fmu_src.kit.SteadytipError`: the command line prints its text alone.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

from fmu_src.errors import SteadytipError

__all__ = [
    "FaultError",
    "PartError",
    "ProblemsError",
    "RecordError",
    "RunError",
    "SteadytipError",
    "StoppedError",
    "nearest",
]


class ProblemsError(SteadytipError):
    """Several mistakes found in one place, all shown at once.

    Attributes:
        where: file or thing that holds them.
        problems: one sentence each.
    """

    def __init__(self, where: str, problems: Iterable[str]) -> None:
        self.where = where
        self.problems = tuple(problems)
        if len(self.problems) == 1:
            text = f"{where}: {self.problems[0]}"
        else:
            text = "\n  - ".join((f"{where}: {len(self.problems)} problems", *self.problems))
        super().__init__(text)


class FaultError(SteadytipError):
    """A part says what went wrong inside it; the loop adds which part it was, and when."""


class RunError(SteadytipError):
    """A run ended early, in order. What was recorded until then is kept.

    Attributes:
        result: the run as far as it went, a `steadytip.Result`; None when it never reached its
            first tick.
    """

    result: Any = None


class PartError(RunError):
    """A part ended the run.

    Attributes:
        part: its name.
        time: simulated time [s].
    """

    def __init__(self, part: str, time: float, text: str) -> None:
        self.part = part
        self.time = time
        super().__init__(text)


class RecordError(RunError):
    """The record could not be written any further."""


class StoppedError(RunError):
    """The user stopped the run."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Hint at the known name closest to a mistyped one, else at all of them.

    >>> nearest("secnods", ["seconds", "step"])
    "did you mean 'seconds'?"
    >>> nearest("x", ["seconds", "step"])
    'known: seconds, step'
    """
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1)
    if close:
        return f"did you mean '{close[0]}'?"
    return f"known: {', '.join(names)}" if names else "none is known here"
