"""A04 figure 7.5: the generalised backlash operator."""

import numpy as np

from harness.report.page import Plot
from harness.report.plots import SERIES, chart, line
from harness.reproduce.experiments.stack import operator
from harness.reproduce.item import Context, Item, ItemResult, figures_of

THRESHOLD = 20.0
"""r [V]; the figure has letters only."""
WEIGHTS = (1.0, 0.5)
"""w_h: 1 is a slope of 45 degrees."""
TOP = 60.0
"""Of the sine that drives it [V]."""
SOURCE = "A04 figure 7.5"


def run(context: Context) -> ItemResult:
    """Drive one play with a sine, for two weights."""
    volts = TOP * np.sin(np.linspace(0, 5 * np.pi, 2001))
    cycle = np.arange(len(volts)) > 400  # what is before is the way from rest
    figures, curves = [], []
    for weight, colour in zip(WEIGHTS, SERIES, strict=False):
        y = operator(volts, (THRESHOLD,), (weight,))
        rising = np.gradient(volts) > 0
        middle = np.abs(y) < 0.5 * weight * (TOP - THRESHOLD)
        offset = volts - y / weight  # r on the way up, -r on the way down
        width = offset[cycle & middle & rising].mean() - offset[cycle & middle & ~rising].mean()
        setting = f"r = {THRESHOLD:g} V, w_h = {weight:g}"
        row = ("width of the loop (paper: 2 r)", "V", 2 * THRESHOLD, width)
        figures += figures_of(SOURCE, setting, [row])
        curves.append(line(volts, y, colour, f"w_h = {weight:g}"))
    return ItemResult(
        figures=tuple(figures),
        plots=(
            Plot(
                "Backlash operator",
                f"Output of a play with the threshold r = {THRESHOLD:g} V over its input, from "
                "rest, for two weights.",
                chart(curves, "x, V", "y, V", 420),
            ),
        ),
        notes=("Equations (7.1) and (7.3), by the model `PrandtlIshlinskii` with one play.",),
    )


ITEM = Item(
    name="figure-7.5",
    source=SOURCE,
    title="Backlash operator: threshold and weight",
    group="hysteresis",
    run=run,
)
