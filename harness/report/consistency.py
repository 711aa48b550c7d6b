"""Plots of how an estimator's errors compare with what it says of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from harness.common.types import FloatArray
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, flats, layout, line, thinned
from harness.results.consistency import LEVEL, Consistency, mean_interval

__all__ = ["consistency_plots"]

_SINGLE, _MEAN = SERIES[5], SERIES[0]
_SPANS = 40
"""Means in a plot."""
_RANGE = (1e-3, 1e2)
"""Of what is shown beside 1, at the most."""


def consistency_plots(found: Sequence[Consistency]) -> Iterator[Plot]:
    """Yield one plot for each estimator: a row for its corrections and each of its errors."""
    for part, group in groupby(found, key=lambda each: each.part):
        yield _plot(part, list(group))


def _plot(part: str, rows: Sequence[Consistency]) -> Plot:
    figure = make_subplots(rows=len(rows), cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for row, each in enumerate(rows, start=1):
        _draw(figure, row, each)
    figure.update_xaxes(title_text="time, s", row=len(rows), col=1)
    verdicts = " ".join(f"{each.sentence.partition(': ')[2]}." for each in rows)
    per_cent = f"{100 * LEVEL:g} %"
    return Plot(
        f"Consistency of '{part}'",
        f"{verdicts} Light: single values per degree of freedom, of which {per_cent} of a "
        f"consistent filter's stay below the dashed line ({_shares(rows)} do). Dark: means of "
        f"successive spans of time. Band: the {per_cent} interval of these means for a NIS, that "
        "of the whole run's mean for a NEES, whose spans are not independent. Above the band the "
        "filter is overconfident, below it too cautious.",
        layout(figure, 140 + 200 * len(rows)),
    )


def _shares(rows: Sequence[Consistency]) -> str:
    return ", ".join(f"{each.title}: {each.inside:.1f} %" for each in rows)


def _draw(figure: go.Figure, row: int, each: Consistency) -> None:
    first = row == 1
    ratio = np.maximum(each.squared / each.size, _RANGE[0])
    for curve in (
        line(*thinned(each.time, ratio), _SINGLE, "single values", first, width=0.6),
        line(
            *thinned(*flats(each.time, each.bound / each.size)), GREY, "their bound", first,
            dash="dash", width=1.0,
        ),
    ):  # fmt: skip
        figure.add_trace(curve, row=row, col=1)
    time, mean, low, high = _means(each)
    band = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False}
    figure.add_trace(go.Scatter(x=time, y=low, **band), row=row, col=1)
    figure.add_trace(
        go.Scatter(x=time, y=high, fill="tonexty", fillcolor="rgba(68,68,68,0.25)", **band),
        row=row,
        col=1,
    )
    figure.add_trace(line(time, mean, _MEAN, "mean of a span", first, width=2.0), row=row, col=1)
    top = float(np.clip(max(ratio.max(), 10.0), None, _RANGE[1]))
    bottom = float(np.clip(np.quantile(ratio, 0.01), _RANGE[0], 0.1))
    figure.update_yaxes(
        type="log",
        title_text=each.title,
        range=np.log10([bottom, top]),
        exponentformat="power",
        dtick=1,
        row=row,
        col=1,
    )


def _means(each: Consistency) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return middle of each span, mean in it, and the interval of the mean of as many values."""
    spans = np.array_split(np.arange(len(each.time)), min(_SPANS, len(each.time)))
    degrees = [float(each.size[span].sum()) for span in spans]
    low, high = np.array(
        [mean_interval(n) if each.quantity is None else each.interval for n in degrees]
    ).T
    return (
        np.array([each.time[span].mean() for span in spans]),
        np.array([each.squared[span].sum() for span in spans]) / degrees,
        low,
        high,
    )
