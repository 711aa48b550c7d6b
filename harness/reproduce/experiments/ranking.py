"""Bars that rank filters, in the signal alone and in the loop."""

from collections.abc import Container, Mapping, Sequence

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from harness.report.plots import GREY, SERIES, layout

LOWEST = -50.0
"""Where the axis of a ranking ends [%]."""


def ranking(
    rows: Mapping[str, Sequence[Sequence[float]]],
    definitions: Sequence[str],
    grey: Container[str] = (),
) -> go.Figure:
    """Draw bars of mean reductions, and the worst as marks, one panel for each definition.

    Args:
        rows: by name, from below: mean and worst, each by definition [%].
        definitions: titles of the panels.
        grey: names that are there for scale only.
    """
    plot = make_subplots(
        rows=1,
        cols=len(definitions),
        shared_yaxes=True,
        horizontal_spacing=0.04,
        subplot_titles=list(definitions),
    )
    colours = [GREY if name in grey else SERIES[0] for name in rows]
    for place in range(len(definitions)):
        means, worst = ([both[which][place] for both in rows.values()] for which in (0, 1))
        bars = go.Bar(
            x=means,
            y=list(rows),
            orientation="h",
            name="mean",
            marker={"color": colours},
            text=[f"{value:.1f}" for value in means],
            textposition="inside",
            insidetextanchor="start",
            insidetextfont={"color": "white"},
            showlegend=False,
        )
        marks = go.Scatter(
            x=worst,
            y=list(rows),
            mode="markers",
            name="worst recording",
            marker={"color": SERIES[1], "symbol": "diamond", "size": 9},
            showlegend=place == 0,
        )
        plot.add_traces([bars, marks], rows=1, cols=place + 1)
    layout(plot, 120 + 46 * len(rows))
    plot.update_layout(legend={"y": -0.18, "yanchor": "top"})
    plot.update_xaxes(title_text="reduction, %", range=[LOWEST, 100.0])
    plot.update_yaxes(automargin=True)
    return plot
