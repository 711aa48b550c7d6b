"""The command `steadytip bench`; as in `harness.cli.main`, it imports what it needs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.cli.options import console

__all__ = ["GROUPS", "bench"]

GROUPS = ("fmus", "loop", "container", "sweep", "memory", "start", "build", "hil", "bus")
"""Files of the suite, in the order in which they are shown."""


def bench(
    groups: Annotated[
        list[str] | None,
        typer.Argument(metavar="GROUP", help=f"Of {', '.join(GROUPS)}; all by default."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Rough numbers soon: few and short repeats.")
    ] = False,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=1.0, help="Length of each run on the wall clock (hil, bus) in s; 20, or 2 if quick."
        ),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write all numbers as a JSON list.", dir_okay=False),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the tables as a Markdown page.", dir_okay=False),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Measure speed and size: FMUs, loop, container, sweep, memory, cold start, builds, HIL.

    Figures are printed and never judged. Of what is compared, samples are taken in turns.
    """
    from fmu_src.errors import SteadytipError
    from harness.cli.console import Display
    from harness.common.errors import nearest

    unknown = [name for name in groups or () if name not in GROUPS]
    if unknown:
        raise SteadytipError(
            f"bench: there is no group '{unknown[0]}'; {nearest(unknown[0], GROUPS)}"
        )
    try:
        from harness.bench.session import measure
    except ModuleNotFoundError as error:
        raise SteadytipError(
            f"benchmarks need '{error.name}': pip install 'steadytip[bench]'"
        ) from None
    from harness.bench.page import console_tables, machine, write_page

    display = Display(console, quiet)
    wanted = [name for name in GROUPS if not groups or name in groups]
    length = seconds if seconds is not None else 2.0 if quick else 20.0
    where = machine()
    results = measure(wanted, quick=quick, seconds=length, status=display.status)
    for group in wanted:
        for block in console_tables(group, results):
            display.show(block)
    display.status(where)
    if json is not None:
        from harness.common.figures import write_figures

        figures = [line.figure() for line in results.lines()]
        display.status(f"json: {write_figures(json, figures)}")
    if table is not None:
        display.status(f"table: {write_page(table, wanted, results, where)}")
