"""Options that commands share, and the two consoles. Nothing heavy is imported."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

console = Console()
errors = Console(stderr=True)


TimeColumn = Annotated[
    str | None, typer.Option(metavar="NAME|NUMBER", help="Column of the recording's time, from 1.")
]
AxisColumn = Annotated[
    str | None, typer.Option(metavar="NAME|NUMBER", help="Column of that axis of the recording.")
]
TimeUnit = Annotated[str | None, typer.Option(help="Unit of the recording's time: s, ms, us, ns.")]
LengthUnit = Annotated[
    str | None, typer.Option(help="Unit of the recording's x, y and z: m, cm, mm, um, nm.")
]
Rate = Annotated[
    float | None,
    typer.Option(metavar="HZ", help="Samples in a second, for a recording without time."),
]
AcceptFindings = Annotated[
    list[str] | None,
    typer.Option("--accept", help="Go on in spite of a finding about the recording, by its name."),
]
RepairFindings = Annotated[
    list[str] | None,
    typer.Option("--repair", help="Repair a finding about the recording, by its name: glitch."),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", help="Replace a value of the scenario: part.hand.seed=3"),
]


Seconds = Annotated[float | None, typer.Option(help="Simulated time [s].")]


Seed = Annotated[int | None, typer.Option(help="Seed of all randomness of the run.")]


ScenarioName = Annotated[str, typer.Argument(help="A scenario file, or the name of a shipped one.")]


Recording = Annotated[Path | None, typer.Option(help="Recording of hand motion to replay.")]
