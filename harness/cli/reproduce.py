"""The command `steadytip reproduce`; as in `harness.cli.main`, it imports what it needs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Column, Table

from harness.cli.options import console

if TYPE_CHECKING:
    from harness.reproduce.engine import Done
    from harness.reproduce.item import Item


def reproduce(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="ITEM",
            help="Tables and figures (table-7.1, or 7.1), groups of them (hysteresis), papers"
            " (A04), or all; without any, a list of what there is.",
        ),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write all numbers as a JSON list.", dir_okay=False),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the page.")] = Path(
        "build", "reproduce"
    ),
    data: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            envvar="STEADYTIP_DATA",
            help="Folder of recordings; items that need some are skipped without it.",
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Measure the papers' tables and figures again, and print both numbers side by side."""
    from harness.reproduce.catalogue import chosen, items

    known = items()
    if not names:
        console.print(_list(known))
        return

    from harness.common.errors import ProblemsError, SteadytipError

    wanted = chosen(names, known)
    if data is not None and not data.is_dir():
        raise SteadytipError(f"--data {data}: there is no such folder")
    # Skipping is for what a group or `all` brings along, not for the only thing asked for.
    missing = {item.name: item.missing(data) for item in wanted}
    if all(missing.values()):
        raise ProblemsError("reproduce", [f"{name} {text}" for name, text in missing.items()])

    from harness.reproduce.engine import run_items, write_json, write_page

    done: list[Done] = []
    with _progress(len(wanted), quiet) as update:
        for one in run_items(wanted, data, update):
            done.append(one)
            if not quiet:
                _show(one)
    page = write_page(out, done)
    if json is not None:
        write_json(json, done)
    if not quiet:
        for what, path in {"page": page, "json": json}.items():
            if path is not None:
                _say(f"{what}: {path}", "dim", fold=False)
    if any(one.error for one in done):
        raise typer.Exit(1)


def _list(items: list[Item]) -> Table:
    table = Table(
        Column("item", no_wrap=True), Column("source", no_wrap=True), "group", "what", box=None
    )
    for item in items:
        extra = f" (recordings: {', '.join(item.recordings)})" if item.recordings else ""
        table.add_row(item.name, item.source, item.group, escape(item.title + extra))
    return table


def _show(one: Done) -> None:
    from harness.cli.console import figures_table
    from harness.reproduce.engine import for_people

    console.print()
    _say(f"{one.item.source}: {one.item.title}", "bold")
    if one.skipped:
        _say(f"skipped: it {one.skipped}", "yellow")
    if one.error:
        _say(f"ended early: {one.error}", "red")
    if one.outcome.figures:
        console.print(figures_table(one.outcome.figures))
    for note in one.outcome.notes:
        _say(for_people(note), "dim")


def _say(text: str, style: str, fold: bool = True) -> None:
    console.print(text, style=style, markup=False, highlight=False, soft_wrap=not fold)


@contextmanager
def _progress(count: int, quiet: bool) -> Iterator[Callable[[Item, float, str], None]]:
    """Show a bar over all items that says which one is at what."""
    if quiet:
        yield lambda _item, _share, _what: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[what]}", style="dim", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=count, what="")
        begun: dict[str, int] = {}

        def update(item: Item, share: float, what: str) -> None:
            place = begun.setdefault(item.name, len(begun))
            done = place + min(max(share, 0.0), 1.0)
            bar.update(task, description=item.name, completed=done, what=what)

        yield update
