"""`steadytip identify turntable`: the turntable's procedure, simulated with a unit's FMU."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from harness.report.terminal import bar, say

_console = Console()


def command(
    out: Annotated[
        Path, typer.Argument(metavar="FILE", help="Recording to write, CSV or .parquet.")
    ],
    scenario: Annotated[
        str, typer.Option(help="Scenario whose sensors sit on the turntable.")
    ] = "raw_unit",
    part: Annotated[str, typer.Option(help="Name of the sensors in it.")] = "sensors",
    grid: Annotated[float, typer.Option(metavar="DEG", help="Step of both angles.")] = 30.0,
    dwell: Annotated[
        float, typer.Option(metavar="SECONDS", help="Rest at each pair of angles.")
    ] = 5.0,
    ambient: Annotated[
        list[float] | None,
        typer.Option(
            metavar="DEGC",
            help="Temperature of the room; given repeatedly, the procedure is run at each, with the"
            " unit as warm as it then becomes.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the turntable's errors and of all noise.")] = 1,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """What a bench would record for `identify imu`: angles, volts and temperature at rest."""
    import numpy as np

    from harness.common.errors import SteadytipError
    from harness.identify.imu import turntable
    from harness.identify.parameter_files import write_table

    if not 0.05 <= dwell <= 60:
        raise SteadytipError(f"--dwell {dwell:g}: must be in [0.05, 60] s")
    rooms = ambient or [turntable.ROOM]
    for room in rooms:
        if not -40 <= room <= 60:
            raise SteadytipError(f"--ambient {room:g}: must be in [-40, 60] degC")
    if seed < 0:
        raise SteadytipError(f"--seed {seed}: must be 0 or more")
    alpha, beta = turntable.grid(grid)
    settings = turntable.sensors(scenario, part)
    rows = []
    with bar(_console, quiet) as progress:
        task = progress.add_task("turning", total=len(alpha) * len(rooms))
        for k, room in enumerate(rooms):
            done = turntable.simulate(
                settings,
                alpha,
                beta,
                turntable.Table(seed=seed + k),
                seed + k,
                room,
                dwell,
                lambda n, count, k=k: progress.update(task, completed=n + k * count),  # type: ignore[misc]
            )
            angles = np.degrees(np.column_stack((done.alpha, done.beta)))
            rows.append(np.column_stack((angles, done.volts, done.temperature)))
    headings = ["alpha [deg]", "beta [deg]"]
    headings += [f"{name} [V]" for name in turntable.CHANNELS] + ["temperature [degC]"]
    table = np.concatenate(rows)
    write_table(out, headings, table, ["%.4f", "%.4f", *["%.7f"] * 9, "%.4f"])
    if not quiet:
        rests = len(alpha) * len(rooms)
        text = f"{out}: {len(table)} means of {dwell / turntable.ROWS:.4g} s in {rests} rests"
        say(_console, text, "dim")
