"""The command `steadytip info`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.cli.options import Overrides, Recording, console


def info(
    what: Annotated[str, typer.Argument(metavar="SCENARIO|FMU", help="A scenario or an FMU file.")],
    motion: Recording = None,
    override: Overrides = None,
) -> None:
    """Show the inside of a scenario or of an FMU."""
    from harness.cli.console import fmu_table, system_tables

    if what.endswith(".fmu"):
        from harness.parts.description import describe

        blocks = fmu_table(describe(Path(what)))
    else:
        from harness.cli.overrides import parse_overrides
        from harness.scenario.load import load
        from harness.system.assembly import assemble

        blocks = system_tables(assemble(load(what, parse_overrides(override, None, None)), motion))
    for block in blocks:
        console.print(block, highlight=False)
