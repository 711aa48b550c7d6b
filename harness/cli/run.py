"""The command `steadytip run`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from harness.cli.options import (
    AcceptFindings,
    AxisColumn,
    LengthUnit,
    Overrides,
    Rate,
    RepairFindings,
    ScenarioName,
    Seconds,
    Seed,
    TimeColumn,
    TimeUnit,
    console,
    errors,
)


def run(
    scenario: ScenarioName,
    motion: Annotated[
        list[Path] | None,
        typer.Option(help="Recording of hand motion to replay, or a folder of them; one run each."),
    ] = None,
    time: TimeColumn = None,
    x: AxisColumn = None,
    y: AxisColumn = None,
    z: AxisColumn = None,
    time_unit: TimeUnit = None,
    length_unit: LengthUnit = None,
    rate: Rate = None,
    accept: AcceptFindings = None,
    repair: RepairFindings = None,
    variant: Annotated[
        list[str] | None,
        typer.Option(help="Variant of the scenario; all of them by default, where it has any."),
    ] = None,
    override: Overrides = None,
    seconds: Seconds = None,
    seed: Seed = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the results; a new one by default, build/runs/SCENARIO/NUMBER."
        ),
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Write the signals as CSV, too.")] = False,
    report: Annotated[
        bool | None, typer.Option(help="Write the HTML report; if left out, not of variants.")
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write what variants reach as JSON.")] = None,
    fuse: Annotated[
        bool, typer.Option("--fuse", help="Run the models as one native FMU: same numbers, faster.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Run a scenario: build what is missing, record, measure, report; compare its variants."""
    from fmu_src.errors import SteadytipError
    from harness.cli.console import Display, comparison_table, metrics_table, ranking_table
    from harness.cli.overrides import parse_overrides
    from harness.common.errors import RunError
    from harness.recordings.motion import recordings
    from harness.results.variants import summarise_variants
    from harness.running import run as run_scenario
    from harness.scenario.load import load

    display = Display(console, quiet)
    settings = parse_overrides(override, seconds, seed)
    columns: dict[str, Any] = {"time": time, "x": x, "y": y, "z": z, "time_unit": time_unit}
    columns |= {"length_unit": length_unit, "rate": rate}
    motions: list[Path | None] = [*recordings(motion)] if motion else [None]
    variants: list[str | None] = [*(variant or load(scenario, settings).variants)] or [None]
    if json is not None and variants == [None]:
        raise SteadytipError(f"--json {json}: {scenario} has no variants to compare")
    todo = [(each, path) for each in variants for path in motions]
    results: dict[str, Any] = {}
    compared: dict[str, list[Any]] = {each: [] for each in variants if each is not None}
    failed = False
    for each, path in todo:
        words = [text for text in (each, path.stem if path else None) if text is not None]
        if each is not None:
            display.status(", ".join(words))
        options: dict[str, Any] = {
            **{"overrides": settings, "columns": columns, "csv": csv, "fuse": fuse},
            **{"motion": path, "accept": accept or (), "repair": repair or (), "variant": each},
            "out": out / "-".join(words) if out and len(todo) > 1 else out,
            "report": each is None if report is None else report,
            "status": display.status if each is None else lambda _: None,
        }
        try:
            with display.progress() as progress:
                result = run_scenario(scenario, progress=progress, **options)
        except RunError as ended:
            failed = True
            errors.print(f"[red]{escape(str(ended))}[/red]", highlight=False, soft_wrap=True)
            if ended.result is None:
                continue
            result = ended.result
        else:
            # A part of a run is not to be ranked beside whole ones.
            if each is not None:
                compared[each].append(result.metrics)
        results["-".join(words) or scenario] = result.metrics
        if len(todo) == 1:
            display.show(metrics_table(result.metrics))
            for each_estimator in result.consistency:
                display.status(each_estimator.sentence)
        display.files(record=result.file, report=result.report)
    ranked = summarise_variants(compared)
    if json is not None:
        from harness.common.figures import write_figures

        write_figures(json, [figure for rank in ranked for figure in rank.figures(scenario)])
    if len(todo) > 1:
        display.show(ranking_table(ranked) if compared else comparison_table(results))
    if failed:
        raise typer.Exit(1)
