"""Options that commands share, and the two consoles. Nothing heavy is imported."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

console = Console()
errors = Console(stderr=True)


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
