"""C23 figures 8 to 10: attitude, rate and bias of a wrist by optical tracker and gyro."""

import numpy as np

from harness.common.figures import Figure
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, chart, components, line, thinned
from harness.reproduce.experiments import trackers as bench
from harness.reproduce.experiments.trackers import OpticalRun
from harness.reproduce.item import Context, Item, ItemResult, Row, figures_of

SECONDS = 50.0
REST = (2.0, 5.0)
"""At rest, before the robot moves [s]: the bias is measured here."""
RATE = -9.0
"""C23 3.1.3 [deg/s]."""


def run(context: Context) -> ItemResult:
    """Turn the wrist at a constant rate."""
    context.progress(0.0, "robot, tracker and gyro")
    found = bench.optical_run(SECONDS)
    true, time = found.robot["attitude"], found.time
    settled = time > bench.SETTLED
    steady = settled & (found.robot["moving"] > 1 - 1e-9)
    attitude = {
        "tracker": bench.total_angle(found.tracker["optical_attitude"], true),
        "filter": bench.total_angle(found.filtered["attitude"], true),
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
    kinds = {
        "C23 figure 8": ("rms error of the attitude", "deg", attitude, settled, all_along),
        "C23 figure 9": ("rms error of the rate, an axis", "deg/s", rate, steady, constant),
    }
    figures: list[Figure] = []
    for source, (quantity, unit, errors, part, setting) in kinds.items():
        for name, error in errors.items():
            row: Row = (f"{quantity}, {name}", unit, None, bench.rms(error[part]))
            figures += figures_of(source, setting, [row])
    noise = rate["gyro"][steady].std(axis=0).mean()
    row = ("rms noise of the rate, an axis, gyro", "deg/s", None, noise)
    figures += figures_of("C23 figure 9", constant, [row])
    for quantity, bias, setting in (
        ("that measured at rest", measured, f"; at rest over {REST[1] - REST[0]:g} s"),
        ("the true one", found.bias, ""),
    ):
        away = np.degrees(np.abs(last - bias)).max()
        row = (f"largest distance of the bias from {quantity}", "deg/s", None, away)
        figures += figures_of("C23 figure 10", f"after {SECONDS:g} s{setting}", [row])
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
    curves = (
        ("robot", GREY, found.time, found.robot["attitude"]),
        ("tracker", SERIES[1], found.time, found.tracker["optical_attitude"]),
        ("filter", SERIES[0], found.time, found.filtered["attitude"]),
    )
    plot = components(curves, "wxyz", 620)
    return Plot("Attitude (figure 8)", "Components of the quaternion.", plot)


def _rate(found: OpticalRun) -> Plot:
    curves = (
        ("gyro", SERIES[1], found.time, np.degrees(found.imu["rate"])),
        ("filter", SERIES[0], found.time, np.degrees(found.filtered["body_rate"])),
        ("robot", GREY, found.time, np.degrees(found.robot["rate"])),
    )
    plot = components(curves, [f"{axis}, deg/s" for axis in "xyz"], 560)
    return Plot("Rate (figure 9)", "Body rate.", plot)


def _bias(found: OpticalRun) -> Plot:
    curves = []
    ends = np.array([found.time[0], found.time[-1]])
    rest = (found.time > REST[0]) & (found.time < REST[1])
    measured = np.degrees(found.imu["rate"][rest].mean(axis=0))
    for axis in range(3):
        time, bias = thinned(found.time, np.degrees(found.filtered["rate_bias"][:, axis]))
        curves.append(line(time, bias, SERIES[axis], f"filter, {'xyz'[axis]}"))
        level = np.full(2, measured[axis])
        curves.append(line(ends, level, GREY, "gyro at rest", axis == 0, dash="dot"))
    plot = chart(curves, "time, s", "bias, deg/s")
    return Plot("Bias of the gyro (figure 10)", "Dotted: mean of the gyro at rest.", plot)


ITEM = Item(
    name="c23-figure-8",
    source="C23 figures 8 to 10",
    title="Attitude, rate and bias by an optical tracker with a gyro",
    group="optical-gyro",
    run=run,
    aliases=("c23-figure-9", "c23-figure-10"),
)
