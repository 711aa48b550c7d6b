"""Numbers that benchmarks have measured, and the figures made of them."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from harness.common.figures import Figure

__all__ = ["BenchResults", "Measurement"]

Statistic = Callable[[Sequence[float]], float]


@dataclass(frozen=True)
class Measurement:
    """One number.

    Attributes:
        group: of benchmarks.
        row: what was measured, `MicronEstimator`.
        column: what of it, `median`.
        unit: for people, such as us; empty for pure numbers.
        setting: under which conditions.
        wanted: what is, in words; empty without a wish.
        value: the number.
        compared: whether it is a ratio of two others.
        part: of the group that has a table of its own; empty for most.
        given: the figure, where it came as one.
    """

    group: str
    row: str
    column: str
    unit: str
    setting: str
    wanted: str
    value: float
    compared: bool = False
    part: str = ""
    given: Figure | None = None

    def figure(self) -> Figure:
        """Return the number as an entry of the JSON list."""
        from harness.common.figures import Figure

        if self.given is not None:
            return self.given
        return Figure(
            source=f"steadytip bench {self.group}",
            quantity=", ".join(filter(None, (self.row, self.column))),
            unit=self.unit,
            paper=None,
            measured=self.value,
            setting="; wanted ".join(filter(None, (self.setting, self.wanted))),
        )


@dataclass
class _Samples:
    """Samples of one number, measured several times; a ratio has those of two others."""

    unit: str
    setting: str
    wanted: str
    statistic: Statistic = statistics.median
    part: str = ""
    values: list[float] = field(default_factory=list)
    ratio: tuple[tuple[str, str], tuple[str, str]] | None = None


class BenchResults:
    """Takes samples of numbers by group, row and column, in any order.

    Attributes:
        skipped: what could not be measured, and why, by group.
    """

    def __init__(self) -> None:
        self._entries: dict[tuple[str, str, str], _Samples] = {}
        self._given: list[Measurement] = []
        self.skipped: dict[str, dict[str, None]] = {}

    def add(
        self,
        group: str,
        row: str,
        column: str,
        values: Sequence[float],
        unit: str,
        *,
        setting: str = "",
        wanted: str = "",
        statistic: Statistic = statistics.median,
        part: str = "",
    ) -> None:
        """Take samples; those of one number that come in several times are put together.

        Args:
            group: of benchmarks.
            row: what was measured.
            column: what of it.
            values: samples.
            unit: of them.
            setting: under which conditions.
            wanted: what is, in words.
            statistic: which number is made of all samples.
            part: of the group, with a table of its own.
        """
        new = _Samples(unit, setting, wanted, statistic, part)
        self._entries.setdefault((group, row, column), new).values += values

    def ratio(
        self,
        group: str,
        row: str,
        column: str,
        over: tuple[str, str],
        under: tuple[str, str],
        *,
        wanted: str = "",
    ) -> None:
        """Have the median of ratios of samples taken in turns; none while one of them is missing.

        Args:
            group: of all three.
            row: of the ratio.
            column: of the ratio.
            over: row and column of what is divided.
            under: row and column of what it is divided by.
            wanted: what is, in words.
        """
        setting = f"{over[0]} over {under[0]}, in turns"
        samples = _Samples("", setting, wanted, ratio=(over, under))
        self._entries.setdefault((group, row, column), samples)

    def add_figure(self, group: str, part: str, row: str, column: str, figure: Figure) -> None:
        """Take a figure as it is.

        Args:
            group: of benchmarks.
            part: of the group, with a table of its own.
            row: where it stands there.
            column: where it stands there.
            figure: the figure.
        """
        what = (figure.unit, figure.setting, "", figure.measured)
        self._given.append(Measurement(group, row, column, *what, part=part, given=figure))

    def skip(self, group: str, reason: str) -> None:
        """Note that something could not be measured."""
        self.skipped.setdefault(group, {})[reason] = None

    def lines(self) -> list[Measurement]:
        """Return all numbers, in the order in which they were first heard of."""
        found = []
        for (group, row, column), samples in self._entries.items():
            values = samples.values
            if samples.ratio is not None:
                over, under = (self._entries.get((group, *each)) for each in samples.ratio)
                if over is not None and under is not None:
                    # An end in the midst of a turn leaves one of them with more.
                    pairs = zip(over.values, under.values, strict=False)
                    values = [a / b for a, b in pairs]
            if values:
                what = (samples.unit, samples.setting, samples.wanted)
                value, ratio = float(samples.statistic(values)), samples.ratio is not None
                found.append(Measurement(group, row, column, *what, value, ratio, samples.part))
        return found + self._given
