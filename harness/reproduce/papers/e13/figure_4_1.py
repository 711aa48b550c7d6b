"""E13 figures 4.1 and 4.2: errors on simulated trajectories, by steps since the correction."""

from harness.reproduce.experiments.augmentation import simulated
from harness.reproduce.experiments.augmented import by_step, figures, follow_all, speed_note
from harness.reproduce.item import Context, Item, ItemResult

SOURCE = "E13 figures 4.1, 4.2"
PATHS = 6


def run(context: Context) -> ItemResult:
    """Follow six random paths."""
    motions = [simulated(seed) for seed in range(1, PATHS + 1)]
    parts = [follow_all("simulated trajectories", motions, context.progress)]
    setting = "inertial 200 Hz, optical 20 Hz, six paths of 10 s"
    return ItemResult(
        figures=tuple(
            figure
            for what in ("position", "attitude")
            for figure in figures(SOURCE, what, setting, parts, None)
        ),
        plots=(
            by_step("Figure 4.1: position", "position", parts),
            by_step("Figure 4.2: attitude", "attitude", parts),
        ),
        notes=(
            "Simulated, as E13 3.5.1.1 has it: random paths, acceleration and rate from central "
            "differences of them, Gaussian noise of at most 100 mm/s2 (taken for three standard "
            "deviations) on the acceleration, turns to and fro about axis y; the tracker is exact. "
            "The paper's curves have no numbers, but that they stay below 1 mm and 2 deg. Nothing "
            "but noise is wrong here, so that all filters do alike: there is nothing to calibrate "
            "on line.",
            speed_note(parts),
        ),
    )


ITEM = Item(
    name="e13-figure-4.1",
    source=SOURCE,
    title="Pose between optical samples on simulated trajectories",
    group="sensing",
    run=run,
    aliases=("e13-figure-4.2",),
)
