"""A04 figure 7.11: slopes of the loading curve go with the rate."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    import numpy as np

    from harness.report.page import Plot

SOURCE = "A04 figure 7.11"
FAST = 750e-6
"""Rate up to which lines are looked at [m/s]: the fastest of 12.5 um p-p at 19 Hz (A04 7.3.2)."""
FIRST_LIMIT = 200e-6
"""The same of the first two slopes (figure 7.11) [m/s]."""


def run(context: Context) -> ItemResult:
    """Fit slopes to saw-teeth of one rate each, and lines through them."""
    import numpy as np

    from harness.identify.hysteresis.plays import SWEEP_TOP, loading_slopes
    from harness.reproduce.experiments.tracking import SWEEP, rate_dependence, sweep

    context.progress(0.0, "saw-teeth")
    volts, measured, where = sweep()
    context.progress(0.3, "identifying the rate-dependent operator")
    tracker = rate_dependence()
    context.progress(0.7, "slopes of each rate")
    rates, slopes = [], []
    for frequency, part in zip(SWEEP, where, strict=True):
        rates.append(2 * frequency * float(np.ptp(measured[part])))
        slopes.append(loading_slopes(volts[part], measured[part], tracker.parameters))
    rate, found = np.array(rates), np.array(slopes)
    # A play as wide as half the saw-tooth never moves again, and shows no slope.
    turning = 2 * np.asarray(tracker.parameters["thresholds"]) < SWEEP_TOP
    found = found[:, turning]
    setting = f"{len(SWEEP)} saw-teeth of {SWEEP[0]:g} to {SWEEP[-1]:g} Hz, {SWEEP_TOP:g} V"
    ratios = [
        Figure(
            SOURCE,
            f"slope W_{play}, at 750 um/s over that at {1e6 * rate[0]:.0f} um/s",
            "",
            None,
            float(np.interp(FAST, rate, found[:, play]) / found[0, play]),
            setting,
        )
        for play in range(found.shape[1])
    ]
    off = max(
        _off_line(rate, found[:, play], FIRST_LIMIT if play < 2 else FAST)
        for play in range(found.shape[1])
    )
    limit = "first two up to 200 um/s, others up to 750 um/s"
    return ItemResult(
        figures=(
            *ratios,
            Figure(
                SOURCE, f"largest rms distance of a slope from a line, {limit}", "", None, off,
                setting,
            ),
        ),
        plots=(_plot(rate, found),),
        notes=(
            "Each saw-tooth moves the stack at one rate, and gives slopes W_0 to W_8 by least "
            "squares, the saturation held; W_9 belongs to a play that these saw-teeth do not turn. "
            "As in the thesis the slopes go with the rate along lines; of the first two that holds "
            "for slow rates only: turning points get rounder, and at 7 V a sample there is hardly "
            "one sample in the first 8 V after a turn.",
        ),
    )  # fmt: skip


def _off_line(rate: np.ndarray, slope: np.ndarray, limit: float) -> float:
    """Rms distance of slopes from their best line over the rates up to a limit."""
    import numpy as np

    slow = rate <= limit
    return float(
        np.std(slope[slow] - np.polyval(np.polyfit(rate[slow], slope[slow], 1), rate[slow]))
    )


def _plot(rate: np.ndarray, slopes: np.ndarray) -> Plot:
    import plotly.graph_objects as go

    from harness.report.page import Plot
    from harness.report.plots import SERIES, layout, line

    plot = go.Figure()
    for play in range(slopes.shape[1]):
        curve = line(1e6 * rate, slopes[:, play], SERIES[play % len(SERIES)], f"W<sub>{play}</sub>")
        curve.mode = "lines+markers"
        plot.add_trace(curve)
    plot.update_xaxes(title_text="rate of the stroke, µm/s")
    plot.update_yaxes(title_text="slope of the loading curve")
    return Plot(
        "Slopes over the rate",
        "Sums of weights W of the plays, identified at one saw-tooth each.",
        layout(plot, 480),
    )


ITEM = Item(
    name="figure-7.11",
    source=SOURCE,
    title="Slopes of the loading curve over the rate",
    group="hysteresis",
    run=run,
)
