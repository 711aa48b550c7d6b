"""A04 table 7.3 and figure 7.15: tracking of recorded tremor."""

from __future__ import annotations

from harness.reproduce.item import Context, Item, ItemResult

SOURCE = "A04 table 7.3"
HANDS = "hand_motion_m2s2"
PAPER = {
    "without model": (1.05, 2.26),
    "rate-independent": (0.34, 0.95),
    "rate-dependent": (0.18, 0.60),
}
"""Rms and largest error [um]."""


def run(context: Context) -> ItemResult:
    """Track the tremor of recorded hands, scaled to 12.5 um p-p, with each controller."""
    from harness.recordings.motion import recordings
    from harness.reproduce.experiments.plots import tracks
    from harness.reproduce.experiments.tables import columns, figures
    from harness.reproduce.experiments.tracking import tremor

    shapes = {path.stem: tremor(path) for path in recordings([context.recordings(HANDS)])}
    found = columns(shapes, context.progress, 60)
    context.progress(0.98, "plots")
    demand = f"mean over {len(shapes)} recorded hands, 6 to 16 Hz, scaled to 12.5 um p-p"
    return ItemResult(
        figures=tuple(figures(SOURCE, demand, found, PAPER)),
        plots=(
            tracks(
                f"Figure 7.15: tremor of {next(iter(shapes))}",
                "Demand and what is measured (left), and the difference (right), of each "
                "controller; the first recording.",
                {name: column.tracks[0] for name, column in found.items()},
                2.0,
            ),
        ),
        notes=(
            "Tremor of surgeons and novices holding and tracing, along one axis; the thesis used "
            "recordings of ophthalmic surgeons that are not public. Operators and sensor noise as "
            "in table 7.1.",
        ),
    )


ITEM = Item(
    name="table-7.3",
    source=SOURCE,
    title="Tracking of recorded tremor, with figure 7.15",
    group="hysteresis",
    run=run,
    recordings=(HANDS,),
    aliases=("figure-7.15",),
)
