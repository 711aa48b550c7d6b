"""C23 figures 8 to 10: attitude, rate and bias of a wrist by optical tracker and gyro."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    from harness.report.page import Plot
    from harness.reproduce.experiments.trackers import OpticalRun

SECONDS = 50.0
REST = (2.0, 5.0)
"""At rest, before the robot moves [s]: the bias is measured here."""
RATE = -9.0
"""C23 3.1.3 [deg/s]."""


def run(context: Context) -> ItemResult:
    """Turn the wrist at a constant rate."""
    import numpy as np

    from harness.reproduce.experiments import trackers as bench

    context.progress(0.0, "robot, tracker and gyro")
    found = bench.optical_run(SECONDS)
    true, time = found.robot["attitude"], found.time
    settled = time > bench.SETTLED
    steady = settled & (found.robot["moving"] > 1 - 1e-9)
    attitude = {
        "tracker": bench.total(found.tracker["optical_attitude"], true),
        "filter": bench.total(found.filtered["attitude"], true),
    }
    rate = {
        "gyro": np.degrees(found.imu["rate"] - found.robot["rate"]),
        "filter": np.degrees(found.filtered["body_rate"] - found.robot["rate"]),
    }
    rest = (time > REST[0]) & (time < REST[1])
    measured = found.imu["rate"][rest].mean(axis=0)
    last = found.filtered["rate_bias"][-1]
    constant = f"turning at {RATE:g} deg/s about x, {steady.sum() * bench.T:.0f} s"
    all_along = "at rest, starting, turning, stopping"
    figures = [
        *(
            Figure("C23 figure 8", f"rms error of the attitude, {name}", "deg", None,
                   bench.rms(error[settled]), all_along)
            for name, error in attitude.items()
        ),
        *(
            Figure("C23 figure 9", f"rms error of the rate, an axis, {name}", "deg/s", None,
                   bench.rms(error[steady]), constant)
            for name, error in rate.items()
        ),
        Figure("C23 figure 9", "rms noise of the rate, an axis, gyro", "deg/s", None,
               float(rate["gyro"][steady].std(axis=0).mean()), constant),
        Figure("C23 figure 10", "largest distance of the bias from that measured at rest",
               "deg/s", None, float(np.degrees(np.abs(last - measured)).max()),
               f"after {SECONDS:g} s; at rest over {REST[1] - REST[0]:g} s"),
        Figure("C23 figure 10", "largest distance of the bias from the true one", "deg/s", None,
               float(np.degrees(np.abs(last - found.bias)).max()), f"after {SECONDS:g} s"),
    ]  # fmt: skip
    return ItemResult(
        figures=tuple(figures),
        plots=(_attitude(found), _rate(found), _bias(found)),
        notes=(
            "Simulated, all of it: scenario `optical_tracking`, without occlusions. A wrist rests, "
            f"turns at {RATE:g} deg/s about x for 20 s, rests, and turns back; four markers at "
            "62.5 Hz, 16 ms late, a gyro of 125 Hz. The tracker's error is latency and hold more "
            "than noise: C23 gives neither. The paper has curves but no numbers. Nothing was "
            "recorded.",
            "The gyro's error holds its bias. The wrist goes on turning at its stops, so that the "
            "filter, which takes the rate for constant, is late there.",
        ),
    )


def _attitude(found: OpticalRun) -> Plot:
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    from harness.report.page import Plot
    from harness.report.plots import GREY, SERIES, layout, line, thinned

    plot: go.Figure = make_subplots(rows=4, cols=1, shared_xaxes=True, vertical_spacing=0.03)
    curves = {
        "robot": (found.robot["attitude"], GREY),
        "tracker": (found.tracker["optical_attitude"], SERIES[1]),
        "filter": (found.filtered["attitude"], SERIES[0]),
    }
    for name, (values, colour) in curves.items():
        for row, letter in enumerate("wxyz"):
            curve = line(*thinned(found.time, values[:, row]), colour, name, row == 0)
            plot.add_trace(curve, row=row + 1, col=1)
            plot.update_yaxes(title_text=letter, row=row + 1, col=1)
    plot.update_xaxes(title_text="time, s", row=4, col=1)
    return Plot("Attitude (figure 8)", "Components of the quaternion.", layout(plot, 620))


def _rate(found: OpticalRun) -> Plot:
    import numpy as np
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    from harness.report.page import Plot
    from harness.report.plots import GREY, SERIES, layout, line, thinned

    plot: go.Figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.03)
    curves = {
        "gyro": (found.imu["rate"], SERIES[1]),
        "filter": (found.filtered["body_rate"], SERIES[0]),
        "robot": (found.robot["rate"], GREY),
    }
    for name, (values, colour) in curves.items():
        for row, axis in enumerate("xyz"):
            time, curve = thinned(found.time, np.degrees(values[:, row]))
            plot.add_trace(line(time, curve, colour, name, row == 0), row=row + 1, col=1)
            plot.update_yaxes(title_text=f"{axis}, deg/s", row=row + 1, col=1)
    plot.update_xaxes(title_text="time, s", row=3, col=1)
    return Plot("Rate (figure 9)", "Body rate.", layout(plot, 560))


def _bias(found: OpticalRun) -> Plot:
    import numpy as np
    import plotly.graph_objects as go

    from harness.report.page import Plot
    from harness.report.plots import GREY, SERIES, layout, line, thinned

    plot = go.Figure()
    ends = np.array([found.time[0], found.time[-1]])
    rest = (found.time > REST[0]) & (found.time < REST[1])
    measured = np.degrees(found.imu["rate"][rest].mean(axis=0))
    for axis in range(3):
        time, bias = thinned(found.time, np.degrees(found.filtered["rate_bias"][:, axis]))
        plot.add_trace(line(time, bias, SERIES[axis], f"filter, {'xyz'[axis]}"))
        level = np.full(2, measured[axis])
        plot.add_trace(line(ends, level, GREY, "gyro at rest", axis == 0, dash="dot"))
    plot.update_xaxes(title_text="time, s")
    plot.update_yaxes(title_text="bias, deg/s")
    return Plot("Bias of the gyro (figure 10)", "Dotted: mean of the gyro at rest.",
                layout(plot, 380))  # fmt: skip


ITEM = Item(
    name="c23-figure-8",
    source="C23 figures 8 to 10",
    title="Attitude, rate and bias by an optical tracker with a gyro",
    group="optical-gyro",
    run=run,
    aliases=("c23-figure-9", "c23-figure-10"),
)
