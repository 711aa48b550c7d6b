"""A04 figure 3.17: root Allan variance of 30 minutes at 1 kHz, after warming up."""

import numpy as np

from harness.report.page import Plot
from harness.reproduce.experiments import motionless as bench
from harness.reproduce.item import Context, Item, ItemResult, figures_of
from harness.reproduce.papers.a04.figure_3_15 import WHITE

SOURCE = "A04 figure 3.17"
MINUTES = 30.0
SEED = 5
POWERED = 1e7
"""Time that the unit has been on [s]."""
BAND = (0.5, 50.0)
"""Averaging times between the output filter and the last few averages [s]."""


def run(context: Context) -> ItemResult:
    """Record the raw unit, warm and motionless."""
    context.progress(0.0, "recording")
    rest = bench.motionless(MINUTES * 60, bench.RATE, POWERED, SEED)
    context.progress(0.8, "averaging")
    noises = bench.noises(rest)
    setting = f"simulated; {MINUTES:g} min at 1 kHz, warm, six channels"
    inside = np.concatenate([bench.slopes(noise, *BAND) for noise in noises.values()])
    density = [noise.terms["white"].value for noise in noises.values()]
    others = sum(bench.channels_with(noises, term) for term in ("bias", "walk", "trend"))
    low, high = BAND
    rows = (
        (f"slope from {low:g} to {high:g} s, mean", "", -0.5, inside.mean()),
        ("channels with another term than white noise", "", 0, others),
        (WHITE, "m/s2/Hz0.5", bench.NOISE, np.mean(density)),
    )
    return ItemResult(
        figures=tuple(figures_of(SOURCE, setting, rows)),
        plots=(Plot("Root Allan variance", "Dotted: terms of a1x.", bench.plot_deviation(noises)),),
        notes=(
            "Simulated: the unit of `raw_unit` with the noise of A04 table 2.3. Below 0.2 s the "
            "output filter of 15.1 Hz takes white noise away, which the terms know.",
        ),
    )


ITEM = Item(
    name="figure-3.17",
    source=SOURCE,
    title="Root Allan variance of 30 minutes at 1 kHz",
    group="sensing",
    run=run,
)
