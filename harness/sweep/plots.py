"""Plots of a sweep: distributions, what a figure depends on, a figure against its variables."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from harness.common.quantities import DISPLAY
from harness.report.plots import GREY, SERIES, layout
from harness.sweep.statistics import Influence, levels_of, mean_of

if TYPE_CHECKING:
    from harness.common.types import FloatArray
    from harness.sweep.outcome import SweepResult

__all__ = ["against", "distributions", "influences"]

_POINTS = 3000
"""Of a scatter; more hide each other."""
_BINS = 40
_LABEL = 18
"""Letters of a line of a level's name."""
_ROW = 280  # px


def _scaled(found: SweepResult, column: str) -> tuple[FloatArray, str]:
    """Values in the unit that people read, and the column's name with it."""
    unit, factor = DISPLAY.get(found.units[column], (found.units[column], 1.0))
    name = column.removeprefix("part.").replace("_", " ")
    return found.values(column) * factor, f"{name} [{unit}]" if unit else name


def _grid(count: int) -> tuple[go.Figure, int]:
    rows = -(-count // 2)
    figure = make_subplots(
        rows=rows, cols=min(count, 2), vertical_spacing=0.32 / rows if rows > 1 else 0.1
    )
    return figure, _ROW * rows + 60


def distributions(found: SweepResult, figures: Sequence[str]) -> go.Figure:
    """Histogram of each figure, its median, and its mean with the interval."""
    whole, height = _grid(len(figures))
    for k, name in enumerate(figures):
        values, title = _scaled(found, name)
        values = values[np.isfinite(values)]
        row, column = k // 2 + 1, k % 2 + 1
        counts, edges = np.histogram(values, bins=min(_BINS, max(5, len(values) // 5)))
        whole.add_trace(
            go.Bar(
                x=(edges[1:] + edges[:-1]) / 2,
                y=counts,
                width=np.diff(edges),
                marker={"color": SERIES[5], "line": {"width": 0}},
                name="runs",
                showlegend=False,
            ),
            row=row,
            col=column,
        )
        mean, low, high = mean_of(values)
        if np.isfinite(low):
            whole.add_vrect(
                x0=low,
                x1=high,
                fillcolor=SERIES[1],
                opacity=0.35,
                line_width=0,
                row=row,
                col=column,
            )
        whole.add_vline(x=mean, line={"color": SERIES[1], "width": 1.5}, row=row, col=column)
        whole.add_vline(
            x=float(np.median(values)),
            line={"color": GREY, "width": 1.5, "dash": "dash"},
            row=row,
            col=column,
        )
        whole.update_xaxes(title_text=title, row=row, col=column)
        whole.update_yaxes(title_text="runs", row=row, col=column)
    return layout(whole, height, bargap=0.0)


def influences(found: Sequence[Influence]) -> go.Figure:
    """Rank correlation and share of variance of each variable, with intervals."""
    order = list(reversed(found))
    names = [each.variable.removeprefix("part.") for each in order]
    whole = make_subplots(rows=1, cols=2, shared_yaxes=True, horizontal_spacing=0.06)
    ranked = [each for each in order if each.rho is not None]

    def bars(of: Sequence[Influence], middle: Any, low: Any, high: Any, colour: str) -> go.Bar:
        values = np.array([middle(each) for each in of])
        return go.Bar(
            x=values,
            y=[each.variable.removeprefix("part.") for each in of],
            orientation="h",
            marker={"color": colour},
            showlegend=False,
            error_x={
                "type": "data",
                "symmetric": False,
                "array": np.maximum(np.array([high(each) for each in of]) - values, 0.0),
                "arrayminus": np.maximum(values - np.array([low(each) for each in of]), 0.0),
                "color": GREY,
                "thickness": 1.2,
                "width": 4,
            },
        )

    if ranked:
        whole.add_trace(
            bars(ranked, lambda e: e.rho, lambda e: e.rho_low, lambda e: e.rho_high, SERIES[0]),
            row=1,
            col=1,
        )
    whole.add_trace(
        bars(
            order,
            lambda e: 100 * e.share,
            lambda e: 100 * e.share_low,
            lambda e: 100 * e.share_high,
            SERIES[2],
        ),
        row=1,
        col=2,
    )
    whole.update_xaxes(title="rank correlation", range=[-1.05, 1.05], row=1, col=1)
    whole.update_xaxes(title="share of the variance [%]", range=[0, 105], row=1, col=2)
    whole.update_yaxes(categoryorder="array", categoryarray=names)
    return layout(whole, 110 + 34 * len(order), bargap=0.35)


def against(found: SweepResult, figure: str, axes: Sequence[str]) -> go.Figure:
    """Plot a figure against variables: each run a point, and the mean of each level or class."""
    whole, height = _grid(len(axes))
    y, title = _scaled(found, figure)
    good = np.isfinite(y)
    listed = found.metadata["method"] == "grid"
    for k, axis in enumerate(axes):
        row, column = k // 2 + 1, k % 2 + 1
        about = found.metadata["variables"][axis]
        if about["numeric"]:
            x, name = _scaled(found, axis)
            _points(whole, row, column, x[good], y[good], listed)
            scale = about["said"].get("scale", "linear")
            whole.update_xaxes(type="log" if scale == "log" else "linear", row=row, col=column)
        else:
            texts = np.array(found.table.column(axis).to_pylist(), dtype=object)[good]
            name = axis.removeprefix("part.").replace("_", " ")
            _levels(whole, row, column, texts, y[good])
        whole.update_xaxes(title_text=name, row=row, col=column)
        whole.update_yaxes(title_text=title if column == 1 else None, row=row, col=column)
    return layout(whole, height)


def _points(
    whole: go.Figure, row: int, column: int, x: FloatArray, y: FloatArray, listed: bool
) -> None:
    some = slice(None, None, max(1, -(-len(x) // _POINTS)))
    whole.add_trace(
        go.Scattergl(
            x=x[some].astype(np.float32),
            y=y[some].astype(np.float32),
            mode="markers",
            marker={"size": 4, "color": SERIES[5], "opacity": 0.6},
            showlegend=False,
            hoverinfo="x+y",
        ),
        row=row,
        col=column,
    )
    classes = levels_of(x, listed)
    middles = [float(np.median(x[classes == c])) for c in np.unique(classes)]
    _means(whole, row, column, middles, [y[classes == c] for c in np.unique(classes)])


def _levels(whole: go.Figure, row: int, column: int, texts: np.ndarray, y: FloatArray) -> None:
    names = list(dict.fromkeys(texts.tolist()))
    short = ["<br>".join(textwrap.wrap(text, _LABEL)) for text in names]
    for text, name in zip(names, short, strict=True):
        whole.add_trace(
            go.Box(
                y=y[texts == text].astype(np.float32),
                name=name,
                marker={"color": SERIES[5], "size": 3},
                line={"width": 1},
                showlegend=False,
            ),
            row=row,
            col=column,
        )
    _means(whole, row, column, short, [y[texts == text] for text in names])
    whole.update_xaxes(tickangle=0, tickfont={"size": 10}, row=row, col=column)


def _means(
    whole: go.Figure, row: int, column: int, x: Sequence[Any], groups: Sequence[FloatArray]
) -> None:
    means = [mean_of(group) for group in groups]
    values = np.array([mean for mean, _, _ in means])
    ends = np.array([[low, high] for _, low, high in means])
    ends = np.where(np.isfinite(ends), ends, values[:, None])
    whole.add_trace(
        go.Scatter(
            x=list(x),
            y=values,
            mode="lines+markers" if not isinstance(x[0], str) else "markers",
            marker={"size": 6, "color": SERIES[1]},
            line={"width": 1.4, "color": SERIES[1]},
            error_y={
                "type": "data",
                "symmetric": False,
                "array": ends[:, 1] - values,
                "arrayminus": values - ends[:, 0],
                "thickness": 1.4,
                "width": 4,
            },
            showlegend=False,
        ),
        row=row,
        col=column,
    )
