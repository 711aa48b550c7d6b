"""A04 figure 7.10: the inverse operator is the mirror image of the operator."""

import numpy as np

from fmu_src.kit.runner import Runner
from fmu_src.piezo import inverse_prandtl_ishlinskii
from fmu_src.piezo.prandtl_ishlinskii import NOMINAL
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, chart, line
from harness.reproduce.experiments.stack import run_operator
from harness.reproduce.item import Context, Item, ItemResult, figures_of

TOP = 80.0
"""Largest voltage of the loops [V]."""
TURNS = 4
"""Loops, each smaller than the one before."""
SOURCE = "A04 figure 7.10"


def run(context: Context) -> ItemResult:
    """Drive loops of the operator, and those of its inverse for the strokes that it made."""
    turn = np.linspace(0, 2 * np.pi * TURNS, 4001)
    volts = TOP / 2 * (1 - (1 - turn / turn[-1]) * np.cos(turn))
    rise = volts[0] * np.linspace(0, 1, 200, endpoint=False)
    volts = np.concatenate((rise, volts))
    stroke = run_operator({}, volts)
    inverse = Runner(inverse_prandtl_ishlinskii.MODEL).run(len(stroke), {"stroke": stroke})["volts"]
    made = run_operator({}, inverse)

    acting = stroke / NOMINAL
    ends = np.array([0.0, max(TOP, acting.max())])
    curves = (
        line(ends, ends, GREY, "45° line", dash="dot"),
        line(acting, inverse, SERIES[1], "inverse operator", width=1.2),
        line(volts, acting, SERIES[0], "operator", width=2.4),
    )
    title = "input, V (voltage; stroke over nominal stroke per volt)"
    plot = chart(curves, title, "output, V", 560)
    plot.update_yaxes(scaleanchor="x")
    setting = f"shipped weights; {TURNS} loops of falling size, 0 to {TOP:g} V"
    mirror, identity = np.abs(inverse - volts).max(), np.abs(made - stroke).max()
    rows = (
        ("largest distance of the inverse's loops from the mirror image", "uV", None, mirror * 1e6),
        ("largest error of the operator after its inverse (paper: identity 7.11)", "nm", 0.0,
         identity * 1e9),
    )  # fmt: skip
    return ItemResult(
        figures=tuple(figures_of(SOURCE, setting, rows)),
        plots=(
            Plot(
                "Operator and inverse",
                "Stroke over voltage of the operator, and voltage over stroke of its inverse; "
                "both in volts, to one scale.",
                plot,
            ),
        ),
        notes=(
            "The inverse (7.12) to (7.14) is driven by the strokes that the operator makes of "
            "falling loops. It gives the voltages back to rounding: its loops are the operator's, "
            "mirrored about the 45 degree line.",
        ),
    )


ITEM = Item(
    name="figure-7.10",
    source=SOURCE,
    title="Operator and its inverse, mirrored about the 45 degree line",
    group="hysteresis",
    run=run,
)
