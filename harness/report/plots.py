"""The look of all plots: layout, colours, curves, panels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from harness.common.types import FloatArray

__all__ = [
    "GREY",
    "POINTS",
    "SERIES",
    "chart",
    "components",
    "flats",
    "grid",
    "layout",
    "line",
    "shade",
    "thinned",
]

SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Okabe and Ito's palette: tells apart for colour-blind readers, and in print."""
GREY = "#444444"
"""Of what is given rather than computed."""
POINTS = 4000
"""Per curve; more than a screen has columns."""


def layout(figure: go.Figure, height: int, **more: Any) -> go.Figure:
    """Give a figure the look of all.

    Args:
        figure: changed, and returned.
        height: [px].
        more: entries of plotly's layout.
    """
    figure.update_layout(
        template="plotly_white",
        height=height,
        margin={"l": 64, "r": 16, "t": 36, "b": 48},
        legend={"orientation": "h", "x": 0.0, "y": 1.0, "yanchor": "bottom"},
        font={"family": "system-ui, sans-serif", "size": 13, "color": "#222222"},
        hovermode="closest",
        **more,
    )
    figure.update_xaxes(showline=True, linecolor="#888888", ticks="outside", zeroline=False)
    figure.update_yaxes(showline=True, linecolor="#888888", ticks="outside", zeroline=False)
    return figure


def chart(traces: Iterable[Any], x: str, y: str, height: int = 380, **more: Any) -> go.Figure:
    """Return a figure of one panel.

    Args:
        traces: curves, bars, ...
        x: title of the horizontal axis.
        y: title of the vertical axis.
        height: [px].
        more: entries of plotly's layout.
    """
    figure = layout(go.Figure(list(traces)), height, **more)
    figure.update_xaxes(title_text=x)
    figure.update_yaxes(title_text=y)
    return figure


def grid(
    panels: Sequence[Sequence[Iterable[Any]]],
    x: str | Sequence[str],
    y: Sequence[str],
    height: int,
    **subplots: Any,
) -> go.Figure:
    """Return a figure of several panels; its legend shows each name once.

    Args:
        panels: traces of each panel, by row and column.
        x: title below all columns, or one for each.
        y: titles of the rows, or of all panels row by row.
        height: [px].
        subplots: arguments of plotly's `make_subplots`.
    """
    rows, columns = len(panels), max(map(len, panels))
    places = {"vertical_spacing": 0.05, "horizontal_spacing": 0.09, "shared_xaxes": rows > 1}
    figure = make_subplots(rows=rows, cols=columns, **(places | subplots))
    named: set[str] = set()
    for row, cells in enumerate(panels, start=1):
        for column, traces in enumerate(cells, start=1):
            for trace in traces:
                trace.showlegend = trace.showlegend is not False and trace.name not in named
                named.add(trace.name)
                figure.add_trace(trace, row=row, col=column)
    layout(figure, height)
    for column, title in enumerate([x] * columns if isinstance(x, str) else x, start=1):
        figure.update_xaxes(title_text=title, row=rows, col=column)
    titled = len(y) // rows
    for place, title in enumerate(y):
        figure.update_yaxes(title_text=title, row=place // titled + 1, col=place % titled + 1)
    return figure


def components(
    curves: Iterable[tuple[str, str, FloatArray, FloatArray]], titles: Sequence[str], height: int
) -> go.Figure:
    """Return panels of the components of vectors over time, one below the other.

    Args:
        curves: name, colour, time (n,) [s], and vectors (n, k) of each.
        titles: of the k panels.
        height: [px].
    """
    curves = list(curves)
    panels = [
        [[line(*thinned(time, vectors[:, k]), colour, name)
          for name, colour, time, vectors in curves]]
        for k in range(len(titles))
    ]  # fmt: skip
    return grid(panels, "time, s", titles, height, vertical_spacing=0.04)


def shade(figure: go.Figure, begin: float, end: float, **place: int) -> None:
    """Shade a span of the horizontal axis in all panels, or in that of a `row` and `col`."""
    figure.add_vrect(begin, end, fillcolor="#888888", opacity=0.12, line_width=0, **place)


def thinned(
    time: FloatArray, values: FloatArray, points: int = POINTS
) -> tuple[FloatArray, FloatArray]:
    """Return a curve of about so many points that keeps the least and largest of each bin."""
    size = -(-2 * len(time) // points)
    if size <= 2:
        return time, values
    bins = len(time) // size
    block = values[: bins * size].reshape(bins, size)
    extremes = np.sort(np.stack([block.argmin(axis=1), block.argmax(axis=1)], axis=1), axis=1)
    index = (extremes + np.arange(bins)[:, None] * size).ravel()
    return time[index], values[index]


def flats(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a curve of steps by the ends of its flats."""
    changes = np.flatnonzero(np.diff(values) != 0.0)
    kept = np.unique(np.concatenate([[0], changes, changes + 1, [len(values) - 1]]))
    return time[kept], values[kept]


def line(
    x: FloatArray,
    y: FloatArray,
    colour: str,
    name: str,
    legend: bool = True,
    **style: Any,
) -> go.Scatter:
    """Return a curve.

    Args:
        x: (n,).
        y: (n,).
        colour: as CSS writes it.
        name: in the legend; curves of one name are switched together.
        legend: whether the legend shows it.
        style: `mode` (`lines`, `markers` or both with a plus sign), and entries of plotly's line,
            `width` or `dash`.
    """
    mode = style.pop("mode", "lines")
    return go.Scatter(
        x=x.astype(np.float32),
        y=y.astype(np.float32),
        name=name,
        legendgroup=name,
        showlegend=legend,
        mode=mode,
        line={"color": colour, "width": 1.2, **style},
    )
