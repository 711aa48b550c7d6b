"""A04 figure 7.1: hysteresis depends on the rate."""

import numpy as np

from harness.report.page import Plot
from harness.report.plots import SERIES, chart, line
from harness.reproduce.experiments.stack import FINE_RATE, TRAVEL, off_line, sine
from harness.reproduce.item import Context, Item, ItemResult, figures_of

FREQUENCIES = (1.0, 19.0)
"""Ends of the band of table 7.1 [Hz]; the figure does not say its own."""
SLOW = 0.5
"""Slow enough for a static error [Hz]."""
STATIC_ERROR = 15.0
""""Typically about", in per cent of the travel (A04 7.1)."""
SOURCE = "A04 figure 7.1"


def run(context: Context) -> ItemResult:
    """Drive loops of stroke over voltage of the stack at two frequencies."""
    figures, loops = [], []
    for index, frequency in enumerate((SLOW, *FREQUENCIES)):
        context.progress(index / 3, f"{frequency:g} Hz")
        volts, stroke = sine(frequency, 1, FINE_RATE)
        off, half = off_line(volts, stroke), len(volts) // 2
        # Both branches at the same voltages: the cycle begins at its lowest one.
        rising = np.interp(volts[half:][::-1], volts[:half], stroke[:half])
        width = np.max(stroke[half:][::-1] - rising)
        setting = f"{frequency:g} Hz sine, 12.5 um p-p, no sensor noise"
        if frequency == SLOW:
            share = 100 * np.abs(off).max() / TRAVEL
            quantity = "largest hysteretic error in static positioning (paper: about)"
            setting = f"distance from the best straight line, in travels; {setting}"
            figures += figures_of("A04 7.1", setting, [(quantity, "%", STATIC_ERROR, share)])
            continue
        rows = (
            ("width of the loop", "% of travel", None, 100 * width / TRAVEL),
            ("rms distance from the best straight line", "um", None, np.std(off) * 1e6),
        )
        figures += figures_of(SOURCE, setting, rows)
        ring = np.append(np.arange(len(volts)), 0)
        name = f"{frequency:g} Hz"
        loops.append(line(volts[ring], stroke[ring] * 1e6, SERIES[index - 1], name))
    return ItemResult(
        figures=tuple(figures),
        plots=(
            Plot(
                "Loops at two frequencies",
                "Stroke of the stack over its voltage, one settled cycle of a sine of 12.5 µm p-p "
                "each.",
                chart(loops, "voltage, V", "stroke, µm", 460),
            ),
        ),
        notes=(
            "The plant's loop widens with the rate as that of the thesis's stack does. The thesis "
            "does not name the two frequencies; here they are the ends of the band of its "
            "table 7.1. The plant was fitted to chapter 7, so that the static error is no "
            "prediction.",
        ),
    )


ITEM = Item(
    name="figure-7.1",
    source=SOURCE,
    title="Hysteresis of a stack at two driving frequencies",
    group="hysteresis",
    run=run,
)
