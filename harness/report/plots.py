"""The look of all plots: layout, colours, curves."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go

from harness.common.types import FloatArray

__all__ = ["GREY", "POINTS", "SERIES", "flats", "layout", "line", "thinned"]

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


def thinned(
    time: FloatArray, values: FloatArray, points: int = POINTS
) -> tuple[FloatArray, FloatArray]:
    """A curve of about so many points that keeps every extreme: least and largest per bin."""
    size = -(-2 * len(time) // points)
    if size <= 2:
        return time, values
    bins = len(time) // size
    block = values[: bins * size].reshape(bins, size)
    extremes = np.sort(np.stack([block.argmin(axis=1), block.argmax(axis=1)], axis=1), axis=1)
    index = (extremes + np.arange(bins)[:, None] * size).ravel()
    return time[index], values[index]


def flats(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A curve of steps by the ends of its flats."""
    changes = np.flatnonzero(np.diff(values) != 0.0)
    kept = np.unique(np.concatenate([[0], changes, changes + 1, [len(values) - 1]]))
    return time[kept], values[kept]


def line(
    x: FloatArray, y: FloatArray, colour: str, name: str, legend: bool = True, **style: Any
) -> go.Scatter:
    """A curve.

    Args:
        x: (n,).
        y: (n,).
        colour: as CSS writes it.
        name: in the legend; curves of one name are switched together.
        legend: whether the legend shows it.
        style: entries of plotly's line, `width` or `dash`.
    """
    return go.Scatter(
        x=x.astype(np.float32),
        y=y.astype(np.float32),
        name=name,
        legendgroup=name,
        showlegend=legend,
        mode="lines",
        line={"color": colour, "width": 1.2, **style},
    )
