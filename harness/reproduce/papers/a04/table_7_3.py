"""A04 table 7.3 and figure 7.15: tracking of recorded tremor."""

from harness.recordings.motion import recordings
from harness.reproduce.experiments.tracking import tremor
from harness.reproduce.experiments.tracking_results import changing_demands
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
    shapes = {path.stem: tremor(path) for path in recordings([context.recordings(HANDS)])}
    return changing_demands(
        context,
        SOURCE,
        demand=f"mean over {len(shapes)} recorded hands, 6 to 16 Hz, scaled to 12.5 um p-p",
        shapes=shapes,
        first_seed=60,
        paper=PAPER,
        title=f"Figure 7.15: tremor of {next(iter(shapes))}",
        which="recording",
        note="Tremor of surgeons and novices holding and tracing, along one axis; the thesis used "
        "recordings of ophthalmic surgeons that are not public. Operators and sensor noise as "
        "in table 7.1.",
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
