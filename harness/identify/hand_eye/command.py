"""`steadytip identify hand-eye`: rotation between an inertial unit and a tracker's sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from harness.report.terminal import printed, say

_console = Console()


def command(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="Table (CSV, text, Parquet) of time, rate_x..z and em_attitude_w..z, and if they"
            " are there em_new, em_age, force_x..z, field_x..z; a run's own record will do.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE", help="The set; build/identify/RECORDING.ssv by default."
        ),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(metavar="PART", help="Part that the inertial columns belong to."),
    ] = None,
    tracker: Annotated[
        str | None,
        typer.Option(metavar="PART", help="Part that the tracker's columns belong to."),
    ] = None,
    report: Annotated[bool, typer.Option(help="Write the HTML page beside the set.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Hand-eye rotation and registration of a tracker, as a parameter set for EmInertialEkf."""
    from harness.common.errors import SteadytipError
    from harness.identify.hand_eye import fit as hand_eye

    if out is not None and out.suffix != ".ssv":
        raise SteadytipError(f"--out {out}: a parameter set ends in .ssv")
    recorded = hand_eye.read(recording, unit, tracker)
    found = hand_eye.identify(recorded)
    path = out or Path("build", "identify", f"{recording.stem}.ssv")
    files = {"parameters": hand_eye.write_set(path, found)}
    if report:
        files["page"] = hand_eye.write_page(path.with_suffix(".html"), recorded, found)
    if not quiet:
        _console.print(printed(hand_eye.table_of(found)))
        for what, file in files.items():
            say(_console, f"{what}: {file}", "dim")
        text = f"for parts that are an EmInertialEkf: --set part.NAME.parameters={path}"
        say(_console, text, "dim")
