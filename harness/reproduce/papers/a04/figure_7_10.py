"""A04 figure 7.10: the inverse operator is the mirror image of the operator."""

from __future__ import annotations

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

TOP = 80.0
"""Largest voltage of the loops [V]."""
TURNS = 4
"""Loops, each smaller than the one before."""
SOURCE = "A04 figure 7.10"


def run(context: Context) -> ItemResult:
    """Loops of the operator, and those of its inverse for the strokes that it made."""
    import numpy as np
    import plotly.graph_objects as go

    from fmu_src.kit.runner import Runner
    from fmu_src.piezo import inverse_prandtl_ishlinskii
    from fmu_src.piezo.prandtl_ishlinskii import NOMINAL
    from harness.report.page import Plot
    from harness.report.plots import GREY, SERIES, layout, line
    from harness.reproduce.experiments.stack import run_operator

    turn = np.linspace(0, 2 * np.pi * TURNS, 4001)
    volts = TOP / 2 * (1 - (1 - turn / turn[-1]) * np.cos(turn))
    rise = volts[0] * np.linspace(0, 1, 200, endpoint=False)
    volts = np.concatenate((rise, volts))
    stroke = run_operator({}, volts)
    inverse = Runner(inverse_prandtl_ishlinskii.MODEL).run(len(stroke), {"stroke": stroke})["volts"]
    made = run_operator({}, inverse)

    plot = go.Figure()
    acting = stroke / NOMINAL
    ends = np.array([0.0, max(TOP, acting.max())])
    plot.add_trace(line(ends, ends, GREY, "45° line", dash="dot"))
    plot.add_trace(line(acting, inverse, SERIES[1], "inverse operator", width=1.2))
    plot.add_trace(line(volts, acting, SERIES[0], "operator", width=2.4))
    plot.update_xaxes(title_text="input, V (voltage; stroke over nominal stroke per volt)")
    plot.update_yaxes(title_text="output, V", scaleanchor="x")
    setting = f"shipped weights; {TURNS} loops of falling size, 0 to {TOP:g} V"
    mirror = float(np.abs(inverse - volts).max())
    identity = float(np.abs(made - stroke).max())
    return ItemResult(
        figures=(
            Figure(SOURCE, "largest distance of the inverse's loops from the mirror image", "uV",
                   None, mirror * 1e6, setting),
            Figure(SOURCE, "largest error of the operator after its inverse (paper: identity 7.11)",
                   "nm", 0.0, identity * 1e9, setting),
        ),
        plots=(
            Plot(
                "Operator and inverse",
                "Stroke over voltage of the operator, and voltage over stroke of its inverse; "
                "both in volts, to one scale.",
                layout(plot, 560),
            ),
        ),
        notes=(
            "The inverse (7.12) to (7.14) is driven by the strokes that the operator makes of "
            "falling loops. It gives the voltages back to rounding: its loops are the operator's, "
            "mirrored about the 45 degree line.",
        ),
    )  # fmt: skip


ITEM = Item(
    name="figure-7.10",
    source=SOURCE,
    title="Operator and its inverse, mirrored about the 45 degree line",
    group="hysteresis",
    run=run,
)
