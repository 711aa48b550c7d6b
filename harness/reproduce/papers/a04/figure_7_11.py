"""A04 figure 7.11: slopes of the loading curve go with the rate."""

import numpy as np

from harness.identify.hysteresis.plays import SWEEP_TOP, loading_slopes
from harness.report.page import Plot
from harness.report.plots import SERIES, chart, line
from harness.reproduce.experiments.tracking import SWEEP, rate_dependence, sweep
from harness.reproduce.item import Context, Item, ItemResult, Row, figures_of

SOURCE = "A04 figure 7.11"
FAST = 750e-6
"""Rate up to which lines are looked at [m/s]: the fastest of 12.5 um p-p at 19 Hz (A04 7.3.2)."""
FIRST_LIMIT = 200e-6
"""The same of the first two slopes (figure 7.11) [m/s]."""


def run(context: Context) -> ItemResult:
    """Fit slopes to saw-teeth of one rate each, and lines through them."""
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
    span = f"at 750 um/s over that at {1e6 * rate[0]:.0f} um/s"
    rows: list[Row] = [
        (f"slope W_{play}, {span}", "", None, np.interp(FAST, rate, slope) / slope[0])
        for play, slope in enumerate(found.T)
    ]
    off = max(
        _off_line(rate, slope, FIRST_LIMIT if play < 2 else FAST)
        for play, slope in enumerate(found.T)
    )
    limit = "first two up to 200 um/s, others up to 750 um/s"
    rows.append((f"largest rms distance of a slope from a line, {limit}", "", None, off))
    return ItemResult(
        figures=tuple(figures_of(SOURCE, setting, rows)),
        plots=(_plot(rate, found),),
        notes=(
            "Each saw-tooth moves the stack at one rate, and gives slopes W_0 to W_8 by least "
            "squares, the saturation held; W_9 belongs to a play that these saw-teeth do not turn. "
            "As in the thesis the slopes go with the rate along lines; of the first two that holds "
            "for slow rates only: turning points get rounder, and at 7 V a sample there is hardly "
            "one sample in the first 8 V after a turn.",
        ),
    )


def _off_line(rate: np.ndarray, slope: np.ndarray, limit: float) -> float:
    """Return rms distance of slopes from their best line over the rates up to a limit."""
    slow = rate <= limit
    return float(
        np.std(slope[slow] - np.polyval(np.polyfit(rate[slow], slope[slow], 1), rate[slow]))
    )


def _plot(rate: np.ndarray, slopes: np.ndarray) -> Plot:
    curves = [
        line(1e6 * rate, slope, SERIES[play % len(SERIES)], f"W<sub>{play}</sub>",
             mode="lines+markers")
        for play, slope in enumerate(slopes.T)
    ]  # fmt: skip
    plot = chart(curves, "rate of the stroke, µm/s", "slope of the loading curve", 480)
    return Plot(
        "Slopes over the rate",
        "Sums of weights W of the plays, identified at one saw-tooth each.",
        plot,
    )


ITEM = Item(
    name="figure-7.11",
    source=SOURCE,
    title="Slopes of the loading curve over the rate",
    group="hysteresis",
    run=run,
)
