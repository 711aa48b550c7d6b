"""E13 figure 4.3: real and estimated position over time, with a part enlarged."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    from harness.report.page import Plot
    from harness.reproduce.experiments.augmentation import Motion

SOURCE = "E13 figure 4.3"
RATIO = 10
SHOWN, ENLARGED = 10.0, 0.4
"""Seconds that are shown."""


def run(context: Context) -> ItemResult:
    """One acquisition of the simulated hand, and a slow trial of BROAD."""
    import numpy as np

    from harness.reproduce.experiments.augmentation import (
        AXIS,
        FILTERS,
        category,
        errors,
        recorded,
        stretch,
    )
    from harness.reproduce.experiments.augmentation import estimate as follow
    from harness.reproduce.experiments.augmented import MISSING
    from harness.reproduce.experiments.broad import TRIALS

    motions = [category(1, 1, RATIO), *recorded(context, RATIO, TRIALS[2:3])]
    figures, plots = [], []
    for place, motion in enumerate(motions):
        outputs = {}
        for number, name in enumerate(FILTERS):
            share = (place + number / len(FILTERS)) / len(motions)
            context.progress(share, f"{name}, {motion.name}")
            outputs[name] = follow(name, motion)
            error = errors(motion, outputs[name])[0][stretch(motion, SHOWN), AXIS]
            figures.append(
                Figure(
                    SOURCE,
                    f"position, largest error, axis y: {name}",
                    "mm",
                    None,
                    float(1e3 * np.abs(error).max()),
                    f"{motion.name}, {SHOWN:g} s",
                )
            )
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


def _plot(motion: Motion, found: dict) -> Plot:
    from plotly.subplots import make_subplots

    from harness.report.page import Plot
    from harness.report.plots import GREY, layout, line
    from harness.reproduce.experiments.augmentation import stretch
    from harness.reproduce.experiments.augmented import curves

    plot = make_subplots(rows=3, cols=2, column_widths=[0.65, 0.35], vertical_spacing=0.06)
    for column, seconds in ((1, SHOWN), (2, ENLARGED)):
        first = stretch(motion, SHOWN).start
        part = slice(first, first + round(seconds / motion.period))
        time = motion.time[part]
        new = motion.new[part]
        for row in range(3):
            place = {n: 1e3 * values[part, row] for n, values in found.items()}
            true = 1e3 * motion.position[part, row]
            plot.add_trace(
                line(time, true, GREY, "true", row == 0 and column == 1, width=2.4),
                row=row + 1,
                col=column,
            )
            curves(plot, time, place, row + 1, column)
            if column == 2:
                seen = line(time[new], true[new], GREY, "optical samples", row == 0)
                seen.mode = "markers"
                plot.add_trace(seen, row=row + 1, col=column)
            plot.update_yaxes(title_text=f"{'xyz'[row]}, mm", row=row + 1, col=1)
    plot.update_xaxes(title_text="time, s", row=3)
    return Plot(
        f"Figure 4.3: {motion.name}",
        "Position in the world, true and estimated; on the right the beginning, enlarged.",
        layout(plot, 620),
    )


ITEM = Item(
    name="e13-figure-4.3",
    source=SOURCE,
    title="Real and estimated position over time",
    group="sensing",
    run=run,
)
