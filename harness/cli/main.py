"""The command `steadytip`.

Exit codes: 0 all went well, 1 a run ended early or a check found problems, 2 the user's mistake.
Everything heavy is imported by the command that needs it, so that `--help` comes at once.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from rich.markup import escape

from harness.cli.analyze import analyze
from harness.cli.bench import bench
from harness.cli.build import build
from harness.cli.convert import convert
from harness.cli.hil import board, hil, replay
from harness.cli.identify import app as identify
from harness.cli.info import info
from harness.cli.new import new
from harness.cli.options import console, errors
from harness.cli.reproduce import reproduce
from harness.cli.run import run
from harness.cli.ssp import app as ssp
from harness.cli.sweep import sweep
from harness.cli.validate import validate

app = typer.Typer(
    help="Tremor-cancelling handheld microsurgery as FMI 2.0 co-simulation.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for _command in (
    run,
    sweep,
    new,
    build,
    validate,
    info,
    analyze,
    reproduce,
    hil,
    board,
    replay,
    convert,
    bench,
):
    app.command()(_command)
app.add_typer(identify, name="identify")
app.add_typer(ssp, name="ssp")


def main() -> None:
    """Run the command; mistakes of the user are printed without a traceback."""
    try:
        app()
    except Exception as error:
        from fmu_src.errors import SteadytipError

        if not isinstance(error, SteadytipError):
            raise
        errors.print(f"[red]{escape(str(error))}[/red]", highlight=False, soft_wrap=True)
        sys.exit(2)


def _print_version(wanted: bool) -> None:
    if wanted:
        from fmu_src import __version__

        console.print(__version__, highlight=False)
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass
