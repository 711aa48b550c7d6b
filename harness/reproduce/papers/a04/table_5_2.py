"""A04 table 5.2: networks trained to tell the motion, beside those trained to tell the error."""

import numpy as np

from harness.common.figures import Figure
from harness.identify.tremor_nn.page import over_time
from harness.report.page import Plot
from harness.reproduce.experiments.cascade import ONE_FOR_ALL, Protocol, protocol
from harness.reproduce.item import Context, Item, ItemResult, Row, figures_of

SOURCE = "A04 table 5.2"
HANDS = "hand_motion_m2s2"
AVERAGES = {"motion": 39.5, "error": 29.9}
"""Reduction by what is trained, mean over the surgeons [%]."""
NAMES = {"motion": "NN_vm", "error": "NN_err"}


def run(context: Context) -> ItemResult:
    """Train both on one trial of each hand, and test them on its others."""
    bench = protocol(context.recordings(HANDS))
    best, fixed, error = [], [], []
    for k, hand in enumerate(bench.hands):
        context.progress(0.95 * k / len(bench.hands), f"hand {hand.name}")
        best.append(bench.best(hand).score.reduction)
        fixed.append(bench.score(bench.network(hand), hand.tests).reduction)
        network = bench.network(hand, target="error")
        error.append(bench.score(network, hand.tests).reduction)
    context.progress(0.95, "plots")
    one = f"{ONE_FOR_ALL.inputs} inputs, {ONE_FOR_ALL.hidden} hidden units"
    columns = (
        ("motion", best, "best architecture by the tests, as in the thesis"),
        ("motion", fixed, one),
        ("error", error, one),
    )
    figures: list[Figure] = []
    for target, values, setting in columns:
        quantity = f"reduction of the rmse, {NAMES[target]}"
        row: Row = (quantity, "%", AVERAGES[target], np.mean(values))
        figures += figures_of(SOURCE, f"mean over {len(bench.hands)} hands; {setting}", [row])
        for hand, value in zip(bench.hands, values, strict=True):
            row = (quantity, "%", None, value)
            figures += figures_of(SOURCE, f"hand {hand.name}; {setting}", [row])
    return ItemResult(
        figures=tuple(figures),
        plots=(_sample(bench),),
        notes=(
            "NN_vm is trained to tell the motion, NN_err (Riviere and Khosla) to tell the error, "
            "which is then taken from the newest position. Both have one architecture, so that "
            "nothing but the target differs; the thesis compares its best architectures with one "
            "fixed at 100 inputs, and doubts itself that the method makes the difference. With "
            "linear connections from every input to the output, as a cascade network has, the "
            "two differ only in where the weights begin. Trials, motions and scores are those of "
            "table 5.1; surgeons of the thesis and hands here are other persons.",
        ),
    )


def _sample(bench: Protocol) -> Plot:
    hand = bench.hands[-1]
    return Plot(
        "Figure 5.7b: trained to tell the error",
        f"Hand {hand.name}, trial {hand.tests[0].name}, as in figure 5.7a.",
        over_time(bench.network(hand, target="error"), hand.tests[0].error, bench.rms),
    )


ITEM = Item(
    name="table-5.2",
    source=SOURCE,
    title="Neural filters trained to tell motion or error, with figure 5.7b",
    group="neural-filter",
    run=run,
    recordings=(HANDS,),
    aliases=("figure-5.7b",),
)
