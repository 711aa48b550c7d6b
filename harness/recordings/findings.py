"""Findings about recorded data: a name, a place, a size and a cure."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Literal

from fmu_src.errors import SteadytipError

__all__ = ["Finding", "FindingsError", "Severity", "refuse"]

Severity = Literal["note", "repaired", "stop"]


@dataclass(frozen=True)
class Finding:
    """A defect of a recording, or what looks like one.

    Attributes:
        name: of the kind of defect, as `--accept` takes it.
        severity: `stop` makes figures meaningless, `repaired` was put right, `note` is to know.
        where: place in the recording: line, time, column.
        text: what was found, with its size.
        cure: what to do about it.
    """

    name: str
    severity: Severity
    where: str
    text: str
    cure: str

    @property
    def sentence(self) -> str:
        """The finding in one line, with its name, its place and a cure."""
        return f"{self.name}: {self.text} ({self.where}). {self.cure}"


class FindingsError(SteadytipError):
    """The recording has defects that make figures meaningless.

    Attributes:
        findings: all of them.
    """

    def __init__(self, message: str, findings: tuple[Finding, ...]) -> None:
        super().__init__(message)
        self.findings = findings


def refuse(source: object, findings: Iterable[Finding], accepted: Collection[str] = ()) -> None:
    """Raise if a finding that stops the run was not accepted.

    Args:
        source: name of the recording, for the message.
        findings: all findings.
        accepted: names of findings to go on with.

    Raises:
        FindingsError: what was found, and how to go on all the same.
    """
    findings = tuple(findings)
    stopping = [f for f in findings if f.severity == "stop" and f.name not in accepted]
    if stopping:
        names = " ".join(f"--accept {name}" for name in dict.fromkeys(f.name for f in stopping))
        found = " ".join(f"{finding.sentence}." for finding in stopping)
        raise FindingsError(f"recording {source}: {found} To go on all the same: {names}", findings)
