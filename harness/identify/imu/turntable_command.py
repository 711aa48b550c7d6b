"""`steadytip identify turntable`: the turntable's procedure, simulated with a unit's FMU."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.identify.options import CommandOutput, Quiet


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
    quiet: Quiet = False,
) -> None:
    """Simulate a bench and write a recording for `identify imu`."""
    import numpy as np

    from fmu_src.errors import SteadytipError
    from harness.identify.imu import turntable
    from harness.recordings.tables import write_table
    from harness.recordings.turntable import CHANNELS

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
    output = CommandOutput(quiet)
    with output.progress() as add:
        update = add("turning")
        for k, room in enumerate(rooms):
            done = turntable.simulate(
                settings,
                alpha,
                beta,
                turntable.Turntable(seed=seed + k),
                seed + k,
                room,
                dwell,
                lambda n, count, k=k: update(n + k * count, len(rooms) * count),  # type: ignore[misc]
            )
            angles = np.degrees(np.column_stack((done.alpha, done.beta)))
            rows.append(np.column_stack((angles, done.volts, done.temperature)))
    headings = ["alpha [deg]", "beta [deg]"]
    headings += [f"{name} [V]" for name in CHANNELS] + ["temperature [degC]"]
    table = np.concatenate(rows)
    write_table(out, headings, table, ["%.4f", "%.4f", *["%.7f"] * 9, "%.4f"])
    rests = len(alpha) * len(rooms)
    output.say(f"{out}: {len(table)} means of {dwell / turntable.ROWS:.4g} s in {rests} rests")
