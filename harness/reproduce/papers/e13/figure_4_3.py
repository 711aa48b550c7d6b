"""E13 figure 4.3: real and estimated position over time, with a part enlarged."""

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go

from harness.common.types import FloatArray
from harness.report.page import Plot
from harness.report.plots import GREY, grid, line
from harness.reproduce.experiments.augmentation import (
    AXIS,
    FILTERS,
    RecordedTrack,
    category,
    errors,
    recorded,
    stretch,
)
from harness.reproduce.experiments.augmentation import estimate as follow
from harness.reproduce.experiments.augmented import MISSING, curves
from harness.reproduce.experiments.broad import TRIALS
from harness.reproduce.item import Context, Item, ItemResult, figures_of

SOURCE = "E13 figure 4.3"
RATIO = 10
SHOWN, ENLARGED = 10.0, 0.4
"""Seconds that are shown."""


def run(context: Context) -> ItemResult:
    """Follow one acquisition of the simulated hand, and a slow trial of BROAD."""
    motions = [category(1, 1, RATIO), *recorded(context, RATIO, TRIALS[2:3])]
    figures, plots = [], []
    for place, motion in enumerate(motions):
        outputs = {}
        for number, name in enumerate(FILTERS):
            share = (place + number / len(FILTERS)) / len(motions)
            context.progress(share, f"{name}, {motion.name}")
            outputs[name] = follow(name, motion)
            error = errors(motion, outputs[name])[0][stretch(motion, SHOWN), AXIS]
            largest = 1e3 * np.abs(error).max()
            row = (f"position, largest error, axis y: {name}", "mm", None, largest)
            figures += figures_of(SOURCE, f"{motion.name}, {SHOWN:g} s", [row])
        plots.append(_plot(motion, {n: outputs[n]["position"] for n in outputs}))
    return ItemResult(
        figures=tuple(figures),
        plots=tuple(plots),
        notes=(
            "Simulated: a hand of velocity category 1 through the plants. Recorded: trial 10 of "
            "BROAD, slow translation; E13's own recording is not at hand. Between two optical "
            "samples errors grow, and the next one takes them back.",
            *((MISSING,) if len(motions) == 1 else ()),
        ),
    )


def _plot(motion: RecordedTrack, found: Mapping[str, FloatArray]) -> Plot:
    panels: list[list[list[go.Scatter]]] = [[], [], []]
    first = stretch(motion, SHOWN).start
    for seconds in (SHOWN, ENLARGED):
        part = slice(first, first + round(seconds / motion.period))
        time, new = motion.time[part], motion.new[part]
        for row, cells in enumerate(panels):
            true = 1e3 * motion.position[part, row]
            place = {name: 1e3 * values[part, row] for name, values in found.items()}
            cells.append([line(time, true, GREY, "true", width=2.4), *curves(time, place)])
            if seconds == ENLARGED:
                name = "optical samples"
                cells[-1].append(line(time[new], true[new], GREY, name, mode="markers"))
    plot = grid(panels, "time, s", ["x, mm", "y, mm", "z, mm"], 620, column_widths=[0.65, 0.35])
    return Plot(
        f"Figure 4.3: {motion.name}",
        "Position in the world, true and estimated; on the right the beginning, enlarged.",
        plot,
    )


ITEM = Item(
    name="e13-figure-4.3",
    source=SOURCE,
    title="Real and estimated position over time",
    group="sensing",
    run=run,
)
