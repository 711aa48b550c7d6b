"""Plots of an analysis."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from harness.analyze.analysis import INCOHERENT, Analysis
from harness.analyze.delay_budget import BAND, EARLIEST, band, left_of
from harness.analyze.linear import attenuation as attenuation_of
from harness.analyze.linear import changed
from harness.analyze.multisine import FREQUENCIES, within
from harness.analyze.operating_point import AXES
from harness.common.types import FloatArray
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, layout, line
from harness.results.metrics import TREMOR_BAND

__all__ = ["attenuation", "delays", "misfits", "phases"]

LATEST = 0.03
"""Of the delays that are drawn [s]."""


def _frequencies(figure: go.Figure, **place: int) -> None:
    figure.update_xaxes(title_text="frequency, Hz", range=[0, FREQUENCIES[-1]], **place)


def _tremor(figure: go.Figure) -> None:
    figure.add_vrect(*BAND, fillcolor=SERIES[2], opacity=0.1, line_width=0)


def attenuation(analysis: Analysis) -> Plot:
    """Tip motion by hand motion, and coherence, over frequency."""
    figure = make_subplots(
        rows=2, cols=1, shared_xaxes=True, row_heights=[0.72, 0.28], vertical_spacing=0.06
    )
    left = left_of(analysis.whole)
    edge = np.concatenate([left + analysis.scatter, (left - analysis.scatter)[::-1]])
    figure.add_trace(
        go.Scatter(
            x=np.concatenate([FREQUENCIES, FREQUENCIES[::-1]]),
            y=edge,
            fill="toself",
            fillcolor="rgba(0, 114, 178, 0.18)",
            line={"width": 0},
            name="± standard error",
            hoverinfo="skip",
        ),
        row=1,
        col=1,
    )
    for i, axis in enumerate(AXES):
        column = np.linalg.norm(analysis.whole[:, :, i], axis=1)
        figure.add_trace(line(FREQUENCIES, column, SERIES[3 + i], axis, width=0.8), row=1, col=1)
    figure.add_trace(line(FREQUENCIES, left, SERIES[0], "any axis, whole loop", width=2.2), 1, 1)
    parts = line(FREQUENCIES, left_of(analysis.product), SERIES[1], "from the parts", dash="dash")
    figure.add_trace(parts, row=1, col=1)
    figure.add_hline(1.0, line={"color": GREY, "width": 0.8, "dash": "dot"}, row=1, col=1)
    coherence = line(FREQUENCIES, analysis.coherence, GREY, "coherence", legend=False)
    figure.add_trace(coherence, row=2, col=1)
    figure.add_hline(INCOHERENT, line={"color": GREY, "width": 0.8, "dash": "dot"}, row=2, col=1)
    figure.update_yaxes(title_text="tip by hand", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title_text="coherence", range=[0, 1.05], row=2, col=1)
    _frequencies(figure, row=2, col=1)
    _tremor(figure)
    return Plot(
        "Attenuation",
        "Measured on the whole loop and put together from parts and wires; below, how much of the "
        f"correction follows the motion. Shaded: {BAND[0]:g} to {BAND[1]:g} Hz.",
        layout(figure, 520),
    )


def phases(analysis: Analysis) -> Plot:
    """Phase and equivalent delay of each stage over frequency."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    shown = within(TREMOR_BAND[0], FREQUENCIES[-1])
    f = FREQUENCIES[shown]
    total = np.sum([stage.phase for stage in analysis.stages], axis=0)
    curves = [
        (stage.label, stage.phase, SERIES[i % len(SERIES)], i)
        for i, stage in enumerate(analysis.stages)
    ]
    curves.append(("all together", total, GREY, -1))
    names: dict[str, int] = {}
    for name, phase, colour, number in curves:
        names[name] = names.get(name, 0) + 1
        label = name if names[name] == 1 else f"{name}, again"
        style = {"width": 2.2} if number < 0 else {"dash": "dot" if number >= len(SERIES) else None}
        degrees, milliseconds = np.degrees(phase[shown]), -phase[shown] / (2 * np.pi * f) * 1e3
        figure.add_trace(line(f, degrees, colour, label, **style), row=1, col=1)
        figure.add_trace(line(f, milliseconds, colour, label, legend=False, **style), 2, 1)
    figure.update_yaxes(title_text="phase, deg", row=1, col=1)
    figure.update_yaxes(title_text="delay, ms", row=2, col=1)
    # Below the band there is hardly a correction to have a phase.
    figure.update_xaxes(title_text="frequency, Hz", row=2, col=1)
    _tremor(figure)
    return Plot(
        "Phase and delay",
        "Of each part on the way, in order; wires with a delay have an arrow. All together is what "
        "the correction lags behind the motion.",
        layout(figure, 620),
    )


def delays(analysis: Analysis) -> Plot:
    """What is left in the band over a further delay of the command."""
    figure = go.Figure()
    budget = analysis.budget
    tried = np.linspace(EARLIEST, min(LATEST, budget.margin), 121)
    left = np.array(
        [band(left_of(attenuation_of(changed(analysis.loop, delay)))) for delay in tried]
    )
    over: FloatArray = np.sqrt(np.mean(left**2, axis=1))
    figure.add_trace(line(tried * 1e3, over, SERIES[0], "spread over the band", width=2.2))
    figure.add_trace(line(tried * 1e3, left.max(axis=1), SERIES[1], "at the worst frequency"))
    figure.add_hline(budget.wanted, line={"color": GREY, "width": 1, "dash": "dash"})
    figure.add_vline(0.0, line={"color": GREY, "width": 0.8, "dash": "dot"})
    figure.update_xaxes(title_text="further delay of the command, ms")
    figure.update_yaxes(title_text="tip by hand", rangemode="tozero")
    return Plot(
        "Delay",
        f"Tremor from {BAND[0]:g} to {BAND[1]:g} Hz that is left if the command comes later, or "
        "earlier; dashed, what is wanted.",
        layout(figure, 360),
    )


def misfits(analysis: Analysis) -> Plot:
    """How well parts alone do what they do in the loop, and parts and whole agree."""
    figure = go.Figure()
    for i, (part, values) in enumerate(analysis.misfit.items()):
        dash = "dot" if i >= len(SERIES) else None
        figure.add_trace(line(FREQUENCIES, values, SERIES[i % len(SERIES)], part, dash=dash))
    whole = line(FREQUENCIES, analysis.held_out, GREY, "parts against whole", width=2.2)
    figure.add_trace(whole)
    _frequencies(figure)
    figure.update_yaxes(title_text="of the hand's motion", range=[0, 1.0])
    _tremor(figure)
    return Plot(
        "Parts and whole",
        "What each part, measured alone with a small signal, does otherwise than in the loop, by "
        "its effect on the tip; those far off are not linear, and were fitted to the loop. Parts "
        "against whole: fitted on one realisation of the motion, compared on another.",
        layout(figure, 360),
    )
