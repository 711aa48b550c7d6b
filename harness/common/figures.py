"""Figures: single numbers, beside those of a paper where it has one."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Figure", "write_figures"]


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
                from fmu_src.errors import SteadytipError

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


def write_figures(path: Path, figures: Iterable[Figure]) -> Path:
    """Write figures as a list of objects; see `Figure`.

    Raises:
        SteadytipError: the file cannot be written.
    """
    from harness.common.files import write_text

    entries = [figure.entry() for figure in figures]
    return write_text(
        path, json.dumps(entries, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    )
