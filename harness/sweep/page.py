"""The page of a sweep: one HTML file that needs nothing but a browser."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fmu_src.errors import SteadytipError
from harness.common.files import reason
from harness.report.page import Plot, Section, Table, made_with, write_sections
from harness.results.variants import RANKED
from harness.sweep import plots
from harness.sweep.command import toml
from harness.sweep.outcome import larger_is_better
from harness.sweep.text_tables import influence_rows, said, summary_rows

if TYPE_CHECKING:
    from harness.sweep.outcome import SweepResult

__all__ = ["write_page"]

_WORST = 10
_NAMED = 50
"""Failed runs on the page; the table has all."""
_SHOWN = (*RANKED, "tip_rms", "worst_excursion", "attitude_error_rms", "position_error_rms")
_AGAINST = 4


def write_page(found: SweepResult) -> Path:
    """Write `sweep.html` beside the table.

    Raises:
        SteadytipError: the file cannot be written.
    """
    metadata = found.metadata
    failed = found.failed
    count = found.table.num_rows
    sections = [*_figures(found), *_dependence(found), *_worst(found), *_failed(found)]
    sections += [_everything(found), _varied(found)]
    introduction = [
        f"{count} of {metadata['runs']} runs, {len(failed)} of them failed. Values and seed of "
        f"each run follow from the sweep's seed, {metadata['seed']}, and the run's number.",
    ]
    if found.judge is not None:
        summary, unit = found.summary[found.judge], found.units[found.judge]
        introduction.append(
            f"{found.judge}: median {said(summary.median, unit)}, mean {said(summary.mean, unit)} "
            f"(95 %: {said(summary.low, unit)} to {said(summary.high, unit)}), from "
            f"{said(summary.least, unit)} to {said(summary.most, unit)}."
        )
    try:
        return write_sections(
            found.page,
            metadata["title"],
            f"{metadata['scenario']}, {metadata['method']}, {metadata['seconds']:g} s each",
            introduction,
            sections,
            made_with("numpy", "scipy", "pyarrow", "plotly"),
        )
    except OSError as error:
        raise SteadytipError(f"{found.page} cannot be written: {reason(error)}") from None


def _figures(found: SweepResult) -> list[Section]:
    wanted = [name for name in dict.fromkeys((found.judge, *_SHOWN)) if name in found.figures]
    names = [name for name in wanted if name and found.summary[name].count]
    if not names:
        text = "No run has figures of merit."
        return [Section("Distributions", trouble=text)]
    plot = Plot(
        "Runs by their figures",
        "Dashed: the median. Solid, in its 95 % interval: the mean.",
        plots.distributions(found, names),
    )
    return [Section("Distributions", plots=(plot,))]


def _dependence(found: SweepResult) -> list[Section]:
    if found.judge is None or not found.axes:
        return []
    influences = found.influences(found.judge)
    if not influences:
        return []
    columns, rows = influence_rows(found, found.judge)
    strongest = [each.variable for each in influences[:_AGAINST]]
    return [
        Section(
            f"What {found.judge} depends on",
            (
                "Rank correlation sees what goes up or down with a variable. The share of the "
                "variance between its levels, or classes of equal numbers of runs, sees any "
                "influence of the variable alone; where shares add up to much less than all, "
                "chance or variables together do the rest. With intervals of 95 %.",
            ),
            (Table(columns, tuple(rows), frozenset(range(1, len(columns)))),),
            (
                Plot("Ranking", "The strongest on top.", plots.influences(influences)),
                Plot(
                    "Against the strongest variables",
                    "Each run a point; means of levels or classes with their 95 % intervals.",
                    plots.against(found, found.judge, strongest),
                ),
            ),
        )
    ]


def _worst(found: SweepResult) -> list[Section]:
    if found.judge is None:
        return []
    unit = found.units[found.judge]
    rows = tuple(
        (str(row["run"]), str(row["seed"]), said(row[found.judge], unit), row["command"])
        for row in found.worst(_WORST)
    )
    least = "least" if larger_is_better(found.judge) else "largest"
    return [
        Section(
            "Worst runs",
            (f"Those with the {least} {found.judge}, and what runs each of them again.",),
            (Table(("run", "seed", found.judge, "command"), rows, frozenset({0, 1, 2})),),
        )
    ]


def _failed(found: SweepResult) -> list[Section]:
    if not found.failed:
        return []
    chosen = found.failed[:_NAMED]
    places = {number: k for k, number in enumerate(found.table.column("run").to_pylist())}
    commands = found.table.column("command")
    rows = tuple(
        (str(number), status, error, commands[places[number]].as_py())
        for number, status, error in chosen
    )
    more = len(found.failed) - len(chosen)
    text = (f"The first {len(chosen)}; the table has {more} more.",) if more else ()
    columns = ("run", "status", "error", "command")
    return [Section("Failed runs", text, (Table(columns, rows, frozenset({0})),))]


def _everything(found: SweepResult) -> Section:
    columns, rows = summary_rows(found)
    numbers = frozenset(range(1, len(columns) - 1))
    return Section("All figures", tables=(Table(columns, tuple(rows), numbers),))


def _varied(found: SweepResult) -> Section:
    rows = tuple(
        (name, toml(about["said"]) if about["said"] else "", about["unit"])
        for name, about in found.metadata["variables"].items()
    )
    seeds = found.metadata["seeds"]
    text = "a seed of its own for each run" if seeds is None else f"{len(seeds)} seeds"
    motions = ", ".join(found.metadata["motions"]) or "none"
    return Section(
        "What was varied",
        (f"Seeds: {text}. Recordings: {motions}.",),
        (Table(("variable", "values", "unit"), rows),),
    )
