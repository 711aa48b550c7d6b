"""Tables of benchmarks, on the terminal and as a page, and the machine that they were taken on."""

from __future__ import annotations

import ast
import os
import platform
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from rich.table import Table as PrintedTable

from harness.bench.results import BenchResults, Measurement
from harness.bench.session import SUITE
from harness.report.figure_table import with_micro_sign
from harness.report.page import Table
from harness.report.terminal import printed

__all__ = ["console_tables", "machine", "write_page"]


def grid(lines: Sequence[Measurement]) -> Table:
    """Return one row for each thing measured, one column for each of its numbers."""
    columns = list(dict.fromkeys(line.column for line in lines))
    rows: dict[tuple[str, str], dict[str, Measurement]] = {}
    settings: dict[str, str] = {}
    for line in lines:
        # That of a ratio says what it is of, and so does its place.
        setting = "" if line.compared else line.setting
        setting = settings[line.row] = setting or settings.get(line.row, "")
        rows.setdefault((line.row, setting), {})[line.column] = line
    texts = []
    for (row, setting), found in rows.items():
        wanted = [f"{n} {f.wanted}".strip() for n, f in found.items() if f.wanted]
        cells = [_number(found[name]) if name in found else "" for name in columns]
        texts.append(tuple(map(with_micro_sign, (row, *cells, ", ".join(wanted), setting))))
    header = ("", *(name or "measured" for name in columns), "wanted", "setting")
    kept = [k for k in range(len(header)) if k <= len(columns) or any(text[k] for text in texts)]
    return Table(
        tuple(header[k] for k in kept),
        tuple(tuple(text[k] for k in kept) for text in texts),
        frozenset(range(1, len(columns) + 1)),
    )


def grids(group: str, results: BenchResults) -> Iterator[Table]:
    """Yield the tables of a group, one for each of its parts."""
    lines = [line for line in results.lines() if line.group == group]
    for part in dict.fromkeys(line.part for line in lines):
        yield grid([line for line in lines if line.part == part])


def console_tables(group: str, results: BenchResults) -> Iterator[PrintedTable]:
    """Yield the tables of a group for the terminal."""
    for found in grids(group, results):
        yield printed(replace(found, columns=(group, *found.columns[1:])))


def machine() -> str:
    """Return processor, cores, system, Python, and what else the machine was doing."""
    from pytest_benchmark.plugin import pytest_benchmark_generate_machine_info

    metadata = pytest_benchmark_generate_machine_info()
    cores = os.cpu_count() or 1
    load = f", load before {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return (
        f"{metadata['cpu'].get('brand_raw', 'unknown processor')}, "
        f"{cores} core{'s' * (cores > 1)}{load}; "
        f"{platform.system()} {platform.machine()}, {metadata['python_implementation']} "
        f"{metadata['python_version']}"
    )


def write_page(path: Path, groups: Sequence[str], results: BenchResults, where: str) -> Path:
    """Write the tables as Markdown, each with what its file of the suite says of it.

    Raises:
        SteadytipError: the file cannot be written.
    """
    from harness.common.files import write_text

    parts = [
        "# Speed",
        "Written by `steadytip bench --table FILE`; do not edit. Medians, if nothing else is said;"
        " of what is compared, samples are taken in turns and ratios are medians of theirs. Figures"
        " are those of the machine, and of what else it did: compare ratios.",
        f"Measured on: {where}.",
    ]
    for group in groups:
        title, _, text = _docstring(group).partition("\n\n")
        parts += [f"## {group}: {title.rstrip('.')}", *([text] if text else [])]
        parts += map(_markdown, grids(group, results))
        parts += [f"Skipped: {reason}." for reason in results.skipped.get(group, ())]
    return write_text(path, "\n\n".join(parts) + "\n")


def _docstring(group: str) -> str:
    """Return the docstring of a file of the suite."""
    tree = ast.parse((SUITE / f"{group}.py").read_text(encoding="utf-8"))
    return ast.get_docstring(tree) or group


def _markdown(found: Table) -> str:
    rule = ["---:" if k in found.numbers else "---" for k in range(len(found.columns))]
    return "\n".join(f"| {' | '.join(row)} |" for row in (found.columns, rule, *found.rows))


def _number(line: Measurement) -> str:
    """Return three digits and the unit."""
    value = line.value
    digits = f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return f"{digits} {line.unit}".strip()
