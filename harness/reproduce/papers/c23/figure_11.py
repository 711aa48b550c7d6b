"""C23 figure 11: an occlusion of half a second, held and bridged."""

import numpy as np

from harness.common.figures import Figure
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, grid, line, shade
from harness.reproduce.experiments import trackers as bench
from harness.reproduce.experiments.trackers import OpticalRun
from harness.reproduce.item import Context, Item, ItemResult, Row, figures_of

SOURCE = "C23 figure 11"
BEGIN, LENGTHS = 12.0, (0.5, 1.0, 2.0)
"""Of the occlusion [s], while the wrist turns; the paper's is the first length."""
SHOWN = 1.5
"""Before and after it [s]."""


def run(context: Context) -> ItemResult:
    """Turn the wrist at a constant rate behind something that stands in the line of sight."""
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
        rows: list[Row] = []
        for name, attitude in attitudes.items():
            error = bench.total_angle(attitude, found.robot["attitude"])
            quantity = f"largest error of the attitude, {name}"
            rows.append((quantity, "deg", None, error[after].max()))
        rate = np.degrees(found.filtered["body_rate"] - found.robot["rate"])
        quantity = "rms error of the rate, an axis, filter"
        rows.append((quantity, "deg/s", None, bench.rms(rate[after])))
        figures += figures_of(SOURCE, setting, rows)
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
    shown = found.time > BEGIN - SHOWN
    time = found.time[shown]
    attitudes = {
        "tracker": (found.tracker["optical_attitude"], SERIES[1]),
        "filter": (found.filtered["attitude"], SERIES[0]),
        "robot": (found.robot["attitude"], GREY),
    }
    rates = {
        "gyro": (found.imu["rate"], SERIES[2]),
        "filter": (found.filtered["body_rate"], SERIES[0]),
        "robot": (found.robot["rate"], GREY),
    }
    panels = [
        [line(time, bench.angles(values[shown])[:, 0], colour, name)
         for name, (values, colour) in attitudes.items()],
        [line(time, np.degrees(values[shown, 0]), colour, name)
         for name, (values, colour) in rates.items()],
    ]  # fmt: skip
    plot = grid([panels], "time, s", ["roll, deg", "rate about x, deg/s"], 400)
    shade(plot, BEGIN, BEGIN + length)
    return Plot(
        "Occlusion of half a second",
        "Shaded while nothing is seen; what was seen before still arrives for 16 ms.",
        plot,
    )


ITEM = Item(
    name="c23-figure-11",
    source=SOURCE,
    title="Occlusion of the optical tracker",
    group="optical-gyro",
    run=run,
)
