"""RK figure 5: pitch while a piece of metal is swayed beside the tracker's coils."""

import numpy as np

from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, chart, line, shade, thinned
from harness.reproduce.experiments import trackers as bench
from harness.reproduce.experiments.trackers import EmRun
from harness.reproduce.item import Context, Item, ItemResult, Row, figures_of

SOURCE = "RK figure 5"
SECONDS = 48.0
NEAR = ((5.0, 9.0), (17.0, 21.5), (24.5, 28.5), (37.0, 43.0))
"""When the metal is swayed, at rest and moving [s]."""
NEAREST, SWAY = 0.12, 0.05
"""Distance from the coils about which it is swayed, and how far [m]."""
AWAY = 1.0
"""Distance in between [m]."""


def swayed(time: np.ndarray) -> np.ndarray:
    """Return place of the metal in W, (n, 3) [m]: round the origin of B, now near and now away."""
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
    context.progress(0.0, "robot, tracker and inertial unit")
    time = bench.T * np.arange(round(SECONDS / bench.T))
    found = bench.em_run(SECONDS, swayed(time))
    true = found.robot["attitude"]
    near = np.zeros(len(time), dtype=bool)
    for begin, end in NEAR:
        near |= (time >= begin) & (time <= end)
    rows: list[Row] = []
    for name, attitude in found.attitudes().items():
        pitch = bench.angle_errors(attitude, true)[near, 1]
        rows.append((f"rms error of pitch, {name}", "deg", None, bench.rms(pitch)))
        rows.append((f"largest error of pitch, {name}", "deg", None, np.abs(pitch).max()))
    setting = f"while metal is near, {near.sum() * bench.T:.0f} s"
    return ItemResult(
        figures=tuple(figures_of(SOURCE, setting, rows)),
        plots=(_plot(found),),
        notes=(
            "Simulated, all of it: as figure 3, and a sphere of 3 cm is swayed round the coils at "
            f"{100 * (NEAREST - SWAY):.0f} to {100 * (NEAREST + SWAY):.0f} cm, four times, at rest "
            "and moving. The paper has a curve but no numbers. Nothing was recorded.",
        ),
    )


def _plot(found: EmRun) -> Plot:
    attitudes = {"robot": found.robot["attitude"], **found.attitudes()}
    curves = [
        line(*thinned(found.time, bench.angles(attitude)[:, 1]), colour, name)
        for (name, attitude), colour in zip(attitudes.items(), (GREY, *SERIES), strict=False)
    ]
    plot = chart(curves, "time, s", "pitch, deg", 420)
    for begin, end in NEAR:
        shade(plot, begin, end)
    return Plot(
        "Pitch while metal is swayed beside the coils",
        "Shaded while it is near.",
        plot,
    )


ITEM = Item(
    name="rk-figure-5",
    source=SOURCE,
    title="Pitch under manually introduced metal",
    group="em-tracking",
    run=run,
)
