"""Plots that several items of chapter 7 share."""

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, layout, line
from harness.reproduce.experiments.stack import RATE
from harness.reproduce.experiments.tracking import Track


def tracks(title: str, caption: str, found: Mapping[str, Track], seconds: float) -> Plot:
    """Demand, measurement and error of each controller, one below the other.

    Args:
        title: heading.
        caption: what is shown.
        found: by controller.
        seconds: that are shown, from the first one.
    """
    plot: go.Figure = make_subplots(
        rows=len(found),
        cols=2,
        horizontal_spacing=0.09,
        vertical_spacing=0.045,
        shared_xaxes=True,
        row_titles=list(found),
    )
    for row, (name, track) in enumerate(found.items(), start=1):
        shown = slice(0, round(seconds * RATE))
        time = np.arange(len(track.wanted))[shown] / RATE
        middle = track.wanted.mean()
        curves = (
            line(time, 1e6 * (track.wanted - middle)[shown], GREY, "demand", row == 1, dash="dot"),
            line(
                time,
                1e6 * (track.measured - track.measured.mean())[shown],
                SERIES[0],
                "measured",
                row == 1,
            ),
        )
        for curve in curves:
            plot.add_trace(curve, row=row, col=1)
        error = line(time, 1e6 * track.moving[shown], SERIES[1], "difference", row == 1)
        plot.add_trace(error, row=row, col=2)
        plot.update_yaxes(title_text="µm", row=row, col=1)
        # All but the first, which has no model, to one scale.
        if name != next(iter(found)):
            plot.update_yaxes(range=[-0.8, 0.8], row=row, col=2)
    plot.update_xaxes(title_text="time, s", row=len(found))
    return Plot(title, caption, layout(plot, 190 * len(found)))
