"""`steadytip identify imu`: the sensors' measurement model from rests on a turntable."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from harness.report.terminal import printed, say

_console = Console()


def command(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING",
            help="Tables of the angles alpha, beta and the channels a1x .. mz at rest (CSV, text,"
            " Parquet), perhaps of the temperature; all of one unit on one turntable.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE", help="The set; build/identify/RECORDING.ssv by default."
        ),
    ] = None,
    linear: Annotated[
        bool,
        typer.Option(
            "--linear", help="Bias and scale factor alone, from the axes up and down (A04 3.3)."
        ),
    ] = False,
    alpha: Annotated[
        str | None, typer.Option(metavar="NAME|NUMBER", help="Column of the tilt, from 1.")
    ] = None,
    beta: Annotated[
        str | None, typer.Option(metavar="NAME|NUMBER", help="Column of the turn.")
    ] = None,
    temperature: Annotated[
        str | None, typer.Option(metavar="NAME|NUMBER", help="Column of the temperature.")
    ] = None,
    channel: Annotated[
        list[str] | None,
        typer.Option(metavar="CHANNEL=NAME|NUMBER", help="Column of a channel, as a1x=3."),
    ] = None,
    angle_unit: Annotated[str | None, typer.Option(help="deg or rad.")] = None,
    volts_unit: Annotated[str | None, typer.Option(help="V, mV or kV.")] = None,
    report: Annotated[bool, typer.Option(help="Write the HTML page beside the set.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Bias, scale, cross axes, misalignment and drift of the sensors, as a set for any run."""
    from harness.common.errors import SteadytipError, nearest
    from harness.identify.imu import fit as calibration
    from harness.identify.imu.page import field_table, parameter_table, write_page
    from harness.identify.imu.read import Choice, read_rests
    from harness.identify.imu.turntable import CHANNELS, joined

    if out is not None and out.suffix != ".ssv":
        raise SteadytipError(f"--out {out}: a parameter set ends in .ssv")
    columns = {}
    for text in channel or ():
        name, separator, column = text.partition("=")
        if name not in CHANNELS or not separator:
            raise SteadytipError(
                f"--channel {text}: write CHANNEL=COLUMN, as a1x=3; {nearest(name, CHANNELS)}"
            )
        columns[name] = column
    choice = Choice(alpha, beta, temperature, columns, angle_unit, volts_unit)
    rests = joined([read_rests(path, choice) for path in recordings])
    path = out or Path("build", "identify", f"{recordings[0].stem}.ssv")
    where = "recording " + ", ".join(map(str, recordings))
    if not quiet:
        _console.print()
        say(_console, f"{len(rests)} rests of {', '.join(rests.channels)}", "bold")
        for note in rests.notes:
            say(_console, f"note: {note}", "yellow")
    files = {}
    if linear:
        files["parameters"] = calibration.write_set(path, calibration.linear(rests))
    else:
        found = calibration.calibrate(rests, where)
        if not quiet:
            for note in found.notes:
                say(_console, f"note: {note}", "yellow")
            _console.print(printed(parameter_table(found)))
            _console.print()
            _console.print(printed(field_table(found)))
        files["parameters"] = calibration.write_set(path, found.parameters())
        if report:
            files["page"] = write_page(path.with_suffix(".html"), recordings, found)
    if not quiet:
        for what, file in files.items():
            say(_console, f"{what}: {file}", "dim")
        text = f"for parts that are a MicronEstimator: --set part.NAME.parameters={path}"
        say(_console, text, "dim")
