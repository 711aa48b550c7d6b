"""A04 table 7.2 and figure 7.14: tracking of several tones that swell and fade."""

from harness.reproduce.experiments.tracking import PROFILES, profile
from harness.reproduce.experiments.tracking_results import changing_demands
from harness.reproduce.item import Context, Item, ItemResult

SOURCE = "A04 table 7.2"
PAPER = {
    "without model": (1.09, 1.93),
    "rate-independent": (0.18, 0.68),
    "rate-dependent": (0.13, 0.50),
}
"""Rms and largest error [um]."""


def run(context: Context) -> ItemResult:
    """Track 1, 10 and 19 Hz together, each of changing size, with each controller."""
    return changing_demands(
        context,
        SOURCE,
        demand=f"mean over {PROFILES} profiles of 1, 10 and 19 Hz with changing sizes",
        shapes={f"profile {number + 1}": profile(number) for number in range(PROFILES)},
        first_seed=50,
        paper=PAPER,
        title="Figure 7.14: 1, 10 and 19 Hz with changing sizes",
        which="profile",
        note="Sums of 1, 10 and 19 Hz whose sizes swell and fade, 12.5 um p-p in all, 5 s each; "
        "the thesis does not give its sizes. Operators and sensor noise as in table 7.1.",
    )


ITEM = Item(
    name="table-7.2",
    source=SOURCE,
    title="Tracking of several tones of changing size, with figure 7.14",
    group="hysteresis",
    run=run,
    aliases=("figure-7.14",),
)
