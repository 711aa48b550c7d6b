"""A04 figure 7.6: the Prandtl-Ishlinskii operator and its loading curve."""

import numpy as np

from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, chart, line
from harness.reproduce.experiments.stack import operator
from harness.reproduce.item import Context, Item, ItemResult, figures_of

THRESHOLDS = (0.0, 10.0, 20.0, 30.0, 40.0)
"""r, n = 4, equally spaced [V]; the figure has letters only."""
WEIGHTS = (0.4, 0.2, 0.15, 0.15, 0.1)
"""w_h."""
TOP = 80.0
"""To which it is loaded [V]."""
SOURCE = "A04 figure 7.6"


def run(context: Context) -> ItemResult:
    """Drive the operator along its loading curve and the loop that follows."""
    up = np.linspace(0, TOP, 801)
    volts = np.concatenate((up, up[-2::-1], up[1:]))
    y = operator(volts, THRESHOLDS, WEIGHTS)
    ends = (*THRESHOLDS[1:], TOP)
    figures = []
    for index, (low, high) in enumerate(zip(THRESHOLDS, ends, strict=True)):
        inside = (up > low) & (up < high)
        slope = np.polyfit(up[inside], y[: len(up)][inside], 1)[0]
        quantity = f"slope W_h{index} of the loading curve (paper: by 7.6)"
        row = (quantity, "", sum(WEIGHTS[: index + 1]), slope)
        figures += figures_of(SOURCE, f"between {low:g} and {high:g} V", [row])
    curves = (
        line(volts[len(up) :], y[len(up) :], GREY, "loop after it", dash="dot"),
        line(up, y[: len(up)], SERIES[0], "initial loading curve", width=2.2),
    )
    plot = chart(curves, "x, V", "y, V", 420)
    for threshold in THRESHOLDS[1:]:
        plot.add_vline(threshold, line={"color": "#bbbbbb", "width": 1, "dash": "dash"})
    return ItemResult(
        figures=tuple(figures),
        plots=(
            Plot(
                "Loading curve",
                "Output of five plays: from rest along the loading curve, whose corners lie at "
                "the thresholds, then down to 0 V and back, where they lie at twice those.",
                plot,
            ),
        ),
        notes=(
            "Equations (7.4) to (7.6), by the model `PrandtlIshlinskii`. As in the thesis the "
            "output does not come back to 0 with the input.",
        ),
    )


ITEM = Item(
    name="figure-7.6",
    source=SOURCE,
    title="Prandtl-Ishlinskii operator and its loading curve",
    group="hysteresis",
    run=run,
)
