"""What the commands `steadytip identify` have in common on the terminal."""

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
    """A bar with what is done and the time that it has taken; none if `quiet`."""
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
    """A page's table for the terminal."""
    found = Printed(box=None, pad_edge=False)
    for index, name in enumerate(table.columns):
        found.add_column(escape(name), justify="right" if index in table.numbers else "left")
    for row in table.rows:
        found.add_row(*map(escape, row))
    return found


def say(console: Console, text: str, style: str) -> None:
    """A line in a style, never folded."""
    console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)
