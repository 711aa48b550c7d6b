"""`steadytip identify imu`: the sensors' measurement model from rests on a turntable."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.identify.options import CommandOutput, Out, Quiet, Report, column


def command(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING",
            help="Tables of the angles alpha, beta and the channels a1x .. mz at rest (CSV, text,"
            " Parquet), perhaps of the temperature; all of one unit on one turntable.",
        ),
    ],
    out: Out = None,
    linear: Annotated[
        bool,
        typer.Option(
            "--linear", help="Bias and scale factor alone, from the axes up and down (A04 3.3)."
        ),
    ] = False,
    alpha: Annotated[str | None, column("Column of the tilt, from 1.")] = None,
    beta: Annotated[str | None, column("Column of the turn.")] = None,
    temperature: Annotated[str | None, column("Column of the temperature.")] = None,
    channel: Annotated[
        list[str] | None,
        typer.Option(metavar="CHANNEL=NAME|NUMBER", help="Column of a channel, as a1x=3."),
    ] = None,
    angle_unit: Annotated[str | None, typer.Option(help="deg or rad.")] = None,
    volts_unit: Annotated[str | None, typer.Option(help="V, mV or kV.")] = None,
    report: Report = True,
    quiet: Quiet = False,
) -> None:
    """Calibrate sensors: bias, scale, cross axes, misalignment, drift; as a file for any run."""
    from fmu_src.errors import SteadytipError
    from harness.common.errors import nearest
    from harness.identify.imu import fit as calibration
    from harness.identify.imu.page import parameter_table, residual_table, write_page
    from harness.recordings.tables import ColumnMapping
    from harness.recordings.turntable import CHANNELS, join_positions, read_positions

    output = CommandOutput(quiet, out, recordings[0])
    columns: dict[str, str | None] = {"alpha": alpha, "beta": beta, "temperature": temperature}
    for text in channel or ():
        name, separator, chosen = text.partition("=")
        if name not in CHANNELS or not separator:
            raise SteadytipError(
                f"--channel {text}: write CHANNEL=COLUMN, as a1x=3; {nearest(name, CHANNELS)}"
            )
        columns[name] = chosen
    mapping = ColumnMapping(columns, {"angle": angle_unit, "volts": volts_unit})
    positions = join_positions([read_positions(path, mapping) for path in recordings])
    output.title(f"{len(positions)} rests of {', '.join(positions.channels)}")
    output.notes(positions.notes)
    if linear:
        values = calibration.linear(positions)
    else:
        where = "recording " + ", ".join(map(str, recordings))
        found = calibration.calibrate(positions, where)
        output.notes(found.notes)
        output.tables(parameter_table(found), residual_table(found))
        values = found.parameters()
    files = {"parameters": calibration.write_calibration(output.path, values)}
    if report and not linear:
        files["page"] = write_page(output.path.with_suffix(".html"), recordings, found)
    output.files(files, "MicronEstimator")
