"""Tables of benchmarks, on the terminal and as a page, and the machine that they were taken on."""

from __future__ import annotations

import ast
import os
import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from harness.bench.results import Book, Line
from harness.bench.session import SUITE
from harness.reproduce.engine import for_people

__all__ = ["console_tables", "machine", "write_page"]


@dataclass(frozen=True)
class Grid:
    """Numbers of a group as people read them.

    Attributes:
        header: of the columns.
        numbers: how many columns of numbers follow the first.
        rows: of texts.
    """

    header: tuple[str, ...]
    numbers: int
    rows: list[tuple[str, ...]]


def grid(lines: Sequence[Line]) -> Grid:
    """One row for what was measured, one column for what of it."""
    columns = list(dict.fromkeys(line.column for line in lines))
    rows: dict[tuple[str, str], dict[str, Line]] = {}
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
        texts.append(tuple(map(for_people, (row, *cells, ", ".join(wanted), setting))))
    header = ("", *(name or "measured" for name in columns), "wanted", "setting")
    kept = [k for k in range(len(header)) if k <= len(columns) or any(text[k] for text in texts)]
    return Grid(
        header=tuple(header[k] for k in kept),
        numbers=len(columns),
        rows=[tuple(text[k] for k in kept) for text in texts],
    )


def grids(group: str, book: Book) -> Iterator[Grid]:
    """Of a group, one for each of its parts."""
    lines = [line for line in book.lines() if line.group == group]
    for part in dict.fromkeys(line.part for line in lines):
        yield grid([line for line in lines if line.part == part])


def console_tables(group: str, book: Book) -> Iterator[Table]:
    """Of a group, for the terminal."""
    for found in grids(group, book):
        table = Table(box=None, pad_edge=False)
        for index, name in enumerate(found.header):
            number = 0 < index <= found.numbers
            table.add_column(name or group, justify="right" if number else "left", overflow="fold")
        for row in found.rows:
            table.add_row(*map(escape, row))
        yield table


def machine() -> str:
    """Processor, cores, system, Python, and what else the machine was doing."""
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


def write_page(path: Path, groups: Sequence[str], book: Book, where: str) -> Path:
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
        title, _, text = _told(group).partition("\n\n")
        parts += [f"## {group}: {title.rstrip('.')}", *([text] if text else [])]
        parts += map(_markdown, grids(group, book))
        parts += [f"Skipped: {reason}." for reason in book.skipped.get(group, ())]
    return write_text(path, "\n\n".join(parts) + "\n")


def _told(group: str) -> str:
    """What a file of the suite says of itself."""
    tree = ast.parse((SUITE / f"{group}.py").read_text(encoding="utf-8"))
    return ast.get_docstring(tree) or group


def _markdown(found: Grid) -> str:
    rule = ["---:" if 0 < k <= found.numbers else "---" for k in range(len(found.header))]
    rows = [found.header, rule, *found.rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _number(line: Line) -> str:
    """Three digits and the unit."""
    value = line.value
    digits = f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return f"{digits} {line.unit}".strip()
