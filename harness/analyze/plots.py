"""Plots of an analysis."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from harness.analyze.analysis import INCOHERENT, Analysis
from harness.analyze.delay_budget import BAND, EARLIEST, band, left_of
from harness.analyze.linear import attenuation as attenuation_of
from harness.analyze.linear import modified
from harness.analyze.multisine import FREQUENCIES, within
from harness.analyze.operating_point import AXES
from harness.common.types import FloatArray
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, chart, grid, line
from harness.results.metrics import TREMOR_BAND

__all__ = ["attenuation", "delays", "misfits", "phases"]

LATEST = 0.03
"""Of the delays that are drawn [s]."""


def _tremor(figure: go.Figure) -> None:
    figure.add_vrect(*BAND, fillcolor=SERIES[2], opacity=0.1, line_width=0)


def attenuation(analysis: Analysis) -> Plot:
    """Plot tip motion by hand motion, and coherence, over frequency."""
    left = left_of(analysis.measured)
    edge = np.concatenate([left + analysis.scatter, (left - analysis.scatter)[::-1]])
    error = go.Scatter(
        x=np.concatenate([FREQUENCIES, FREQUENCIES[::-1]]),
        y=edge,
        fill="toself",
        fillcolor="rgba(0, 114, 178, 0.18)",
        line={"width": 0},
        name="± standard error",
        hoverinfo="skip",
    )
    columns = np.linalg.norm(analysis.measured, axis=1).T
    curves = [
        error,
        *(
            line(FREQUENCIES, column, colour, axis, width=0.8)
            for axis, column, colour in zip(AXES, columns, SERIES[3:], strict=True)
        ),
        line(FREQUENCIES, left, SERIES[0], "any axis, whole loop", width=2.2),
        line(FREQUENCIES, left_of(analysis.from_parts), SERIES[1], "from the parts", dash="dash"),
    ]
    coherence = line(FREQUENCIES, analysis.coherence, GREY, "coherence", legend=False)
    figure = grid(
        [[curves], [[coherence]]],
        "frequency, Hz",
        ["tip by hand", "coherence"],
        520,
        row_heights=[0.72, 0.28],
    )
    for row, level in enumerate((1.0, INCOHERENT), start=1):
        figure.add_hline(level, line={"color": GREY, "width": 0.8, "dash": "dot"}, row=row, col=1)
    figure.update_yaxes(rangemode="tozero", row=1, col=1)
    figure.update_yaxes(range=[0, 1.05], row=2, col=1)
    figure.update_xaxes(range=[0, FREQUENCIES[-1]])
    _tremor(figure)
    return Plot(
        "Attenuation",
        "Measured on the whole loop and put together from parts and wires; below, how much of the "
        f"correction follows the motion. Shaded: {BAND[0]:g} to {BAND[1]:g} Hz.",
        figure,
    )


def phases(analysis: Analysis) -> Plot:
    """Plot phase and equivalent delay of each stage over frequency."""
    shown = within(TREMOR_BAND[0], FREQUENCIES[-1])
    f = FREQUENCIES[shown]
    total = np.sum([stage.phase for stage in analysis.stages], axis=0)
    curves = [
        (stage.label, stage.phase, SERIES[i % len(SERIES)], i)
        for i, stage in enumerate(analysis.stages)
    ]
    curves.append(("all together", total, GREY, -1))
    names: dict[str, int] = {}
    angles, lags = [], []
    for name, phase, colour, number in curves:
        names[name] = names.get(name, 0) + 1
        label = name if names[name] == 1 else f"{name}, again"
        style = {"width": 2.2} if number < 0 else {"dash": "dot" if number >= len(SERIES) else None}
        degrees, milliseconds = np.degrees(phase[shown]), -phase[shown] / (2 * np.pi * f) * 1e3
        angles.append(line(f, degrees, colour, label, **style))
        lags.append(line(f, milliseconds, colour, label, **style))
    # Below the band there is hardly a correction to have a phase.
    figure = grid([[angles], [lags]], "frequency, Hz", ["phase, deg", "delay, ms"], 620)
    _tremor(figure)
    return Plot(
        "Phase and delay",
        "Of each part on the way, in order; wires with a delay have an arrow. All together is what "
        "the correction lags behind the motion.",
        figure,
    )


def delays(analysis: Analysis) -> Plot:
    """Plot what is left in the band over a further delay of the command."""
    budget = analysis.budget
    tried = np.linspace(EARLIEST, min(LATEST, budget.margin), 121)
    left = np.array(
        [band(left_of(attenuation_of(modified(analysis.loop, delay)))) for delay in tried]
    )
    over: FloatArray = np.sqrt(np.mean(left**2, axis=1))
    curves = (
        line(tried * 1e3, over, SERIES[0], "spread over the band", width=2.2),
        line(tried * 1e3, left.max(axis=1), SERIES[1], "at the worst frequency"),
    )
    figure = chart(curves, "further delay of the command, ms", "tip by hand", 360)
    figure.add_hline(budget.wanted, line={"color": GREY, "width": 1, "dash": "dash"})
    figure.add_vline(0.0, line={"color": GREY, "width": 0.8, "dash": "dot"})
    figure.update_yaxes(rangemode="tozero")
    return Plot(
        "Delay",
        f"Tremor from {BAND[0]:g} to {BAND[1]:g} Hz that is left if the command comes later, or "
        "earlier; dashed, what is wanted.",
        figure,
    )


def misfits(analysis: Analysis) -> Plot:
    """Plot how well parts alone agree with the loop, and parts with the whole."""
    curves = [
        line(FREQUENCIES, values, SERIES[i % len(SERIES)], part,
             dash="dot" if i >= len(SERIES) else None)
        for i, (part, values) in enumerate(analysis.misfit.items())
    ]  # fmt: skip
    curves.append(line(FREQUENCIES, analysis.held_out, GREY, "parts against whole", width=2.2))
    figure = chart(curves, "frequency, Hz", "of the hand's motion", 360)
    figure.update_xaxes(range=[0, FREQUENCIES[-1]])
    figure.update_yaxes(range=[0, 1.0])
    _tremor(figure)
    return Plot(
        "Parts and whole",
        "What each part, measured alone with a small signal, does otherwise than in the loop, by "
        "its effect on the tip; those far off are not linear, and were fitted to the loop. Parts "
        "against whole: fitted on one realisation of the motion, compared on another.",
        figure,
    )
