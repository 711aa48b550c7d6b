"""A04 table 7.1 and figures 7.12, 7.13: tracking of stationary sines."""

import numpy as np
import plotly.graph_objects as go

from harness.common.figures import Figure
from harness.report.page import Plot
from harness.report.plots import SERIES, grid, line
from harness.reproduce.experiments.tracking import FREQUENCIES, tone
from harness.reproduce.experiments.tracking_results import (
    WITHOUT,
    Found,
    mean_figures,
    plot_tracks,
    track_all,
)
from harness.reproduce.item import Context, Item, ItemResult, figures_of

SOURCE = "A04 table 7.1"
RMS = {
    "without model": (1.13, 1.12, 1.23, 1.19, 1.21, 1.30, 1.37),
    "rate-independent": (0.25, 0.19, 0.18, 0.14, 0.19, 0.27, 0.34),
    "rate-dependent": (0.21, 0.16, 0.16, 0.17, 0.17, 0.17, 0.18),
}
"""Of the error at each frequency [um]."""
MEANS = {
    "without model": (1.22, 2.30),
    "rate-independent": (0.23, 0.59),
    "rate-dependent": (0.18, 0.52),
}
"""Rms and largest error, mean over the frequencies [um]."""
NEAREST = "; paper: rate-dependent"
"""Setting of controllers that the paper does not have."""
SHOWN = 10.0
"""Frequency of figure 7.13 [Hz]."""


def run(context: Context) -> ItemResult:
    """Track sines of 12.5 um p-p from 1 to 19 Hz with each controller."""
    shapes = {f"{frequency:g} Hz": tone(frequency) for frequency in FREQUENCIES}
    found = track_all(context, shapes, 1)
    each: list[Figure] = []
    for name, errors in found.items():
        papers, beside = (RMS[name], "") if name in RMS else (RMS["rate-dependent"], NEAREST)
        for label, paper, rms in zip(shapes, papers, errors.rms, strict=True):
            row = (f"rms error, {name}", "um", paper, rms)
            each += figures_of(SOURCE, f"{label} sine{beside}", [row])
    over_time = plot_tracks(
        f"Figure 7.13: a sine of {SHOWN:g} Hz",
        "0.3 s of each controller.",
        found,
        FREQUENCIES.index(SHOWN),
        0.3,
    )
    return ItemResult(
        figures=(*mean_figures(SOURCE, "mean over sines of 1 to 19 Hz", found, MEANS), *each),
        plots=(_over_frequency(found), over_time),
        notes=(
            "Sines of 12.5 um p-p, 5 s each, on the plant. Every operator is identified from "
            "recordings of it with sensor noise: the rate-independent one from a sine of 10 Hz, "
            "the rate-dependent one from saw-teeth of 0.5 to 40 Hz, as in the thesis; modulated "
            "stops from an excitation of their own. The voltage of an instant comes from demands "
            "up to it. Sensor noise of 0.07 um rms is in all numbers.",
        ),
    )


def _over_frequency(found: Found) -> Plot:
    frequencies = np.array(FREQUENCIES)
    rms: list[go.Scatter] = []
    largest: list[go.Scatter] = []
    for (name, errors), colour in zip(found.items(), SERIES, strict=False):
        if name == WITHOUT:
            continue
        for curves, values in ((rms, errors.rms), (largest, errors.largest)):
            curves.append(line(frequencies, values, colour, name, mode="lines+markers"))
        if name in RMS:
            rms.append(line(frequencies, np.array(RMS[name]), colour, f"{name}, A04", dash="dot"))
    plot = grid([[rms, largest]], "frequency, Hz", ["rms error, µm", "largest error, µm"], 420)
    plot.update_yaxes(rangemode="tozero")
    return Plot(
        "Figure 7.12: errors over the frequency",
        "Rms (left, that of the thesis dotted) and largest error of each controller.",
        plot,
    )


ITEM = Item(
    name="table-7.1",
    source=SOURCE,
    title="Tracking of stationary sines, with figures 7.12 and 7.13",
    group="hysteresis",
    run=run,
    aliases=("figure-7.12", "figure-7.13"),
)
