"""RK figure 5: pitch while a piece of metal is swayed beside the tracker's coils."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    import numpy as np

    from harness.report.page import Plot
    from harness.reproduce.experiments.trackers import EmRun

SOURCE = "RK figure 5"
SECONDS = 48.0
NEAR = ((5.0, 9.0), (17.0, 21.5), (24.5, 28.5), (37.0, 43.0))
"""When the metal is swayed, at rest and moving [s]."""
NEAREST, SWAY = 0.12, 0.05
"""Distance from the coils about which it is swayed, and how far [m]."""
AWAY = 1.0
"""Distance in between [m]."""


def swayed(time: np.ndarray) -> np.ndarray:
    """Place of the metal in W, (n, 3) [m]: round the origin of B, now near and now away."""
    import numpy as np

    near = np.zeros(len(time))
    for begin, end in NEAR:
        edges = np.clip(np.minimum(time - begin, end - time) / 0.5, 0, 1)
        near = np.maximum(near, edges**2 * (3 - 2 * edges))
    distance = AWAY + near * (NEAREST + SWAY * np.sin(2 * np.pi * 0.9 * time) - AWAY)
    turn, tilt = 2 * np.pi * 0.35 * time, 0.6 * np.sin(2 * np.pi * 0.23 * time)
    direction = np.column_stack(
        (np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt))
    )
    return distance[:, None] * direction


def run(context: Context) -> ItemResult:
    """Turn the wrist, sway the metal."""
    import numpy as np

    from harness.reproduce.experiments import trackers as bench

    context.progress(0.0, "robot, tracker and inertial unit")
    time = bench.T * np.arange(round(SECONDS / bench.T))
    found = bench.em_run(SECONDS, swayed(time))
    true = found.robot["attitude"]
    near = np.zeros(len(time), dtype=bool)
    for begin, end in NEAR:
        near |= (time >= begin) & (time <= end)
    figures = []
    for name, attitude in found.attitudes().items():
        pitch = bench.apart(attitude, true)[:, 1]
        for what, value in (("rms", bench.rms(pitch[near])),
                            ("largest", float(np.abs(pitch[near]).max()))):  # fmt: skip
            setting = f"while metal is near, {near.sum() * bench.T:.0f} s"
            figures.append(
                Figure(SOURCE, f"{what} error of pitch, {name}", "deg", None, value, setting)
            )
    return ItemResult(
        figures=tuple(figures),
        plots=(_plot(found),),
        notes=(
            "Simulated, all of it: as figure 3, and a sphere of 3 cm is swayed round the coils at "
            f"{100 * (NEAREST - SWAY):.0f} to {100 * (NEAREST + SWAY):.0f} cm, four times, at rest "
            "and moving. The paper has a curve but no numbers. Nothing was recorded.",
        ),
    )


def _plot(found: EmRun) -> Plot:
    import plotly.graph_objects as go

    from harness.report.page import Plot
    from harness.report.plots import GREY, SERIES, layout, line, thinned
    from harness.reproduce.experiments.trackers import angles

    plot = go.Figure()
    curves = {"robot": found.robot["attitude"], **found.attitudes()}
    for (name, attitude), colour in zip(curves.items(), (GREY, *SERIES), strict=False):
        plot.add_trace(line(*thinned(found.time, angles(attitude)[:, 1]), colour, name))
    for begin, end in NEAR:
        plot.add_vrect(x0=begin, x1=end, fillcolor="#888888", opacity=0.12, line_width=0)
    plot.update_xaxes(title_text="time, s")
    plot.update_yaxes(title_text="pitch, deg")
    return Plot(
        "Pitch while metal is swayed beside the coils",
        "Shaded while it is near.",
        layout(plot, 420),
    )


ITEM = Item(
    name="rk-figure-5",
    source=SOURCE,
    title="Pitch under manually introduced metal",
    group="em-tracking",
    run=run,
)
