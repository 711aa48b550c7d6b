"""Results of checks as JUnit XML, which CI and test rigs read."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from harness.common.files import write_text

__all__ = ["JunitCase", "JunitSuite", "write_junit"]

_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML cannot hold."""


@dataclass(frozen=True)
class JunitCase:
    """One thing that was checked.

    Attributes:
        group: what it belongs to; JUnit calls it the class.
        name: what was checked.
        seconds: time that it took [s].
        failure: what is wrong, the first line in short; empty if nothing is.
        skipped: why it was not checked; None if it was.
        output: what else there is to say.
    """

    group: str
    name: str
    seconds: float = 0.0
    failure: str = ""
    skipped: str | None = None
    output: str = ""


@dataclass(frozen=True)
class JunitSuite:
    """Cases that belong to one thing."""

    name: str
    cases: tuple[JunitCase, ...]


def write_junit(path: Path, name: str, suites: Iterable[JunitSuite]) -> Path:
    """Write suites of cases.

    Args:
        path: file to write.
        name: of all of them.
        suites: in their order.

    Raises:
        SteadytipError: the file cannot be written.
    """
    root = ElementTree.Element("testsuites", name=_clean(name))
    for suite in suites:
        element = ElementTree.SubElement(
            root,
            "testsuite",
            name=_clean(suite.name),
            tests=str(len(suite.cases)),
            failures=str(sum(bool(case.failure) for case in suite.cases)),
            errors="0",
            skipped=str(sum(case.skipped is not None for case in suite.cases)),
            time=f"{sum(case.seconds for case in suite.cases):.3f}",
        )
        for case in suite.cases:
            _write_case(element, case)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return write_text(path, f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n')


def _write_case(suite: ElementTree.Element, case: JunitCase) -> None:
    element = ElementTree.SubElement(
        suite,
        "testcase",
        classname=_clean(case.group),
        name=_clean(case.name),
        time=f"{case.seconds:.3f}",
    )
    if case.failure:
        failure = _clean(case.failure)
        child = ElementTree.SubElement(element, "failure", message=failure.partition("\n")[0])
        child.text = failure
    elif case.skipped is not None:
        ElementTree.SubElement(element, "skipped", message=_clean(case.skipped))
    if case.output:
        ElementTree.SubElement(element, "system-out").text = _clean(case.output)


def _clean(text: str) -> str:
    return _FORBIDDEN.sub("\N{REPLACEMENT CHARACTER}", text)
