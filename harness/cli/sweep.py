"""The command `steadytip sweep`; as in `harness.cli.main`, it imports what it needs."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from harness.cli.options import console, errors

__all__ = ["sweep"]

_NAMED = 10
"""Runs that failed and are named; the rest is counted."""
_LESS = ("least", "most")
"""Columns for wide terminals; the page has them, too."""


def sweep(
    scenario: Annotated[str, typer.Argument(help="A scenario file, or the name of a shipped one.")],
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUES",
            help="Vary a value of the scenario: part.hand.seed=1,2,3 or"
            " 'part.piezo_1.gain_error={mean=0.0, sigma=0.05}'.",
        ),
    ] = None,
    method: Annotated[
        str | None, typer.Option(help="grid, latin-hypercube or monte-carlo.")
    ] = None,
    runs: Annotated[int | None, typer.Option(help="How many, unless it is a grid.")] = None,
    seed: Annotated[int | None, typer.Option(help="Of the sweep; all runs follow from it.")] = None,
    seeds: Annotated[int | None, typer.Option(help="Seeds of the scenario to run with.")] = None,
    motion: Annotated[
        list[Path] | None, typer.Option(help="Recording of hand motion, or a folder of them.")
    ] = None,
    variant: Annotated[str | None, typer.Option(help="Variant of the scenario.")] = None,
    override: Annotated[
        list[str] | None,
        typer.Option("--set", help="Replace a value of the scenario in all runs."),
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Simulated time of a run [s].")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the results; build/sweeps/SCENARIO by default.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=0, help="Processes; one for each core by default, 0 for this one."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler whose workers run the cases."),
    ] = None,
    timeout: Annotated[
        float | None, typer.Option(help="Wall-clock time that a run may take [s].")
    ] = None,
    fuse: Annotated[
        bool, typer.Option(help="Run the models as one native FMU: same numbers, faster.")
    ] = True,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Start over, whatever is there already.")
    ] = False,
    page: Annotated[bool, typer.Option(help="Write the HTML page.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Run a scenario many times: grids, Latin hypercubes, Monte Carlo; go on where it stopped."""
    from harness.cli.console import Display
    from harness.cli.overrides import parse_overrides
    from harness.common.errors import RunError
    from harness.sweep.execution import sweep as run_sweep

    display = Display(console, quiet)
    try:
        with display.counting("runs") as progress:
            found = run_sweep(
                scenario,
                vary=_varied(vary or []),
                method=method,
                runs=runs,
                seed=seed,
                seeds=seeds,
                motions=motion,
                overrides=parse_overrides(override, seconds, None),
                variant=variant,
                out=out,
                workers=workers,
                scheduler=scheduler,
                timeout=timeout,
                fuse=fuse,
                fresh=fresh,
                page=page,
                status=display.status,
                progress=progress,
            )
    except RunError as ended:
        errors.print(f"[red]{escape(str(ended))}[/red]", highlight=False, soft_wrap=True)
        raise typer.Exit(1) from None
    display.show(_summary(found))
    for block in _ranking(found):
        display.show(block)
    display.files(table=found.file, page=found.page)
    if found.failed:
        _name(found)
        raise typer.Exit(1)


def _varied(texts: Sequence[str]) -> dict[str, Any]:
    """Return all of `--vary`, by key."""
    from fmu_src.errors import SteadytipError

    found: dict[str, Any] = {}
    for key, values in map(_said, texts):
        if key in found:
            raise SteadytipError(f"--vary {key} is given twice: write all its values into one")
        found[key] = values
    return found


def _said(text: str) -> tuple[str, Any]:
    """KEY=VALUES: values as TOML has them, or several with commas between."""
    from fmu_src.errors import SteadytipError
    from harness.cli.overrides import toml_value

    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise SteadytipError(f"--vary {text}: write KEY=VALUES, as in part.hand.seed=1,2,3")
    value = value.strip()
    if value[0] not in "[{":
        try:
            return key.strip(), tomllib.loads(f"values = [{value}]")["values"]
        except tomllib.TOMLDecodeError:
            return key.strip(), [toml_value(each.strip()) for each in value.split(",")]
    try:
        return key.strip(), tomllib.loads(f"said = {value}")["said"]
    except tomllib.TOMLDecodeError as error:
        raise SteadytipError(f"--vary {text}: {error}") from None


def _summary(found: Any) -> Any:
    from rich.table import Column, Table

    from harness.sweep.text_tables import summary_rows

    columns, rows = summary_rows(found)
    width = sum(max(map(len, cells)) + 2 for cells in zip(columns, *rows, strict=True)) - 2
    shown = [k for k, name in enumerate(columns) if width <= console.width or name not in _LESS]
    table = Table(Column(columns[0], overflow="fold"), box=None, pad_edge=False)
    for k in shown[1:]:
        table.add_column(columns[k], justify="left" if columns[k] == "unit" else "right")
    for row in rows:
        table.add_row(*(escape(row[k]) for k in shown))
    return table


def _ranking(found: Any) -> Any:
    from rich.table import Table

    from harness.sweep.text_tables import influence_rows

    if found.judge is None or not found.axes:
        return
    columns, rows = influence_rows(found, found.judge)
    if not rows:
        return
    table = Table(box=None, pad_edge=False, title=f"what {found.judge} depends on")
    for k, name in enumerate(columns):
        table.add_column(name, justify="right" if k else "left", overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    yield table


def _name(found: Any) -> None:
    """Say which runs have failed: the first ones, and how many there are."""
    failed = found.failed
    lines = [f"{len(failed)} of {found.table.num_rows} runs failed:"]
    lines += [f"  run {number}, {status}: {error}" for number, status, error in failed[:_NAMED]]
    if len(failed) > _NAMED:
        lines.append(f"  and {len(failed) - _NAMED} more; all are in {found.file}")
    errors.print(f"[red]{escape(chr(10).join(lines))}[/red]", highlight=False, soft_wrap=True)
