"""What a table or figure of a paper is to this package, and what comes of measuring it again.

An item is declared by its module and run with a `Context`; it gives an `Outcome`: figures beside
those of the paper, plots, and notes. This module is imported for the list of items, so that it
imports errors, and with them CasADi, only where one is raised.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from harness.report.page import Plot

__all__ = ["Context", "Figure", "Item", "Outcome"]


@dataclass(frozen=True)
class Figure:
    """One number, beside the paper's.

    Attributes:
        source: where the paper has it, as in "A04 table 7.1".
        quantity: what it is.
        unit: of `paper` and `measured`, a unit for people such as um; empty for pure numbers.
        paper: what the paper has; None where it has no number.
        measured: what this software gives.
        setting: under which conditions.

    Raises:
        SteadytipError: a number that is not finite.
    """

    source: str
    quantity: str
    unit: str
    paper: float | None
    measured: float
    setting: str

    def __post_init__(self) -> None:
        for name, value in (("paper", self.paper), ("measured", self.measured)):
            if value is not None and not math.isfinite(value):
                from harness.errors import SteadytipError

                raise SteadytipError(
                    f"{self.source}, {self.quantity}: '{name}' = {value} must be finite"
                )

    def entry(self) -> dict[str, Any]:
        """As an object of the JSON list."""
        return {
            "source": self.source,
            "quantity": self.quantity,
            "unit": self.unit,
            "paper": None if self.paper is None else float(self.paper),
            "measured": float(self.measured),
            "setting": self.setting,
        }


@dataclass(frozen=True)
class Outcome:
    """What an item gives.

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
    """What an item is run with.

    Attributes:
        progress: told which share of the item is done, 0 to 1, and in a few words what is next.
        data: folder of recordings; None without one. Items that declare `recordings` are run only
            where it holds them.
    """

    progress: Callable[[float, str], None] = lambda share, what: None
    data: Path | None = None

    def recordings(self, folder: str) -> Path:
        """A folder of recordings.

        Args:
            folder: name below the data folder.

        Raises:
            SteadytipError: it is not there.
        """
        if self.data is None or not (self.data / folder).is_dir():
            from harness.errors import SteadytipError

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
    run: Callable[[Context], Outcome]
    recordings: tuple[str, ...] = field(default=())
    aliases: tuple[str, ...] = field(default=())

    def missing(self, data: Path | None) -> str:
        """Why the item cannot run for want of recordings; empty if it can."""
        if not self.recordings:
            return ""
        absent = [name for name in self.recordings if data is None or not (data / name).is_dir()]
        if not absent:
            return ""
        where = f"{data} does not hold them" if data else "no folder of recordings is given"
        return f"needs the recordings {', '.join(absent)}, and {where}: --data FOLDER"
