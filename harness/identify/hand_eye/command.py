"""`steadytip identify hand-eye`: rotation between an inertial unit and a tracker's sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.identify.options import CommandOutput, Out, Quiet, Report


def command(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="Table (CSV, text, Parquet) of time, rate_x..z and em_attitude_w..z, and if they"
            " are there em_new, em_age, force_x..z, field_x..z; a run's own record will do.",
        ),
    ],
    out: Out = None,
    unit: Annotated[
        str | None,
        typer.Option(metavar="PART", help="Part that the inertial columns belong to."),
    ] = None,
    tracker: Annotated[
        str | None,
        typer.Option(metavar="PART", help="Part that the tracker's columns belong to."),
    ] = None,
    report: Report = True,
    quiet: Quiet = False,
) -> None:
    """Find hand-eye rotation and registration of a tracker, as a file for EmInertialEkf."""
    from harness.identify.hand_eye.fit import identify_hand_eye, write_hand_eye
    from harness.identify.hand_eye.page import result_table, write_page
    from harness.identify.hand_eye.read import read_tracked_motion

    output = CommandOutput(quiet, out, recording)
    recorded = read_tracked_motion(recording, unit, tracker)
    found = identify_hand_eye(recorded)
    files = {"parameters": write_hand_eye(output.path, found)}
    if report:
        files["page"] = write_page(output.path.with_suffix(".html"), recorded, found)
    output.tables(result_table(found))
    output.files(files, "EmInertialEkf")
