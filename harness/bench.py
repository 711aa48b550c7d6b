"""The commands `steadytip bench`; as in `harness.cli`, they import what they need."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from harness.reproduce.item import Figure

__all__ = ["app"]

app = typer.Typer(help="Figures of speed, printed and never judged.", no_args_is_help=True)
_console = Console()
_PACING = 2.0  # s


@app.callback()
def _group() -> None:
    pass


@app.command()
def hil(
    seconds: Annotated[
        float, typer.Option(min=1.0, help="Length of each run on the wall clock [s].")
    ] = 20.0,
    json: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write all numbers as a JSON list.", dir_okay=False),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """The loop on the wall clock: latency and wake-up on each transport, codec, pacing."""
    from harness.console import Display, figures_table

    display = Display(_console, quiet)
    figures = list(_hil(seconds, display.status))
    display.show(figures_table(figures))
    display.status(
        "Wanted on a quiet machine with SCHED_FIFO: latency of 300 us at the median and 1 ms at "
        "99 %, 3 us to decode or encode."
    )
    if json is not None:
        from harness.reproduce.run import write_figures

        display.status(f"json: {write_figures(json, figures)}")


def _hil(seconds: float, status: Callable[[str], None]) -> Iterator[Figure]:
    from harness.errors import SteadytipError
    from harness.hil import speed

    for link in speed.LINKS:
        for priority in speed.PRIORITIES:
            status(f"{link}, {f'priority {priority}' if priority else 'ordinary thread'}")
            try:
                yield from speed.loop_figures(link, priority, seconds)
            except SteadytipError as error:
                status(f"skipped: {error}")
    status("pacing and codec")
    for priority in speed.PRIORITIES:
        yield from speed.pacing_figures(priority, min(seconds, _PACING))
    for dbc in speed.DBCS:
        yield from speed.codec_figures(dbc)
