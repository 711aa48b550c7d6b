"""Tables of figures beside those of papers, in print and on pages."""

from __future__ import annotations

import re
from collections.abc import Iterable

from harness.common.figures import Figure
from harness.report.page import Table

__all__ = ["figure_table", "with_micro_sign"]


def figure_table(figures: Iterable[Figure]) -> Table:
    """Return a row for each figure: four digits, a dash where the paper has no number."""
    rows = [
        (
            figure.quantity,
            "–" if figure.paper is None else f"{figure.paper:.4g}",
            f"{figure.measured:.4g}",
            figure.unit,
            figure.setting,
        )
        for figure in figures
    ]
    return Table(
        ("quantity", "paper", "measured", "unit", "setting"),
        tuple(tuple(map(with_micro_sign, row)) for row in rows),
        frozenset({1, 2}),
    )


def with_micro_sign(text: str) -> str:
    """Return a text with the sign of micro, which JSON and source do without.

    >>> with_micro_sign("50 um in 2 us")
    '50 µm in 2 µs'
    """
    return re.sub(r"\bu(?=[msV]\b)", "µ", text)
