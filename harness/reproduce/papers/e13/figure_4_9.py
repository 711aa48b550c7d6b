"""E13 figure 4.9: three occlusions in one acquisition, over time."""

from typing import Any

import numpy as np

from harness.report.page import Plot
from harness.report.plots import GREY, grid, line
from harness.reproduce.experiments.augmentation import (
    AXIS,
    FILTERS,
    RecordedTrack,
    category,
    errors,
    estimate,
    recorded,
    stretch,
)
from harness.reproduce.experiments.augmented import MISSING, curves
from harness.reproduce.experiments.broad import TRIALS
from harness.reproduce.item import Context, Item, ItemResult, figures_of

SOURCE = "E13 figure 4.9"
RATIO = 5
OCCLUSIONS = ((1.0, 0.25), (2.0, 0.35), (3.2, 0.6))
"""Beginning, after what does not count, and length: 50, 70 and 120 samples in E13 [s]."""
SHOWN = 5.0
PAPER = 0.7
"""Largest error along axis y [mm]."""


def run(context: Context) -> ItemResult:
    """Hide the markers three times, from the simulated hand and in a slow trial of BROAD."""
    motions = [category(1, 1, RATIO), *recorded(context, RATIO, TRIALS[2:3])]
    figures, plots = [], []
    for place, motion in enumerate(motions):
        part = stretch(motion, SHOWN)
        occlusions = [
            tuple(part.start + round(t / motion.period) for t in (begin, begin + length))
            for begin, length in OCCLUSIONS
        ]
        largest = "position, largest error"
        setting = f"{motion.name}; occlusions of 0.25, 0.35 and 0.6 s"
        blind = motion.occluded(*occlusions)
        found = {}
        for number, name in enumerate(FILTERS):
            share = (place + number / len(FILTERS)) / len(motions)
            context.progress(share, f"{name}, {motion.name}")
            outputs = estimate(name, blind)
            error = errors(motion, outputs)[0][part]
            found[name] = (outputs["position"][part], error)
            rows = (
                (f"{largest}, axis y: {name}", "mm", PAPER, 1e3 * np.abs(error[:, AXIS]).max()),
                (f"{largest}, 3-D: {name}", "mm", None, 1e3 * np.linalg.norm(error, axis=1).max()),
            )
            figures += figures_of(SOURCE, setting, rows)
        plots.append(_plot(blind, part, found))
    return ItemResult(
        figures=tuple(figures),
        plots=tuple(plots),
        notes=(
            "Simulated: a hand of 40 mm/s in the mean through the plants, inertial 200 Hz, optical "
            "40 Hz. Recorded: trial 10 of BROAD, slow translation, each fifth optical sample. "
            "E13's own recording is not at hand; where it hid the markers is not told.",
            *((MISSING,) if len(motions) == 1 else ()),
        ),
    )


def _plot(motion: RecordedTrack, part: slice, found: dict[str, Any]) -> Plot:
    time, new = motion.time[part], motion.new[part]
    true = 1e3 * motion.position[part, AXIS]
    at = np.full(int(new.sum()), true.min())
    optical = line(time[new], at, GREY, "optical samples", mode="markers")
    optical.marker = {"symbol": "line-ns-open", "color": GREY, "size": 8}
    panels = [
        [[
            line(time, true, GREY, "true", width=2.4),
            *curves(time, {name: 1e3 * place[:, AXIS] for name, (place, _) in found.items()}),
            optical,
        ]],
        [curves(time, {name: 1e3 * error[:, AXIS] for name, (_, error) in found.items()})],
    ]  # fmt: skip
    plot = grid(panels, "time, s", ["y, mm", "error, axis y, mm"], 520)
    return Plot(
        f"Figure 4.9: {motion.name}",
        "Position along axis y, bars where an optical sample arrives, and the error.",
        plot,
    )


ITEM = Item(
    name="e13-figure-4.9",
    source=SOURCE,
    title="Position through three occlusions",
    group="sensing",
    run=run,
)
