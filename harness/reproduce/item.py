"""Items: a table or figure of a paper, the context that it is run with, and its result.

An item is declared by its module and run with a `Context`; it gives an `ItemResult`: figures beside
those of the paper, plots, and notes. This module is imported for the list of items, so that it
imports errors, and with them CasADi, only where one is raised.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, SupportsFloat

from harness.common.figures import Figure

if TYPE_CHECKING:
    from harness.report.page import Plot

__all__ = ["Context", "Item", "ItemResult", "figures_of"]

Row = tuple[str, str, float | None, SupportsFloat]
"""Quantity, unit, number of the paper, measured number; see `Figure`."""


def figures_of(source: str, setting: str, rows: Iterable[Row]) -> list[Figure]:
    """Return figures of one source that were measured in one setting."""
    return [
        Figure(source, quantity, unit, paper, float(measured), setting)
        for quantity, unit, paper, measured in rows
    ]


@dataclass(frozen=True)
class ItemResult:
    """Result of an item.

    Attributes:
        figures: numbers beside the paper's.
        plots: for the page.
        notes: what is compared, and what falls short and why; sentences.
    """

    figures: tuple[Figure, ...] = ()
    plots: tuple[Plot, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Context:
    """Surroundings that an item is run in.

    Attributes:
        progress: called with the share of the item that is done, 0 to 1, and a text on the next
            step.
        data: folder of recordings; None without one. Items that declare `recordings` are run only
            where it holds them.
    """

    progress: Callable[[float, str], None] = lambda share, what: None
    data: Path | None = None

    def part(self, place: int, count: int) -> Context:
        """Return the context of one of `count` parts that take equally long."""
        return Context(lambda share, what: self.progress((place + share) / count, what), self.data)

    def recordings(self, folder: str) -> Path:
        """Return a folder of recordings.

        Args:
            folder: name below the data folder.

        Raises:
            SteadytipError: it is not there.
        """
        if self.data is None or not (self.data / folder).is_dir():
            from fmu_src.errors import SteadytipError

            where = f"{self.data} has no folder '{folder}'" if self.data else "there is no folder"
            raise SteadytipError(f"recordings '{folder}': {where}; give theirs with --data FOLDER")
        return self.data / folder


@dataclass(frozen=True)
class Item:
    """One table or figure of a paper, or a tight group of them.

    Attributes:
        name: on the command line, `table-7.1` or `figure-6.7`; unique.
        source: as in "A04 table 7.1"; the data set, where no paper has it.
        title: one line for people.
        group: items that belong together, `hysteresis`.
        run: measures it.
        recordings: folders below the data folder without which it cannot run.
        aliases: other names, as for the members of a group of figures.
    """

    name: str
    source: str
    title: str
    group: str
    run: Callable[[Context], ItemResult] = field(compare=False)
    recordings: tuple[str, ...] = field(default=())
    aliases: tuple[str, ...] = field(default=())

    def missing(self, data: Path | None) -> str:
        """Return why the item cannot run for want of recordings; empty if it can."""
        if not self.recordings:
            return ""
        absent = [name for name in self.recordings if data is None or not (data / name).is_dir()]
        if not absent:
            return ""
        where = f"{data} does not hold them" if data else "no folder of recordings is given"
        return f"needs the recordings {', '.join(absent)}, and {where}: --data FOLDER"
