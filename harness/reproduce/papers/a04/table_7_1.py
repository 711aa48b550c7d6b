"""A04 table 7.1 and figures 7.12, 7.13: tracking of stationary sines."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    from collections.abc import Mapping

    from harness.report.page import Plot
    from harness.reproduce.experiments.tables import Column

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
SHOWN = 10.0
"""Frequency of figure 7.13 [Hz]."""


def run(context: Context) -> ItemResult:
    """Track sines of 12.5 um p-p from 1 to 19 Hz with each controller."""
    from harness.reproduce.experiments.tables import columns, figures
    from harness.reproduce.experiments.tracking import FREQUENCIES, tone

    shapes = {f"{frequency:g} Hz": tone(frequency) for frequency in FREQUENCIES}
    found = columns(shapes, context.progress, 1)
    context.progress(0.98, "plots")
    each = [
        Figure(
            SOURCE,
            f"rms error, {name}",
            "um",
            RMS[name][k] if name in RMS else RMS["rate-dependent"][k],
            float(column.rms[k]),
            f"{label} sine{'' if name in RMS else '; paper: rate-dependent'}",
        )
        for name, column in found.items()
        for k, label in enumerate(shapes)
    ]
    return ItemResult(
        figures=(*figures(SOURCE, "mean over sines of 1 to 19 Hz", found, MEANS), *each),
        plots=(_over_frequency(found), _over_time(found)),
        notes=(
            "Sines of 12.5 um p-p, 5 s each, on the plant. Every operator is identified from "
            "recordings of it with sensor noise: the rate-independent one from a sine of 10 Hz, "
            "the rate-dependent one from saw-teeth of 0.5 to 40 Hz, as in the thesis; modulated "
            "stops from an excitation of their own. The voltage of an instant comes from demands "
            "up to it. Sensor noise of 0.07 um rms is in all numbers.",
        ),
    )


def _over_frequency(found: Mapping[str, Column]) -> Plot:
    import numpy as np
    from plotly.subplots import make_subplots

    from harness.report.page import Plot
    from harness.report.plots import SERIES, layout, line
    from harness.reproduce.experiments.tables import WITHOUT
    from harness.reproduce.experiments.tracking import FREQUENCIES

    frequencies = np.array(FREQUENCIES)
    plot = make_subplots(rows=1, cols=2, horizontal_spacing=0.1)
    for index, (name, column) in enumerate(found.items()):
        if name == WITHOUT:
            continue
        for place, values in enumerate((column.rms, column.largest), start=1):
            curve = line(frequencies, values, SERIES[index], name, place == 1)
            curve.mode = "lines+markers"
            plot.add_trace(curve, row=1, col=place)
        if name in RMS:
            paper = line(
                frequencies, np.array(RMS[name]), SERIES[index], f"{name}, A04", dash="dot"
            )
            plot.add_trace(paper, row=1, col=1)
    plot.update_xaxes(title_text="frequency, Hz")
    plot.update_yaxes(title_text="rms error, µm", rangemode="tozero", row=1, col=1)
    plot.update_yaxes(title_text="largest error, µm", rangemode="tozero", row=1, col=2)
    return Plot(
        "Figure 7.12: errors over the frequency",
        "Rms (left, that of the thesis dotted) and largest error of each controller.",
        layout(plot, 420),
    )


def _over_time(found: Mapping[str, Column]) -> Plot:
    from harness.reproduce.experiments.plots import tracks
    from harness.reproduce.experiments.tracking import FREQUENCIES

    place = FREQUENCIES.index(SHOWN)
    return tracks(
        "Figure 7.13: a sine of 10 Hz",
        "Demand and what is measured (left), and the difference (right), 0.3 s of each controller.",
        {name: column.tracks[place] for name, column in found.items()},
        0.3,
    )


ITEM = Item(
    name="table-7.1",
    source=SOURCE,
    title="Tracking of stationary sines, with figures 7.12 and 7.13",
    group="hysteresis",
    run=run,
    aliases=("figure-7.12", "figure-7.13"),
)
