"""The command `steadytip convert`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.cli.options import console


def convert(
    run: Annotated[Path, typer.Argument(help="Folder of a run, or its results.parquet.")],
    out: Annotated[Path | None, typer.Option(help="Folder of the files; that of the run.")] = None,
) -> None:
    """Write a run's signals, and the frames of its log, as MF4 for other tools."""
    from harness.results.conversion import convert as write

    with console.status("writing MF4"):
        paths = write(run, out)
    for path in paths:
        console.print(str(path), highlight=False, soft_wrap=True)
