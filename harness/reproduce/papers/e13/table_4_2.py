"""E13 table 4.2 and figures 4.6, 4.8: attitude between optical samples, by step."""

from harness.common.figures import Figure
from harness.report.page import Plot
from harness.reproduce.experiments.augmented import (
    MISSING,
    Augmented,
    augmented,
    by_step,
    figures,
    speed_note,
)
from harness.reproduce.item import Context, Item, ItemResult

SOURCE = "E13 table 4.2"
ROWS = {10: (0.7, 2.3), 5: (0.3, 1.2)}
"""Ratio: rms and 95 % at the worst step [deg]."""
SHOWN = {10: "4.6", 5: "4.8"}


def run(context: Context) -> ItemResult:
    """Follow motions of 20 deg/s, simulated, and recorded ones."""
    found: list[Figure] = []
    plots: list[Plot] = []
    parts: tuple[Augmented, ...] = ()
    cases = [(ratio, number) for ratio in ROWS for number in (1, 2)]
    for place, (ratio, number) in enumerate(cases):
        parts = augmented(context.part(place, len(cases)), number, ratio)
        setting = f"ratio {ratio}, motions of category {number}"
        found.extend(figures(SOURCE, "attitude", setting, parts, ROWS[ratio]))
        plots.append(by_step(f"Figure {SHOWN[ratio]}: {setting}", "attitude", parts))
    return ItemResult(
        figures=tuple(found),
        plots=tuple(plots),
        notes=(
            "Motions and filters are those of table 4.1: a simulated hand through the plants, and "
            "the recorded trials 02 and 10 (category 1) and 06 (category 2) of BROAD. E13 has one "
            "category of rates, turned by hand about axis y, and no calibration of the unit's "
            "axes: its errors contain that. The tracker of the plants has some 0.1 deg of "
            "noise.",
            speed_note(parts),
            *((MISSING,) if len(parts) == 1 else ()),
        ),
    )


ITEM = Item(
    name="e13-table-4.2",
    source=SOURCE,
    title="Attitude between optical samples, with figures 4.6 and 4.8",
    group="sensing",
    run=run,
    aliases=("e13-figure-4.6", "e13-figure-4.8"),
)
