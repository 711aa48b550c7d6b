"""Results of checks for people (a table), for programs (JSON), and for CI (JUnit XML)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from harness.common import junit
from harness.common.junit import JunitCase, JunitSuite
from harness.validation.checks import ITEMS, CheckOutcome
from harness.validation.validate import Validation

__all__ = ["table", "write_json", "write_junit"]

_COLOURS = {"error": "red", "warning": "yellow", "info": "cyan", "ok": "green", "skipped": "dim"}
"""Colours of results, the worst first."""


def table(validation: Validation) -> Group:
    """Return a row for each item of the checklist, and a line with the sums.

    Of the checks of an item, those are named that are not simply well.
    """
    rows = Table("item", "about", "verdict", "what")
    for item, group in groupby(validation.outcomes, lambda outcome: outcome.item):
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
    counts = validation.counts
    sums = ", ".join(f"{counts[key]} {key}" for key in _COLOURS if counts[key])
    colour = "green" if validation.good else "red"
    return Group(rows, f"[{colour}]{escape(validation.path.name)}: {sums}[/{colour}]")


def write_json(path: Path, validations: Sequence[Validation]) -> None:
    """Write a list of objects, one for each FMU, with all outcomes."""
    content = [
        {
            "fmu": str(validation.path),
            "counts": dict(validation.counts),
            "checks": [asdict(o) | {"verdict": o.verdict} for o in validation.outcomes],
        }
        for validation in validations
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def write_junit(path: Path, validations: Sequence[Validation]) -> None:
    """Write a test suite for each FMU, a test case for each check.

    Errors are failures; warnings and notes are in the output of their case, as JUnit knows none.
    """
    suites = [
        JunitSuite(v.path.name, tuple(_case(v, outcome) for outcome in v.outcomes))
        for v in validations
    ]
    junit.write_junit(path, "steadytip validate", suites)


def _case(validation: Validation, outcome: CheckOutcome) -> JunitCase:
    problems = "\n".join(outcome.problems)
    failed = outcome.verdict == "error"
    texts = [f"{outcome.level}: {problems}"] * bool(problems and not failed)
    return JunitCase(
        group=f"{validation.path.stem}.{outcome.item}",
        name=f"{outcome.id} {outcome.title}",
        seconds=outcome.seconds,
        failure=problems if failed else "",
        skipped=(outcome.skipped or "") if outcome.verdict == "skipped" else None,
        output="\n".join([*texts, *outcome.notes]),
    )
