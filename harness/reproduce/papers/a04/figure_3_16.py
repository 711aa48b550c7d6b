"""A04 figure 3.16: root Allan variance of the last 4 of 12 hours, at 1 Hz."""

import numpy as np

from harness.report.page import Plot
from harness.reproduce.experiments import motionless as bench
from harness.reproduce.item import Context, Item, ItemResult, figures_of
from harness.reproduce.papers.a04.figure_3_15 import HOURS, LONG, SEED, SHORT

SOURCE = "A04 figure 3.16"
LAST = 4.0
"""Hours at the end."""


def run(context: Context) -> ItemResult:
    """Analyse the end of the recording of figure 3.15."""
    context.progress(0.0, "recording")
    rest = bench.motionless(HOURS * bench.HOUR, 1.0, 0.0, SEED)
    context.progress(0.7, "averaging")
    noises = bench.noises(rest, (HOURS - LAST) * bench.HOUR)
    setting = f"simulated; last {LAST:g} of {HOURS:g} h at 1 Hz, six channels"
    short = np.concatenate([bench.slopes(noise, 0.0, SHORT) for noise in noises.values()])
    last = [bench.slopes(noise, LONG, np.inf).max() for noise in noises.values()]
    trends, walks = (bench.channels_with(noises, term) for term in ("trend", "walk"))
    rows = (
        (f"slope up to {SHORT:g} s, mean", "", -0.5, short.mean()),
        (f"steepest slope from {LONG:g} s on, median", "", 0.5, np.median(last)),
        ("channels with trend", "", 0, trends),
        (
            "channels with a walk that is told from chance",
            "",
            None,
            walks,
        ),
    )
    return ItemResult(
        figures=tuple(figures_of(SOURCE, setting, rows)),
        plots=(Plot("Root Allan variance", "Dotted: terms of a1x.", bench.plot_deviation(noises)),),
        notes=(
            "Simulated, as figure 3.15. The trend is gone with the warming up. The walk of the "
            "unit, 2e-5 m/s2.5, meets the white noise at half an hour of averaging at 1 Hz, where "
            "4 hours leave few averages. A stronger one would show in figure 3.17, too, where the "
            "paper has none: at 1 kHz there is less white noise to hide it.",
        ),
    )


ITEM = Item(
    name="figure-3.16",
    source=SOURCE,
    title="Root Allan variance of the last 4 of 12 hours",
    group="sensing",
    run=run,
)
