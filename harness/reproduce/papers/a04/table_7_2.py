"""A04 table 7.2 and figure 7.14: tracking of several tones that swell and fade."""

from __future__ import annotations

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
    from harness.reproduce.experiments.plots import tracks
    from harness.reproduce.experiments.tables import columns, figures
    from harness.reproduce.experiments.tracking import PROFILES, profile

    shapes = {f"profile {number + 1}": profile(number) for number in range(PROFILES)}
    found = columns(shapes, context.progress, 50)
    context.progress(0.98, "plots")
    demand = f"mean over {PROFILES} profiles of 1, 10 and 19 Hz with changing sizes"
    return ItemResult(
        figures=tuple(figures(SOURCE, demand, found, PAPER)),
        plots=(
            tracks(
                "Figure 7.14: 1, 10 and 19 Hz with changing sizes",
                "Demand and what is measured (left), and the difference (right), of each "
                "controller; the first profile.",
                {name: column.tracks[0] for name, column in found.items()},
                2.0,
            ),
        ),
        notes=(
            "Sums of 1, 10 and 19 Hz whose sizes swell and fade, 12.5 um p-p in all, 5 s each; "
            "the thesis does not give its sizes. Operators and sensor noise as in table 7.1.",
        ),
    )


ITEM = Item(
    name="table-7.2",
    source=SOURCE,
    title="Tracking of several tones of changing size, with figure 7.14",
    group="hysteresis",
    run=run,
    aliases=("figure-7.14",),
)
