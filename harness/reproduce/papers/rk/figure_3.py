"""RK figures 3 and 4: roll of a robot's wrist by electromagnetic tracker, alone and fused."""

import numpy as np

from harness.common.figures import Figure
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, chart, line, thinned
from harness.reproduce.experiments import trackers as bench
from harness.reproduce.experiments.trackers import EmRun
from harness.reproduce.item import Context, Item, ItemResult

SOURCE = "RK figure 4"
PAPER = {"tracker alone": 0.5, "fused, switched as printed": 0.2, "fused": 0.2}
"""Rms of the roll while moving [deg] (RK IV.A)."""
OVERSHOOT = 1.2
"""RK IV.A, of the fused roll where the robot starts or stops [deg]."""


def run(context: Context) -> ItemResult:
    """Turn the wrist, and set both estimates beside the robot's own."""
    context.progress(0.0, "robot, tracker and inertial unit")
    found = bench.rk_run()
    true = found.robot["attitude"]
    settled = found.time > bench.SETTLED
    moving = settled & (found.robot["moving"] > 0)
    figures = []
    for name, attitude in found.attitudes().items():
        roll = bench.angle_errors(attitude, true)[:, 0]
        whole = bench.total_angle(attitude, true)
        over = None if name == "tracker alone" else OVERSHOOT
        span = f"moving, {moving.sum() * bench.T:.0f} s"
        figures += [
            Figure(SOURCE, f"rms error of roll, {name}", "deg", PAPER[name],
                   bench.rms(roll[moving]), span),
            Figure(SOURCE, f"rms of the whole rotation's error, {name}", "deg", None,
                   bench.rms(whole[settled]), "moving and at rest"),
            Figure(SOURCE, f"overshoot of roll, {name}", "deg", over,
                   bench.overshoot(found, roll), f"within {bench.AFTER:g} s of starts and stops"),
        ]  # fmt: skip
    return ItemResult(
        figures=tuple(figures),
        plots=(_roll(found), _error(found)),
        notes=(
            "Simulated, all of it: scenario `em_tracking`. A wrist turns by -60 deg of roll and "
            "back, and by 17 deg of pitch and 23 deg of yaw at the same time, at constant rates "
            "between rests; three pieces of metal stand in the room. The plant's room is set so "
            "that the tracker alone has the paper's 0.5 deg of roll; latency, 25 ms, and the hold "
            "of 40 Hz are in it. Nothing was recorded.",
            "'Switched as printed' has RK's seven states and hard thresholds: gravity and field "
            "where the specific force is as long as gravity, else the tracker. 'Fused' takes all "
            "there is: distortion is a state, and gravity counts the less the more it departs from "
            "its slow mean in the world.",
        ),
    )


def _roll(found: EmRun) -> Plot:
    attitudes = {"robot": found.robot["attitude"], **found.attitudes()}
    curves = [
        line(
            *thinned(found.time, np.unwrap(bench.angles(attitude)[:, 0], period=360)), colour, name
        )
        for (name, attitude), colour in zip(attitudes.items(), (GREY, *SERIES), strict=False)
    ]
    plot = chart(curves, "time, s", "roll, deg")
    return Plot("Roll (figure 3)", "Roll of the robot, and what is made of it.", plot)


def _error(found: EmRun) -> Plot:
    curves = []
    for (name, attitude), colour in zip(found.attitudes().items(), SERIES, strict=False):
        error = bench.angle_errors(attitude, found.robot["attitude"])[:, 0]
        curves.append(line(*thinned(found.time, error), colour, name))
    plot = chart(curves, "time, s", "error of roll, deg", 420)
    plot.update_yaxes(range=[-2, 2])
    return Plot(
        "Error of roll (figure 4)",
        "Less the robot's roll at the same instant. The tracker is late, which shows while the "
        "robot moves.",
        plot,
    )


ITEM = Item(
    name="rk-figure-3",
    source="RK figures 3 and 4",
    title="Roll by an electromagnetic tracker with an inertial unit",
    group="em-tracking",
    run=run,
    aliases=("rk-figure-4",),
)
