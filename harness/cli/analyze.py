"""The command `steadytip analyze`; as in `harness.cli.main`, it imports what it needs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.cli.options import console
from harness.report.terminal import bar, printed, say


def analyze(
    scenario: Annotated[
        str, typer.Argument(help="A scenario file, or the name of a shipped one.")
    ] = "closed_loop",
    attenuation: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            help="Tip motion that may be left in the tremor's band, of the hand's, 0 to 1.",
        ),
    ] = 0.5,
    motion: Annotated[
        Path | None, typer.Option(help="Recording of hand motion that has the tremor's size.")
    ] = None,
    override: Annotated[
        list[str] | None,
        typer.Option("--set", help="Replace a value of the scenario: part.hand.seed=3"),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all randomness.")] = None,
    json: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write all numbers as a JSON list.", dir_okay=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of the page; build/analyze/SCENARIO[-RECORDING] by default.",
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Compute the delay budget: what is left of a tremor, what parts cost, what delay is borne."""
    from harness.analyze.analysis import analyze as analyse
    from harness.cli.overrides import parse_overrides

    def status(text: str) -> None:
        if not quiet:
            say(console, text, "dim")

    with bar(console, quiet) as shown:
        task = shown.add_task("", total=1.0)
        found = analyse(
            scenario,
            wanted=attenuation,
            motion=motion,
            overrides=parse_overrides(override, None, seed),
            progress=lambda share, what: shown.update(task, completed=share, description=what),
            status=status,
        )

    from harness.analyze.results import figures, spare_text, tables, write_page
    from harness.common.figures import write_figures

    if not quiet:
        for title, table in tables(found).items():
            console.print(f"\n[bold]{title}[/bold]", highlight=False)
            console.print(printed(table))
        console.print(f"\n{spare_text(found)}", markup=False, highlight=False)
    for note in found.notes:
        status(f"{note}.")
    name = "-".join([found.scenario.name, *([motion.stem] if motion else [])])
    folder = out or Path("build", "analyze", name)
    status(f"page: {write_page(found, folder)}")
    if json is not None:
        status(f"json: {write_figures(json, figures(found))}")
