"""The command `steadytip analyze`; as in `harness.cli.main`, it imports what it needs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from harness.cli.options import console

if TYPE_CHECKING:
    from harness.report import page


def analyze(
    scenario: Annotated[
        str, typer.Argument(help="A scenario file, or the name of a shipped one.")
    ] = "closed_loop",
    attenuation: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            help="Tip motion that may be left in the tremor's band, of the hand's, 0 to 1.",
        ),
    ] = 0.5,
    motion: Annotated[
        Path | None, typer.Option(help="Recording of hand motion that has the tremor's size.")
    ] = None,
    override: Annotated[
        list[str] | None,
        typer.Option("--set", help="Replace a value of the scenario: part.hand.seed=3"),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all randomness.")] = None,
    json: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write all numbers as a JSON list.", dir_okay=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of the page; build/analyze/SCENARIO[-RECORDING] by default.",
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Measure the delay budget: what is left of a tremor, what each part and delay costs."""
    from harness.analyze.analysis import analyze as analyse
    from harness.cli.overrides import parse_overrides

    def say(text: str) -> None:
        if not quiet:
            console.print(text, style="dim", markup=False, highlight=False, soft_wrap=True)

    with _progress(quiet) as update:
        found = analyse(
            scenario,
            wanted=attenuation,
            motion=motion,
            overrides=parse_overrides(override, None, seed),
            progress=update,
            status=say,
        )

    from harness.analyze.results import figures, spare_text, tables, write_page
    from harness.common.figures import write_figures

    if not quiet:
        for title, table in tables(found).items():
            console.print(f"\n[bold]{title}[/bold]", highlight=False)
            console.print(_shown(table))
        console.print(f"\n{spare_text(found)}", markup=False, highlight=False)
    for note in found.notes:
        say(f"{note}.")
    name = "-".join([found.scenario.name, *([motion.stem] if motion else [])])
    folder = out or Path("build", "analyze", name)
    say(f"page: {write_page(found, folder)}")
    if json is not None:
        say(f"json: {write_figures(json, figures(found))}")


def _shown(table: page.Table) -> Table:
    shown = Table(box=None, pad_edge=False)
    for index, name in enumerate(table.columns):
        number = index in table.numbers
        shown.add_column(name, justify="right" if number else "left", no_wrap=number)
    for row in table.rows:
        shown.add_row(*map(escape, row))
    return shown


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[float, str], None]]:
    """Show a bar that says what is being measured."""
    if quiet:
        yield lambda _share, _what: None
        return
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
    )

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda share, what: bar.update(task, completed=share, description=what)
