"""A04 figure 3.15: root Allan variance of 12 hours from switching on, at 1 Hz."""

import numpy as np

from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, chart, line, thinned
from harness.reproduce.experiments import motionless as bench
from harness.reproduce.item import Context, Item, ItemResult, figures_of

SOURCE = "A04 figure 3.15"
HOURS = 12.0
SEED = 3
WHITE = "white noise, mean (paper: 2.25 mg in 15.1 Hz)"
"""Quantity of figures 3.15 and 3.17."""
SHORT, LONG = 60.0, 500.0
"""Averaging times up to which white noise rules, and from which on the warming up does [s]."""


def run(context: Context) -> ItemResult:
    """Record the raw unit, motionless from a cold start."""
    context.progress(0.0, "recording")
    rest = bench.motionless(HOURS * bench.HOUR, 1.0, 0.0, SEED)
    context.progress(0.7, "averaging")
    noises = bench.noises(rest)
    setting = f"simulated; {HOURS:g} h at 1 Hz from switching on, six channels"
    short = np.concatenate([bench.slopes(noise, 0.0, SHORT) for noise in noises.values()])
    steepest = [bench.slopes(noise, LONG, np.inf).max() for noise in noises.values()]
    density = [noise.terms["white"].value for noise in noises.values()]
    steady = [bench.steady(rest, i) / bench.HOUR for i in range(len(noises))]
    drift = bench.channels_with(noises, "trend") + bench.channels_with(noises, "walk")
    figures = [
        *figures_of(
            SOURCE,
            setting,
            (
                (f"slope up to {SHORT:g} s, mean", "", -0.5, short.mean()),
                (f"steepest slope from {LONG:g} s on, median", "", 1.0, np.median(steepest)),
                ("channels with trend or walk", "", 6, drift),
                (WHITE, "m/s2/Hz0.5", bench.NOISE, np.mean(density)),
            ),
        ),
        *figures_of(
            "A04 3.2.1.5",
            setting,
            (
                ("steady state, first channel", "h", 2.0, min(steady)),
                ("steady state, last channel", "h", 12.0, max(steady)),
            ),
        ),
    ]
    time, values = thinned(rest.time / bench.HOUR, rest.force[:, 4])
    middles, means = bench.means(rest, 4)
    circles = line(middles / bench.HOUR, means, GREY, "mean of half an hour", mode="markers")
    circles.marker = {"size": 8}
    plot = chart(
        [line(time, values, SERIES[0], "a3x"), circles], "time, h", "specific force, m/s²", 360
    )
    return ItemResult(
        figures=tuple(figures),
        plots=(
            Plot("Root Allan variance", "Dotted: terms of a1x.", bench.plot_deviation(noises)),
            Plot("Drift", "As figure 3.14: channel a3x from switching on.", plot),
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
