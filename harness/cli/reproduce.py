"""The command `steadytip reproduce`; as in `harness.cli.main`, it imports what it needs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Column, Table

from harness.cli.options import console
from harness.report.terminal import bar, printed, say

if TYPE_CHECKING:
    from harness.reproduce.engine import ItemRun
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
    """Print the papers' tables and figures beside what this software measures."""
    from harness.reproduce.catalogue import chosen, items

    known = items()
    if not names:
        console.print(_list(known))
        return

    from fmu_src.errors import SteadytipError
    from harness.common.errors import ProblemsError

    wanted = chosen(names, known)
    if data is not None and not data.is_dir():
        raise SteadytipError(f"--data {data}: there is no such folder")
    # Skipping is for what a group or `all` brings along, not for the only thing asked for.
    missing = {item.name: item.missing(data) for item in wanted}
    if all(missing.values()):
        raise ProblemsError("reproduce", [f"{name} {text}" for name, text in missing.items()])

    from harness.reproduce.engine import run_items, write_json, write_page

    done: list[ItemRun] = []
    with bar(console, quiet) as shown:
        task = shown.add_task("", total=len(wanted))

        def update(item: Item, share: float, what: str) -> None:
            completed = len(done) + min(max(share, 0.0), 1.0)
            shown.update(task, description=f"{item.name}: {what}", completed=completed)

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
                say(console, f"{what}: {path}", "dim")
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


def _show(one: ItemRun) -> None:
    from harness.report.figure_table import figure_table, with_micro_sign

    console.print()
    say(console, f"{one.item.source}: {one.item.title}", "bold", fold=True)
    if one.skipped:
        say(console, f"skipped: it {one.skipped}", "yellow", fold=True)
    if one.error:
        say(console, f"ended early: {one.error}", "red", fold=True)
    if one.outcome.figures:
        console.print(printed(figure_table(one.outcome.figures)))
    for note in one.outcome.notes:
        say(console, with_micro_sign(note), "dim", fold=True)
