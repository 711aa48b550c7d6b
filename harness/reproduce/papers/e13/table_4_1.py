"""E13 table 4.1 and figures 4.4, 4.5, 4.7: position between optical samples, by step."""

from harness.common.figures import Figure
from harness.report.page import Plot
from harness.reproduce.experiments.augmented import (
    MISSING,
    augmented,
    by_step,
    figures,
    speed_note,
)
from harness.reproduce.item import Context, Item, ItemResult

SOURCE = "E13 table 4.1"
ROWS = {(1, 10): (0.2, 0.7), (2, 10): (0.9, 2.6), (2, 5): (0.5, 1.3)}
"""Velocity category and ratio: rms and 95 % at the worst step [mm]."""
SHOWN = {(1, 10): "4.4", (2, 10): "4.5", (2, 5): "4.7"}


def run(context: Context) -> ItemResult:
    """Follow slow and fast motions, simulated and recorded."""
    found: list[Figure] = []
    plots: list[Plot] = []
    notes: list[str] = []
    missing = False
    for place, (row, paper) in enumerate(ROWS.items()):
        parts = augmented(context.part(place, len(ROWS)), *row)
        setting = f"velocity category {row[0]}, ratio {row[1]}"
        found.extend(figures(SOURCE, "position", setting, parts, paper))
        plots.append(by_step(f"Figure {SHOWN[row]}: {setting}", "position", parts))
        if row[1] == 10:
            notes.append(f"Category {row[0]}. {speed_note(parts)}")
        missing = len(parts) == 1
    return ItemResult(
        figures=tuple(found),
        plots=tuple(plots),
        notes=(
            "E13's hand was recorded by its author. Here, first, a simulated hand along squares at "
            "E13's speeds and rates, twelve acquisitions of 10 s (after 10 s that do not count), "
            "through the plants: a tracker whose markers have 0.05 and 0.15 mm of noise, an "
            "inertial unit with bias, scale errors, a lever arm of 30 mm and a gyro 3 ms late. "
            "Errors are against the true motion.",
            "Then recorded: BROAD, inertial unit 285.7 Hz, each tenth or fifth sample of its "
            "optical motion capture given, the others held back as truth; the movement after 10 s "
            "counts. Slow trials (02, 10) stand for category 1, the fast one (06) for category 2; "
            "both are faster than E13's. Its unit sits centimetres beside the tracked point and "
            "lags: E13's filter knows nothing of either, ours learn both. "
            "The tracker alone is exact at step 0 there: its own sample is the truth.",
            *notes,
            *((MISSING,) if missing else ()),
        ),
    )


ITEM = Item(
    name="e13-table-4.1",
    source=SOURCE,
    title="Position between optical samples, with figures 4.4, 4.5 and 4.7",
    group="sensing",
    run=run,
    aliases=("e13-figure-4.4", "e13-figure-4.5", "e13-figure-4.7"),
)
