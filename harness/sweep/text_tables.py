"""Tables of a sweep for people, in the terminal and on the page."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from harness.common.quantities import format_quantity

if TYPE_CHECKING:
    from harness.sweep.outcome import SweepResult

__all__ = ["influence_rows", "said", "summary_rows"]

_BOUNDS = ("nis_low", "nis_high", "nees_low", "nees_high")
"""Figures that are bounds of another in the same run: nothing to take the mean of."""
Rows = tuple[tuple[str, ...], list[tuple[str, ...]]]


def said(value: float, unit: str) -> str:
    """Format a value with its unit; a dash where there is none."""
    return " ".join(format_quantity(value, unit)).strip() if math.isfinite(value) else "–"


def summary_rows(found: SweepResult) -> Rows:
    """Figures over all runs: column names and rows."""
    columns = ("figure", "median", "mean", "95 % from", "to", "least", "most", "unit")
    rows: list[tuple[str, ...]] = []
    for name, summary in found.summary.items():
        if name.endswith(_BOUNDS):
            continue
        unit = found.units[name]
        numbers = (
            summary.median,
            summary.mean,
            summary.low,
            summary.high,
            summary.least,
            summary.most,
        )
        cells = [format_quantity(v, unit)[0] if math.isfinite(v) else "–" for v in numbers]
        rows.append((name, *cells, format_quantity(1.0, unit)[1]))
    return columns, rows


def influence_rows(found: SweepResult, figure: str) -> Rows:
    """Return what a figure depends on: column names and rows, the strongest first."""
    columns = ("variable", "rank correlation", "95 %", "share of variance", "95 %")
    rows: list[tuple[str, ...]] = []
    for each in found.influences(figure):
        ordered = each.rho is not None
        rows.append(
            (
                each.variable,
                f"{each.rho:+.2f}" if ordered else "–",
                f"{each.rho_low:+.2f} to {each.rho_high:+.2f}" if ordered else "–",
                f"{100 * each.share:.0f} %",
                f"{100 * each.share_low:.0f} to {100 * each.share_high:.0f} %",
            )
        )
    return columns, rows
