"""Tremor filters in the full loop: what each chain leaves of a hand's tremor at the tip."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from harness.common.figures import Figure
from harness.recordings.motion import recordings
from harness.report.page import Plot
from harness.reproduce.experiments.ranking import LOWEST, ranking
from harness.reproduce.item import Context, Item, ItemResult
from harness.results.metrics import Metric
from harness.results.variants import RANKED, VariantSummary, summarise_variants
from harness.running import run as run_scenario
from harness.scenario.load import load

SOURCE = "A04 figure 5.5"
HANDS = "hand_motion_m2s2"
BENCHES = {
    "tremor_bench": "data-sheet noise",
    "tremor_bench_a04_noise": "accelerometers as noisy as in A04 table 2.3",
}
"""Scenarios, and what they have sensed with."""
KNOWN = "position-known"
"""Variant that is there for scale: it is told the true position."""
DEFINITIONS = ("a-posteriori", "in-band")
GENERATED = "generator"


def run(context: Context) -> ItemResult:
    """Run every variant of the benches on the recorded hands and on the generator."""
    paths = recordings([context.recordings(HANDS)])
    figures: list[Figure] = []
    plots: list[Plot] = []
    for index, (scenario, setting) in enumerate(BENCHES.items()):
        hands, artificial = _runs(scenario, paths, context.part(index, len(BENCHES)))
        ranked = summarise_variants(hands)
        for which, found in (
            ("recorded hands", ranked),
            (GENERATED, summarise_variants(artificial)),
        ):
            for rank in found:
                figures += rank.figures(SOURCE, f"{which}, {setting}")
        plots.append(_bars(ranked, setting))
    return ItemResult(
        figures=tuple(figures),
        plots=tuple(plots),
        notes=(
            "Reductions of tremor at the tip in per cent, by the definitions in every run's "
            "`metrics.json`. The motion is known from the instrument's own sensors; kinematics, "
            "hysteresis and one sample of delay are in the loop. Each variant is one of the "
            "scenario's, and can be run alone: `steadytip run tremor_bench --variant NAME`.",
            f"'{KNOWN}' is told the true position of the tip and stands for what the other chains "
            "lose by sensing; no instrument has that.",
            "The magnetometer is in the estimator's attitude. For the tremor it is of no use at "
            "its data sheet's noise, so that there is one figure with and without it.",
            "The thesis's chain as printed inverts the matrix of the levers, which multiplies "
            "noise, and integrates twice; its own figure of 69 % was measured in one dimension "
            "with a position sensor.",
        ),
    )


def _runs(
    scenario: str, paths: Sequence[Path], context: Context
) -> tuple[dict[str, list[Mapping[str, Metric]]], ...]:
    """Return metrics of every variant on each recording, and on the generator."""
    variants = load(scenario).variants
    hands: dict[str, list[Mapping[str, Metric]]] = {name: [] for name in variants}
    artificial: dict[str, list[Mapping[str, Metric]]] = {name: [] for name in variants}
    motions = [*paths, None]
    with tempfile.TemporaryDirectory(prefix="steadytip-") as folder:
        for k, variant in enumerate(variants):
            for i, path in enumerate(motions):
                share = (k + i / len(motions)) / len(variants)
                context.progress(share, f"{variant}, {path.stem if path else GENERATED}")
                result = run_scenario(
                    scenario, motion=path, variant=variant, out=Path(folder), report=False
                )
                (hands if path else artificial)[variant].append(result.metrics)
    return hands, artificial


def _bars(found: Sequence[VariantSummary], setting: str) -> Plot:
    rows: Mapping[str, list[list[float]]] = {
        rank.variant: [[of[name] for name in RANKED] for of in (rank.mean, rank.worst)]
        for rank in reversed(found)
    }
    return Plot(
        f"In the loop, {setting}",
        "Reduction at the tip on recorded hands, mean and worst. What is below "
        f"{LOWEST:g} % leaves the plot.",
        ranking(rows, DEFINITIONS, grey=[KNOWN]),
    )


ITEM = Item(
    name="tremor-loop",
    source=SOURCE,
    title="Tremor filters in the closed loop, sensing, kinematics and hysteresis included",
    group="tremor",
    run=run,
    recordings=(HANDS,),
)
