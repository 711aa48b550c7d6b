"""`steadytip identify allan`: noise terms of sensors at rest, and a filter's covariances."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.identify.options import CommandOutput, Out, Quiet, Rate, Report, column


def command(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="Table of a sensor at rest (CSV, text, Parquet), evenly spaced.",
        ),
    ],
    out: Out = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(
            "--column",
            metavar="NAME|NUMBER",
            help="Column, from 1; repeatedly for several. All by default.",
        ),
    ] = None,
    time: Annotated[str | None, column("Column of the time.")] = None,
    time_unit: Annotated[str | None, typer.Option(help="s, ms, us or ns.")] = None,
    rate: Rate = None,
    unit: Annotated[
        str | None, typer.Option(help="Of columns that do not say theirs, as V, mg, deg/s or uT.")
    ] = None,
    fit: Annotated[
        str,
        typer.Option(
            metavar="START:END|SHARE", help="Part that is used, in seconds or as a share (75%)."
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
    model: Annotated[
        str, typer.Option(help="Model that the parameters are for.")
    ] = "MicronEstimator",
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
        typer.Option(
            metavar="FILE", help="Parameter file of `identify imu` with the scales of the channels."
        ),
    ] = None,
    report: Report = True,
    quiet: Quiet = False,
) -> None:
    """Find noise terms by the Allan deviation, as covariances for any run."""
    import math

    from fmu_src.errors import SteadytipError
    from harness.identify.allan import parameter_files as files
    from harness.identify.allan.fit import analyse
    from harness.identify.allan.page import term_table, write_page
    from harness.recordings.still import read_still_signals
    from harness.recordings.tables import ColumnMapping

    output = CommandOutput(quiet, out, recording)
    if lag is not None and not (math.isfinite(lag) and 0 <= lag <= 10):
        raise SteadytipError(f"--lag {lag:g}: must be in [0, 10] s")
    assignments = [files.parse_assignment(text) for text in into or ()]
    mapping = ColumnMapping({"time": time}, {"time": time_unit}, rate)
    signals = read_still_signals(recording, columns or (), mapping, unit, fit)
    found, notes = {}, list[str]()
    with output.progress() as add:
        update = add("averaging")
        for done, signal in enumerate(signals, start=1):
            noise = analyse(signal.values, signal.period, lag)
            found[signal.name] = (noise, *files.measured_quantity(signal, parameters))
            update(done, len(signals))
    if not assignments:
        assignments, notes = files.default_assignments(model, found)
    first = signals[0]
    output.title(f"{recording.name}: {len(first.values)} samples in {first.time[-1]:.6g} s")
    output.say(f"time: {first.clock}")
    output.notes(f"{name}: {note}" for name, (noise, _, _) in found.items() for note in noise.notes)
    output.notes(notes)
    output.tables(term_table(found))
    written = {}
    if assignments:
        written["parameters"] = files.write_covariances(output.path, model, assignments, found)
    elif out is not None:
        raise SteadytipError(
            f"--out {out}: no parameter of {model} takes anything; give --into "
            "PARAMETER=TERM:COLUMN, or name the columns as channels and ports are, a1x or rate_x"
        )
    if report:
        written["page"] = write_page(output.path.with_suffix(".html"), recording, found)
    output.files(written, model)
