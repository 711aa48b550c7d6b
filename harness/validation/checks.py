"""Checks, and the two lists of them: on files, and on a running FMU.

A check is a generator. It yields a sentence for each problem, `Note`s for what is merely good to
know, and raises `Skip` where it does not apply. Its id is the item of the checklist and a word,
`D1.name_null`. This module imports nothing heavy: every process of a probe loads it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

__all__ = [
    "FILES",
    "ITEMS",
    "PROBES",
    "Check",
    "CheckOutcome",
    "Failure",
    "Level",
    "Note",
    "Registry",
    "Skip",
]

Level = Literal["error", "warning", "info"]
"""error: the standard is broken, or a host would crash, hang or compute wrongly. warning: some
importer or some host is known to stumble, though the standard does not demand it. info: figures."""

ITEMS = {
    "A1": "archive",
    "A2": "names in the archive",
    "A3": "description, icon, documents",
    "A4": "binaries",
    "A5": "sources",
    "A6": "lengths",
    "A7": "extra/, reference results",
    "B1": "exported functions",
    "B2": "dependencies, machine",
    "B3": "version",
    "B4": "loading and unloading",
    "B5": "the process around it",
    "C1": "schema and rules",
    "C2": "identity",
    "C3": "capabilities",
    "C4": "units",
    "C5": "types",
    "C6": "log categories",
    "C7": "default experiment",
    "C8": "variable names",
    "C9": "causality, variability, initial, start",
    "C10": "limits and start values",
    "C11": "aliases",
    "C12": "model structure",
    "C13": "descriptions",
    "D1": "instantiation",
    "D2": "copies of its arguments",
    "D3": "resource URIs",
    "D4": "messages",
    "D5": "state machine",
    "D6": "get and set",
    "D7": "values",
    "D8": "steps",
    "D9": "status",
    "D10": "fixed and tunable parameters",
    "D11": "saved states",
    "D12": "reset",
    "D13": "free and terminate",
    "D14": "several instances",
    "D15": "memory over many lives",
    "D17": "cost",
}
"""What the items of the checklist are about, in their order."""

_MOST_PROBLEMS = 5
"""Sentences of one check that are shown; the rest is counted."""


class Note(str):
    """Something found that is no problem."""


class Skip(Exception):  # noqa: N818 - no error
    """The check does not apply here; says why."""


class Failure(Exception):  # noqa: N818 - a result
    """The FMU did something after which the check cannot go on; becomes a problem."""


@dataclass(frozen=True)
class Check:
    """One thing that is looked at.

    Attributes:
        id: item of the checklist, a dot, a word.
        level: what a problem that it finds amounts to.
        title: what should be so.
        body: generator of problems and notes.
    """

    id: str
    level: Level
    title: str
    body: Callable[[Any], Iterator[str]]

    def run(self, subject: Any) -> CheckOutcome:
        """Carry it out in this process."""
        problems: list[str] = []
        notes: list[str] = []
        skipped = None
        try:
            for text in self.body(subject):
                (notes if isinstance(text, Note) else problems).append(str(text))
        except Skip as skip:
            skipped = str(skip)
        except Failure as failure:
            problems.append(str(failure))
        return self.outcome(problems, notes, skipped)

    def outcome(
        self,
        problems: list[str],
        notes: list[str] | None = None,
        skipped: str | None = None,
        level: Level | None = None,
        seconds: float = 0.0,
    ) -> CheckOutcome:
        """Return the result of this check, each problem once, long lists shortened."""
        problems = list(dict.fromkeys(problems))
        more = len(problems) - _MOST_PROBLEMS
        if more > 1:
            problems = [*problems[:_MOST_PROBLEMS], f"and {more} more of this kind"]
        return CheckOutcome(
            id=self.id,
            title=self.title,
            level=level or self.level,
            problems=tuple(problems),
            notes=tuple(notes or ()),
            skipped=skipped if not problems else None,
            seconds=seconds,
        )


@dataclass(frozen=True)
class CheckOutcome:
    """Result of one check.

    Attributes:
        id: of the check.
        title: of the check.
        level: what its problems amount to.
        problems: one sentence each; empty if all is well.
        notes: what is good to know.
        skipped: why it did not apply; None if it did.
        seconds: that it took [s].
    """

    id: str
    title: str
    level: Level
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    skipped: str | None = None
    seconds: float = 0.0

    @property
    def item(self) -> str:
        """Item of the checklist, `D1`."""
        return self.id.partition(".")[0]

    @property
    def verdict(self) -> str:
        """`ok`, `skipped`, or the level of what was found."""
        if self.problems:
            return self.level
        return "skipped" if self.skipped is not None else "ok"


class Registry(dict[str, Check]):
    """Checks by id, in the order in which they were declared."""

    def check(
        self, id: str, level: Level, title: str
    ) -> Callable[[Callable[..., Iterator[str]]], Callable[..., Iterator[str]]]:
        """Return a decorator that declares a check."""
        assert id.partition(".")[0] in ITEMS, id

        def declare(body: Callable[..., Iterator[str]]) -> Callable[..., Iterator[str]]:
            assert id not in self, id
            self[id] = Check(id, level, title, body)
            return body

        return declare


FILES = Registry()
"""Checks of the archive, the description and the binaries as files; subject: `files.Fmu`."""
PROBES = Registry()
"""Checks of the running FMU; subject: `probes.host.Host`."""
