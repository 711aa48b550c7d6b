"""`steadytip identify allan`: noise terms of sensors at rest, and a filter's covariances."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from harness.report.terminal import bar, printed, say

_console = Console()


def command(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="Table of a sensor at rest (CSV, text, Parquet), evenly spaced.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE", help="The set; build/identify/RECORDING.ssv by default."
        ),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|NUMBER", help="Column, from 1; repeatedly for several. All by default."
        ),
    ] = None,
    time: Annotated[
        str | None, typer.Option(metavar="NAME|NUMBER", help="Column of the time.")
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="Samples in a second, for tables without time."),
    ] = None,
    unit: Annotated[
        str | None, typer.Option(help="Of columns that do not say theirs, as V, mg, deg/s or uT.")
    ] = None,
    fit: Annotated[
        str,
        typer.Option(
            metavar="START:END|SHARE", help="Part that is taken, in seconds or as a share (75%)."
        ),
    ] = "100%",
    lag: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Time constant of the filter ahead of the converter; seen in the samples by"
            " default, where they are dense enough.",
        ),
    ] = None,
    model: Annotated[str, typer.Option(help="Model that the set is for.")] = "MicronEstimator",
    into: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PARAMETER=TERM:COLUMN",
            help="Parameter that takes a term (white, sample, bias, walk, trend, quantisation), as"
            " gyro.density=white:rate_x; channels a1x .. mz, ports rate_x .. and force_x .. find"
            " theirs alone.",
        ),
    ] = None,
    parameters: Annotated[
        Path | None,
        typer.Option(metavar="SET", help="Set of `identify imu` with the scales of the channels."),
    ] = None,
    report: Annotated[bool, typer.Option(help="Write the HTML page beside the set.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Noise terms read off the Allan deviation, as covariances for any run."""
    import math

    from harness.common.errors import SteadytipError
    from harness.identify.allan import fit as allan
    from harness.identify.allan import parameter_files as noise_sets
    from harness.identify.allan.page import term_table, write_page

    if out is not None and out.suffix != ".ssv":
        raise SteadytipError(f"--out {out}: a parameter set ends in .ssv")
    if lag is not None and not (math.isfinite(lag) and 0 <= lag <= 10):
        raise SteadytipError(f"--lag {lag:g}: must be in [0, 10] s")
    wishes = [noise_sets.parse_wish(text) for text in into or ()]
    records = allan.read_record(recording, column or (), rate, time, unit, fit)
    found = {}
    with bar(_console, quiet) as progress:
        task = progress.add_task("averaging", total=len(records))
        for record in records:
            noise = allan.analyse(record.values, record.period, lag)
            found[record.name] = (noise, *noise_sets.in_quantity(record, parameters))
            progress.advance(task)
    notes: list[str] = []
    if not wishes:
        wishes, notes = noise_sets.shipped_wishes(model, found)
    if not quiet:
        _console.print()
        first = records[0]
        text = f"{recording.name}: {len(first.values)} samples in {first.time[-1]:.6g} s"
        say(_console, text, "bold")
        for name, (noise, _, _) in found.items():
            for note in noise.notes:
                say(_console, f"note: {name}: {note}", "yellow")
        for note in notes:
            say(_console, f"note: {note}", "yellow")
        _console.print(printed(term_table(found)))
    path = out or Path("build", "identify", f"{recording.stem}.ssv")
    files = {}
    if wishes:
        files["parameters"] = noise_sets.write_set(path, model, wishes, found)
    elif out is not None:
        raise SteadytipError(
            f"--out {out}: no parameter of {model} takes anything; give --into "
            "PARAMETER=TERM:COLUMN, or name the columns as channels and ports are, a1x or rate_x"
        )
    if report:
        files["page"] = write_page(path.with_suffix(".html"), recording, found)
    if not quiet:
        for what, file in files.items():
            say(_console, f"{what}: {file}", "dim")
        if "parameters" in files:
            say(_console, f"for parts that are a {model}: --set part.NAME.parameters={path}", "dim")
