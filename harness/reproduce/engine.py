"""Runs items and writes their results: JSON, and one page."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from fmu_src.errors import SteadytipError
from harness.common.figures import write_figures
from harness.report.figure_table import figure_table, with_micro_sign
from harness.report.page import Section, made_with, write_sections
from harness.reproduce.item import Context, Item, ItemResult

__all__ = ["PAGE", "ItemRun", "run_items", "write_json", "write_page"]

PAGE = "reproduce.html"


@dataclass(frozen=True)
class ItemRun:
    """An item that was run, or not.

    Attributes:
        item: which.
        outcome: what came of it; empty if it was skipped or failed.
        seconds: time that it took [s].
        skipped: why it was not run; empty if it was.
        error: why it ended early; empty if it did not.
    """

    item: Item
    outcome: ItemResult = field(default_factory=ItemResult)
    seconds: float = 0.0
    skipped: str = ""
    error: str = ""


def run_items(
    items: Iterable[Item],
    data: Path | None,
    progress: Callable[[Item, float, str], None] = lambda item, share, what: None,
) -> Iterable[ItemRun]:
    """Run items one after the other; an item that fails does not stop the others.

    Args:
        items: in their order.
        data: folder of recordings, or None.
        progress: called with the item, the share of it that is done, and a text on what is next.

    Yields:
        Each item when it has ended.
    """
    for item in items:
        missing = item.missing(data)
        if missing:
            yield ItemRun(item, skipped=missing)
            continue
        begun = time.perf_counter()
        context = Context(partial(progress, item), data)
        context.progress(0.0, "")
        try:
            outcome, error = item.run(context), ""
        except SteadytipError as trouble:
            outcome, error = ItemResult(), str(trouble)
        yield ItemRun(item, outcome, time.perf_counter() - begun, error=error)


def write_json(path: Path, done: Sequence[ItemRun]) -> Path:
    """Write the figures of all items; see `write_figures`."""
    return write_figures(path, [figure for one in done for figure in one.outcome.figures])


def write_page(folder: Path, done: Sequence[ItemRun]) -> Path:
    """Write the page of all items, those that failed or were skipped included.

    Raises:
        SteadytipError: the folder cannot be written to.
    """
    return write_sections(
        folder / PAGE,
        "The papers' tables and figures, measured again",
        f"{len(done)} item{'s' * (len(done) != 1)}, {sum(one.seconds for one in done):.0f} s",
        (
            "Numbers of the papers stand beside those of this software, each with the setting "
            "under which it was measured. A dash is where the paper has a curve but no number.",
        ),
        [_section(one) for one in done],
        made_with("casadi", "numpy", "scipy", "plotly"),
    )


def _section(one: ItemRun) -> Section:
    figures = one.outcome.figures
    trouble = f"Ended early: {one.error}" if one.error else ""
    return Section(
        title=f"{one.item.source}: {one.item.title}",
        text=tuple(map(with_micro_sign, one.outcome.notes)),
        tables=(figure_table(figures),) if figures else (),
        plots=one.outcome.plots,
        trouble=f"Skipped: it {one.skipped}." if one.skipped else trouble,
    )
