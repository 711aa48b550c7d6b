"""The commands `steadytip ssp ...`; as in `harness.cli.main`, each imports what it needs."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from harness.cli.options import Overrides, console

app = typer.Typer(
    help="Systems in the SSP 1.0 standard (System Structure and Parameterization).",
    no_args_is_help=True,
)

_File = Annotated[Path, typer.Argument(metavar="FILE", help="An .ssp file, anybody's.")]
_Step = Annotated[
    float | None,
    typer.Option(help="Period of the loop [s]; the longest step that an FMU asks for by default."),
]


@app.command("export")
def export_system(
    scenario: Annotated[str, typer.Argument(help="A scenario file, or the name of a shipped one.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="The file; SCENARIO.ssp by default.")
    ] = None,
    override: Overrides = None,
) -> None:
    """Write a scenario's system as an .ssp file."""
    from harness.cli.overrides import parse_overrides
    from harness.ssp.export import export

    _say(str(export(scenario, out, parse_overrides(override, None, None))))


@app.command("import")
def import_system(
    file: _File,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder, new or empty.")],
    step: _Step = None,
) -> None:
    """Turn an .ssp file into a scenario with its FMUs."""
    from harness.ssp.load import load

    loaded = load(file, out, step)
    for note in loaded.notes:
        _say(note)
    _say(str(loaded.scenario))


@app.command("run")
def run_system(
    file: _File,
    seconds: Annotated[float | None, typer.Option(help="Simulated time [s].")] = None,
    step: _Step = None,
    override: Overrides = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the results; build/runs/NAME/NUMBER by default.")
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Write the signals as CSV, too.")] = False,
    report: Annotated[bool, typer.Option(help="Write the HTML report.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Run an .ssp file in the harness, as `steadytip run` runs a scenario."""
    from harness.cli.run import run
    from harness.ssp.load import load

    with tempfile.TemporaryDirectory(prefix="steadytip-", ignore_cleanup_errors=True) as folder:
        loaded = load(file, Path(folder), step)
        for note in loaded.notes if not quiet else ():
            _say(note)
        run(
            str(loaded.scenario),
            override=override,
            seconds=seconds,
            out=out,
            csv=csv,
            report=report,
            quiet=quiet,
        )


def _say(text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)
