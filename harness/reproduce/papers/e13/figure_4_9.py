"""E13 figure 4.9: three occlusions in one acquisition, over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    from harness.report.page import Plot
    from harness.reproduce.experiments.augmentation import Motion

SOURCE = "E13 figure 4.9"
RATIO = 5
OCCLUSIONS = ((1.0, 0.25), (2.0, 0.35), (3.2, 0.6))
"""Beginning, after what does not count, and length: 50, 70 and 120 samples in E13 [s]."""
SHOWN = 5.0
PAPER = 0.7
"""Largest error along axis y [mm]."""


def run(context: Context) -> ItemResult:
    """Hide the markers three times, from the simulated hand and in a slow trial of BROAD."""
    import numpy as np

    from harness.reproduce.experiments.augmentation import (
        AXIS,
        FILTERS,
        category,
        errors,
        estimate,
        recorded,
        stretch,
    )
    from harness.reproduce.experiments.augmented import MISSING
    from harness.reproduce.experiments.broad import TRIALS

    motions = [category(1, 1, RATIO), *recorded(context, RATIO, TRIALS[2:3])]
    figures, plots = [], []
    for place, motion in enumerate(motions):
        part = stretch(motion, SHOWN)
        hidden = [
            tuple(part.start + round(t / motion.period) for t in (begin, begin + length))
            for begin, length in OCCLUSIONS
        ]
        blind = motion.occluded(*hidden)
        found = {}
        for number, name in enumerate(FILTERS):
            share = (place + number / len(FILTERS)) / len(motions)
            context.progress(share, f"{name}, {motion.name}")
            outputs = estimate(name, blind)
            error = errors(motion, outputs)[0][part]
            found[name] = (outputs["position"][part], error)
            for quantity, paper, value in (
                ("axis y", PAPER, np.abs(error[:, AXIS]).max()),
                ("3-D", None, np.linalg.norm(error, axis=1).max()),
            ):
                figures.append(
                    Figure(
                        SOURCE,
                        f"position, largest error, {quantity}: {name}",
                        "mm",
                        paper,
                        float(1e3 * value),
                        f"{motion.name}; occlusions of 0.25, 0.35 and 0.6 s",
                    )
                )
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


def _plot(motion: Motion, part: slice, found: dict) -> Plot:
    import numpy as np
    from plotly.subplots import make_subplots

    from harness.report.page import Plot
    from harness.report.plots import GREY, layout, line
    from harness.reproduce.experiments.augmentation import AXIS
    from harness.reproduce.experiments.augmented import curves

    plot = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    time, new = motion.time[part], motion.new[part]
    true = 1e3 * motion.position[part, AXIS]
    plot.add_trace(line(time, true, GREY, "true", width=2.4), row=1, col=1)
    curves(plot, time, {n: 1e3 * place[:, AXIS] for n, (place, _) in found.items()}, 1, 1)
    seen = line(time[new], np.full(int(new.sum()), true.min()), GREY, "optical samples")
    seen.mode = "markers"
    seen.marker = {"symbol": "line-ns-open", "color": GREY, "size": 8}
    plot.add_trace(seen, row=1, col=1)
    curves(plot, time, {n: 1e3 * error[:, AXIS] for n, (_, error) in found.items()}, 2, 1)
    plot.update_yaxes(title_text="y, mm", row=1)
    plot.update_yaxes(title_text="error, axis y, mm", row=2)
    plot.update_xaxes(title_text="time, s", row=2)
    return Plot(
        f"Figure 4.9: {motion.name}",
        "Position along axis y, bars where an optical sample arrives, and the error.",
        layout(plot, 520),
    )


ITEM = Item(
    name="e13-figure-4.9",
    source=SOURCE,
    title="Position through three occlusions",
    group="sensing",
    run=run,
)
