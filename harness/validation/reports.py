"""Verdicts for people (a table), for programs (JSON), and for CI (JUnit XML)."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from xml.etree import ElementTree

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from harness.validation.checks import ITEMS, Outcome
from harness.validation.verdict import Verdict

__all__ = ["table", "write_json", "write_junit"]

_COLOURS = {"error": "red", "warning": "yellow", "info": "cyan", "ok": "green", "skipped": "dim"}
"""Of verdicts, the worst first."""
_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML cannot hold."""


def table(verdict: Verdict) -> Group:
    """A row for each item of the checklist, and a line with the sums.

    Of the checks of an item, those are named that are not simply well.
    """
    rows = Table("item", "about", "verdict", "what")
    for item, group in groupby(verdict.outcomes, lambda outcome: outcome.item):
        outcomes = list(group)
        worst = min((o.verdict for o in outcomes), key=list(_COLOURS).index)
        lines = [f"{sum(o.verdict == 'ok' for o in outcomes)} of {len(outcomes)} checks well"]
        for outcome in outcomes:
            if outcome.problems:
                lines.append(f"{outcome.verdict} {outcome.id}: {outcome.title}")
            lines += [f"  {text}" for text in outcome.problems or outcome.notes]
        skipped = dict.fromkeys(o.skipped for o in outcomes if o.skipped is not None)
        lines += [f"  skipped: {reason}" for reason in skipped]
        colour = _COLOURS[worst]
        shown = f"[{colour}]{worst}[/{colour}]"
        rows.add_row(item, ITEMS[item], shown, escape("\n".join(lines)))
    counts = verdict.counts
    sums = ", ".join(f"{counts[key]} {key}" for key in _COLOURS if counts[key])
    colour = "green" if verdict.good else "red"
    return Group(rows, f"[{colour}]{escape(verdict.path.name)}: {sums}[/{colour}]")


def write_json(path: Path, verdicts: Sequence[Verdict]) -> None:
    """A list of objects, one for each FMU, with all outcomes."""
    content = [
        {
            "fmu": str(verdict.path),
            "counts": dict(verdict.counts),
            "checks": [asdict(o) | {"verdict": o.verdict} for o in verdict.outcomes],
        }
        for verdict in verdicts
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def write_junit(path: Path, verdicts: Sequence[Verdict]) -> None:
    """A test suite for each FMU, a test case for each check.

    Errors are failures; warnings and notes are in the output of their case, as JUnit knows none.
    """
    suites = ElementTree.Element("testsuites", name="steadytip validate")
    for verdict in verdicts:
        suite = ElementTree.SubElement(
            suites,
            "testsuite",
            name=_clean(verdict.path.name),
            tests=str(len(verdict.outcomes)),
            failures=str(verdict.counts["error"]),
            errors="0",
            skipped=str(verdict.counts["skipped"]),
            time=f"{sum(outcome.seconds for outcome in verdict.outcomes):.3f}",
        )
        for outcome in verdict.outcomes:
            _case(suite, verdict, outcome)
    ElementTree.indent(suites)
    path.parent.mkdir(parents=True, exist_ok=True)
    ElementTree.ElementTree(suites).write(path, encoding="utf-8", xml_declaration=True)


def _case(suite: ElementTree.Element, verdict: Verdict, outcome: Outcome) -> None:
    case = ElementTree.SubElement(
        suite,
        "testcase",
        classname=_clean(f"{verdict.path.stem}.{outcome.item}"),
        name=f"{outcome.id} {outcome.title}",
        time=f"{outcome.seconds:.3f}",
    )
    problems = _clean("\n".join(outcome.problems))
    if outcome.verdict == "error":
        failure = ElementTree.SubElement(case, "failure", message=problems.partition("\n")[0])
        failure.text = problems
    elif outcome.verdict == "skipped":
        ElementTree.SubElement(case, "skipped", message=_clean(outcome.skipped or ""))
    texts = [] if outcome.verdict == "error" else [f"{outcome.level}: {problems}"] * bool(problems)
    texts += [_clean(note) for note in outcome.notes]
    if texts:
        ElementTree.SubElement(case, "system-out").text = "\n".join(texts)


def _clean(text: str) -> str:
    return _FORBIDDEN.sub("\N{REPLACEMENT CHARACTER}", text)
