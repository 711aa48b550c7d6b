"""A04 figure 3.15: root Allan variance of 12 hours from switching on, at 1 Hz."""

from __future__ import annotations

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

SOURCE = "A04 figure 3.15"
HOURS = 12.0
SEED = 3
SHORT, LONG = 60.0, 500.0
"""Averaging times up to which white noise rules, and from which on the warming up does [s]."""


def run(context: Context) -> ItemResult:
    """The raw unit, motionless from a cold start."""
    import numpy as np
    import plotly.graph_objects as go

    from harness.report.page import Plot
    from harness.report.plots import GREY, SERIES, layout, line, thinned
    from harness.reproduce.experiments import motionless as bench

    context.progress(0.0, "recording")
    rest = bench.motionless(HOURS * bench.HOUR, 1.0, 0.0, SEED)
    context.progress(0.7, "averaging")
    noises = bench.noises(rest)
    setting = f"simulated; {HOURS:g} h at 1 Hz from switching on, six channels"
    short = np.concatenate([bench.slopes(noise, 0.0, SHORT) for noise in noises.values()])
    steepest = [bench.slopes(noise, LONG, np.inf).max() for noise in noises.values()]
    density = [noise.terms["white"].value for noise in noises.values()]
    steady = [bench.steady(rest, i) / bench.HOUR for i in range(len(noises))]
    drift = bench.shown(noises, "trend") + bench.shown(noises, "walk")
    figures = (
        Figure(SOURCE, f"slope up to {SHORT:g} s, mean", "", -0.5, float(short.mean()), setting),
        Figure(
            SOURCE, f"steepest slope from {LONG:g} s on, median", "", 1.0,
            float(np.median(steepest)), setting,
        ),
        Figure(SOURCE, "channels with trend or walk", "", 6, float(drift), setting),
        Figure(
            SOURCE, "white noise, mean (paper: 2.25 mg in 15.1 Hz)", "m/s2/Hz0.5", bench.NOISE,
            float(np.mean(density)), setting,
        ),
        Figure("A04 3.2.1.5", "steady state, first channel", "h", 2.0, min(steady), setting),
        Figure("A04 3.2.1.5", "steady state, last channel", "h", 12.0, max(steady), setting),
    )  # fmt: skip

    plot = go.Figure()
    time, values = thinned(rest.time / bench.HOUR, rest.force[:, 4])
    plot.add_trace(line(time, values, SERIES[0], "a3x"))
    middles, means = bench.means(rest, 4)
    plot.add_trace(
        go.Scatter(
            x=middles / bench.HOUR,
            y=means,
            name="mean of half an hour",
            mode="markers",
            marker={"color": GREY, "size": 8},
        )
    )
    plot.update_xaxes(title_text="time, h")
    plot.update_yaxes(title_text="specific force, m/s²")
    return ItemResult(
        figures=figures,
        plots=(
            Plot("Root Allan variance", "Dotted: terms of a1x.", bench.plotted(noises)),
            Plot("Drift", "As figure 3.14: channel a3x from switching on.", layout(plot, 360)),
        ),
        notes=(
            "Simulated: the unit of `raw_unit` with the noise of A04 table 2.3. Of the paper the "
            "slopes are known, but no values.",
            "The unit warms up exponentially, its three accelerometers with time constants of 0.5 "
            "to 3 h; a slope of 1 would be a straight drift, which no part of it is for long.",
        ),
    )


ITEM = Item(
    name="figure-3.15",
    source=SOURCE,
    title="Root Allan variance of 12 hours from switching on",
    group="sensing",
    run=run,
    aliases=("figure-3.14",),
)
