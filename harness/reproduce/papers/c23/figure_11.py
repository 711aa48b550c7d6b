"""C23 figure 11: an occlusion of half a second, held and bridged."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    from harness.report.page import Plot
    from harness.reproduce.experiments.trackers import OpticalRun

SOURCE = "C23 figure 11"
BEGIN, LENGTHS = 12.0, (0.5, 1.0, 2.0)
"""Of the occlusion [s], while the wrist turns; the paper's is the first length."""
SHOWN = 1.5
"""Before and after it [s]."""


def run(context: Context) -> ItemResult:
    """Turn the wrist at a constant rate behind something that stands in the line of sight."""
    import numpy as np

    from harness.reproduce.experiments import trackers as bench

    figures: list[Figure] = []
    plots: list[Plot] = []
    for k, length in enumerate(LENGTHS):
        context.progress(k / len(LENGTHS), f"occlusion of {length:g} s")
        count = round((BEGIN + length + SHOWN) / bench.T)
        time = bench.T * np.arange(count)
        hidden = (time >= BEGIN) & (time < BEGIN + length)
        found = bench.optical_run(count * bench.T, hidden.astype(float))
        after = (time >= BEGIN) & (time < BEGIN + length + 0.05)
        setting = f"{length:g} s, turning at -9 deg/s"
        attitudes = {
            "tracker held": found.tracker["optical_attitude"],
            "filter": found.filtered["attitude"],
        }
        for name, attitude in attitudes.items():
            error = bench.total(attitude, found.robot["attitude"])
            figures.append(
                Figure(SOURCE, f"largest error of the attitude, {name}", "deg", None,
                       float(error[after].max()), setting)
            )  # fmt: skip
        rate = np.degrees(found.filtered["body_rate"] - found.robot["rate"])
        figures.append(
            Figure(SOURCE, "rms error of the rate, an axis, filter", "deg/s", None,
                   bench.rms(rate[after]), setting)
        )  # fmt: skip
        if k == 0:
            plots.append(_plot(found, length))
    return ItemResult(
        figures=tuple(figures),
        plots=tuple(plots),
        notes=(
            "Simulated, all of it: as figure 8. Held, the tracker is wrong by what the wrist turns "
            "through, 4.5 deg in half a second. C23 holds the gyro's measurement as well; here the "
            "gyro goes on, as it has no line of sight. The filter also says that the tracker is "
            "lost (`optical_lost`). The paper has curves but no numbers. Nothing was recorded.",
        ),
    )


def _plot(found: OpticalRun, length: float) -> Plot:
    import numpy as np
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    from harness.report.page import Plot
    from harness.report.plots import GREY, SERIES, layout, line
    from harness.reproduce.experiments.trackers import angles

    shown = found.time > BEGIN - SHOWN
    time = found.time[shown]
    plot: go.Figure = make_subplots(rows=1, cols=2, horizontal_spacing=0.09)
    roll = {
        "tracker": (found.tracker["optical_attitude"], SERIES[1]),
        "filter": (found.filtered["attitude"], SERIES[0]),
        "robot": (found.robot["attitude"], GREY),
    }
    for name, (values, colour) in roll.items():
        curve = line(time, angles(values[shown])[:, 0], colour, name)
        plot.add_trace(curve, row=1, col=1)
    rates = {
        "gyro": (found.imu["rate"], SERIES[2]),
        "filter": (found.filtered["body_rate"], SERIES[0]),
        "robot": (found.robot["rate"], GREY),
    }
    for name, (values, colour) in rates.items():
        curve = line(time, np.degrees(values[shown, 0]), colour, name, name == "gyro")
        plot.add_trace(curve, row=1, col=2)
    for column, title in ((1, "roll, deg"), (2, "rate about x, deg/s")):
        plot.add_vrect(
            x0=BEGIN, x1=BEGIN + length, fillcolor="#888888", opacity=0.12, line_width=0, row=1,
            col=column,
        )  # fmt: skip
        plot.update_yaxes(title_text=title, row=1, col=column)
    plot.update_xaxes(title_text="time, s")
    return Plot(
        "Occlusion of half a second",
        "Shaded while nothing is seen; what was seen before still arrives for 16 ms.",
        layout(plot, 400),
    )


ITEM = Item(
    name="c23-figure-11",
    source=SOURCE,
    title="Occlusion of the optical tracker",
    group="optical-gyro",
    run=run,
)
