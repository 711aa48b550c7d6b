"""Runs items and writes what comes of them: JSON, and one page. Imports as late as items do."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from harness.common.figures import Figure, write_figures
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    from harness.report.page import Section

__all__ = ["PAGE", "Done", "cells", "for_people", "run_items", "write_json", "write_page"]

PAGE = "reproduce.html"
COLUMNS = ("quantity", "paper", "measured", "unit", "setting")
"""Of a table of figures, in print and on the page."""
NUMBERS = frozenset({1, 2})
"""Those of them that hold numbers."""


@dataclass(frozen=True)
class Done:
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
) -> Iterable[Done]:
    """Run items one after the other; what goes wrong in one does not keep the others.

    Args:
        items: in their order.
        data: folder of recordings, or None.
        progress: told the item, the share of it that is done, and in a few words what is next.

    Yields:
        Each item when it has ended.
    """
    from harness.common.errors import SteadytipError

    for item in items:
        missing = item.missing(data)
        if missing:
            yield Done(item, skipped=missing)
            continue
        begun = time.perf_counter()
        context = Context(partial(progress, item), data)
        context.progress(0.0, "")
        try:
            outcome, error = item.run(context), ""
        except SteadytipError as trouble:
            outcome, error = ItemResult(), str(trouble)
        yield Done(item, outcome, time.perf_counter() - begun, error=error)


def cells(figure: Figure) -> tuple[str, ...]:
    """A figure as a row of `COLUMNS`: four digits, a dash where the paper has no number."""
    paper = "–" if figure.paper is None else f"{figure.paper:.4g}"
    texts = (figure.quantity, paper, f"{figure.measured:.4g}", figure.unit, figure.setting)
    return tuple(map(for_people, texts))


def for_people(text: str) -> str:
    """A text with the sign of micro, which JSON and source do without.

    >>> for_people("50 um in 2 us")
    '50 µm in 2 µs'
    """
    return re.sub(r"\bu(?=[msV]\b)", "µ", text)


def write_json(path: Path, done: Sequence[Done]) -> Path:
    """Write the figures of all items; see `write_figures`."""
    return write_figures(path, [figure for one in done for figure in one.outcome.figures])


def write_page(folder: Path, done: Sequence[Done]) -> Path:
    """Write the page of all items, whatever became of them.

    Raises:
        SteadytipError: the folder cannot be written to.
    """
    from harness.common.errors import SteadytipError
    from harness.common.files import reason
    from harness.report.page import made_with, write_sections

    try:
        folder.mkdir(parents=True, exist_ok=True)
        return write_sections(
            folder / PAGE,
            "The papers' tables and figures, measured again",
            f"{len(done)} item{'s' if len(done) != 1 else ''}, "
            f"{sum(one.seconds for one in done):.0f} s",
            (
                "Numbers of the papers stand beside those of this software, each with the setting "
                "under which it was measured. A dash is where the paper has a curve but no number.",
            ),
            [_section(one) for one in done],
            made_with("casadi", "numpy", "scipy", "plotly"),
        )
    except OSError as error:
        raise SteadytipError(f"{folder / PAGE} cannot be written: {reason(error)}") from None


def _section(one: Done) -> Section:
    from harness.report.page import Section, Table

    table = Table(COLUMNS, tuple(cells(figure) for figure in one.outcome.figures), NUMBERS)
    trouble = f"Ended early: {one.error}" if one.error else ""
    return Section(
        title=f"{one.item.source}: {one.item.title}",
        text=tuple(map(for_people, one.outcome.notes)),
        tables=(table,) if table.rows else (),
        plots=one.outcome.plots,
        trouble=f"Skipped: it {one.skipped}." if one.skipped else trouble,
    )
