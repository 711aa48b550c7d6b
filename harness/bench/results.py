"""What benchmarks have measured, and the figures that come of it."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from harness.common.figures import Figure

__all__ = ["Book", "Line"]

Statistic = Callable[[Sequence[float]], float]


@dataclass(frozen=True)
class Line:
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
        """As an entry of the JSON list."""
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
    """Of one number, measured several times."""

    unit: str
    setting: str
    wanted: str
    statistic: Statistic
    part: str = ""
    values: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class _Ratio:
    over: tuple[str, str]
    under: tuple[str, str]


class Book:
    """Takes samples of numbers by group, row and column, in any order.

    Attributes:
        skipped: what could not be measured, and why, by group.
    """

    def __init__(self) -> None:
        self._entries: dict[tuple[str, str, str], _Samples | tuple[_Ratio, _Samples]] = {}
        self._given: list[Line] = []
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
        entry = self._entries.setdefault((group, row, column), new)
        assert isinstance(entry, _Samples)
        entry.values += values

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
        samples = _Samples("", setting, wanted, statistics.median)
        self._entries.setdefault((group, row, column), (_Ratio(over, under), samples))

    def take(self, group: str, part: str, row: str, column: str, figure: Figure) -> None:
        """Take a figure as it is.

        Args:
            group: of benchmarks.
            part: of the group, with a table of its own.
            row: where it stands there.
            column: where it stands there.
            figure: the figure.
        """
        line = Line(
            group,
            row,
            column,
            figure.unit,
            figure.setting,
            "",
            figure.measured,
            part=part,
            given=figure,
        )
        self._given.append(line)

    def skip(self, group: str, reason: str) -> None:
        """Something could not be measured."""
        self.skipped.setdefault(group, {})[reason] = None

    def lines(self) -> list[Line]:
        """All numbers, in the order in which they were first heard of."""
        found = []
        for (group, row, column), entry in self._entries.items():
            samples = entry if isinstance(entry, _Samples) else self._divided(group, *entry)
            if samples.values:
                what = (samples.unit, samples.setting, samples.wanted)
                value = float(samples.statistic(samples.values))
                ratio = samples is not entry
                found.append(Line(group, row, column, *what, value, ratio, samples.part))
        return found + self._given

    def _divided(self, group: str, ratio: _Ratio, samples: _Samples) -> _Samples:
        over, under = (self._entries.get((group, *each)) for each in (ratio.over, ratio.under))
        if isinstance(over, _Samples) and isinstance(under, _Samples):
            # An end in the midst of a turn leaves one of them with more.
            pairs = zip(over.values, under.values, strict=False)
            samples.values = [a / b for a, b in pairs]
        return samples
