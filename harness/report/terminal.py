"""Progress bars, tables and lines on the terminal, for commands that write pages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table as Printed

if TYPE_CHECKING:
    from rich.progress import Progress

    from harness.report.page import Table

__all__ = ["bar", "printed", "say"]


def bar(console: Console, quiet: bool) -> Progress:
    """Return a bar with what is done and the time that it has taken; none if `quiet`."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=quiet,
    )


def printed(table: Table) -> Printed:
    """Return a page's table for the terminal."""
    found = Printed(box=None, pad_edge=False)
    for index, name in enumerate(table.columns):
        number = index in table.numbers
        found.add_column(escape(name), justify="right" if number else "left", no_wrap=number)
    for row in table.rows:
        found.add_row(*map(escape, row))
    return found


def say(console: Console, text: str, style: str, fold: bool = False) -> None:
    """Print a line in a style; it is cut into several only if `fold`."""
    console.print(text, style=style, markup=False, highlight=False, soft_wrap=not fold)
