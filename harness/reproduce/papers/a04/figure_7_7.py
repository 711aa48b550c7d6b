"""A04 figure 7.7: dead zone and saturation."""

import numpy as np

from harness.common.figures import Figure
from harness.report.page import Plot
from harness.report.plots import SERIES, grid, line
from harness.reproduce.experiments.stack import operator
from harness.reproduce.item import Context, Item, ItemResult

THRESHOLD, GAIN = 30.0, 0.5
"""d and w_s of the dead zone [V]; the figure has letters only."""
THRESHOLDS = (0.0, 30.0, 60.0)
"""d of the saturation, m = 2 [V]."""
WEIGHTS = (1.0, -0.4, -0.3)
"""w_s."""
TOP = 90.0
"""To which it is driven [V]."""
SOURCE = "A04 figure 7.7"


def run(context: Context) -> ItemResult:
    """Drive one dead zone, and three of them that make a saturation."""
    y = np.linspace(-TOP / 3, TOP, 1201)
    # A single play with r = 0 hands its input on, so that only the saturation is left.
    zone = operator(y, dead_zones=(0.0, THRESHOLD), saturation=(0.0, GAIN))
    curve = operator(y, dead_zones=THRESHOLDS, saturation=WEIGHTS)
    places = [(zone, THRESHOLD, TOP, GAIN, "dead zone, slope above d (paper: w_s)", "d = 30 V")]
    for index, (low, high) in enumerate(zip(THRESHOLDS, (*THRESHOLDS[1:], TOP), strict=True)):
        name = f"saturation, slope W_s{index} (paper: sum of weights)"
        between = f"between {low:g} and {high:g} V"
        places.append((curve, low, high, sum(WEIGHTS[: index + 1]), name, between))
    figures = []
    for z, low, high, slope, name, setting in places:
        inside = (y > low) & (y < high)
        found = float(np.polyfit(y[inside], z[inside], 1)[0])
        figures.append(Figure(SOURCE, name, "", slope, found, setting))
    panels = (
        [line(y, zone, SERIES[0], "dead zone", width=2.2)],
        [line(y, curve, SERIES[1], "saturation", width=2.2)],
    )
    plot = grid([panels], "y, V", ["z, V"], 380)
    for place in THRESHOLDS[1:]:
        plot.add_vline(place, line={"color": "#bbbbbb", "width": 1, "dash": "dash"}, row=1, col=2)
    return ItemResult(
        figures=tuple(figures),
        plots=(
            Plot(
                "Dead zone and saturation",
                f"One one-sided dead zone with d = {THRESHOLD:g} V and w_s = {GAIN:g} (left), and "
                "the weighted sum of three (right).",
                plot,
            ),
        ),
        notes=(
            "Equations (7.7) and (7.8), by the model `PrandtlIshlinskii`. The first dead zone of "
            "a saturation is open: d = 0 hands negative inputs on, too.",
        ),
    )


ITEM = Item(
    name="figure-7.7",
    source=SOURCE,
    title="Dead zone and saturation operators",
    group="hysteresis",
    run=run,
)
