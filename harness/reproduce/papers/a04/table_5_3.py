"""A04 table 5.3: networks of one hand on the trials of others."""

import numpy as np
import plotly.graph_objects as go

from harness.common.figures import Figure
from harness.report.page import Plot
from harness.report.plots import chart
from harness.reproduce.experiments.cascade import Protocol, protocol
from harness.reproduce.item import Context, Item, ItemResult, figures_of

SOURCE = "A04 table 5.3"
HANDS = "hand_motion_m2s2"
AS_GOOD, WORSE_THAN_RAW = 100 * 3 / 12, 100 * 4 / 12
"""Share of the thesis's twelve runs [%]."""
MEAN = (26.2 + 38.1 + 45.1 - 85.5 + 28.6 - 243.1 + 0.0 + 15.4 - 0.9 + 32.7 - 30.8 + 22.7) / 12
"""Of the thesis's twelve reductions [%]."""


def run(context: Context) -> ItemResult:
    """Test every hand's network on the tests of each other hand."""
    bench = protocol(context.recordings(HANDS))
    count = len(bench.hands)
    reductions = np.empty((count, count))
    for row, hand in enumerate(bench.hands):
        context.progress(0.95 * row / count, f"trained on {hand.name}")
        network = bench.network(hand)
        for column, other in enumerate(bench.hands):
            reductions[row, column] = bench.score(network, other.tests).reduction
    context.progress(0.95, "plots")
    others = ~np.eye(count, dtype=bool)
    own = np.broadcast_to(np.diag(reductions), (count, count))
    crossed, beside = reductions[others], own[others]
    runs = f"{others.sum()} runs, on all tests of each hand"
    figures = [
        Figure(SOURCE, "runs as good as the hand's own network, or better", "%", AS_GOOD,
               100 * float(np.mean(crossed >= beside)), f"{runs}; paper: 12 runs"),
        Figure(SOURCE, "runs worse than no filter", "%", WORSE_THAN_RAW,
               100 * float(np.mean(crossed < 0)), f"{runs}; paper: 12 runs"),
        Figure(SOURCE, "reduction of the rmse, network of another hand", "%", MEAN,
               float(crossed.mean()), f"mean of {runs}; paper: 12 runs"),
        Figure(SOURCE, "reduction of the rmse, network of the same hand", "%", None,
               float(np.diag(reductions).mean()), f"the same trials of {count} hands"),
    ]  # fmt: skip
    for row, hand in enumerate(bench.hands):
        quantity = f"reduction of the rmse, trained on {hand.name}"
        for column, other in enumerate(bench.hands):
            note = "" if row == column else f"; its own network: {own[row, column]:.1f}"
            number = (quantity, "%", None, reductions[row, column])
            figures += figures_of(SOURCE, f"tested on {other.name}{note}", [number])
    return ItemResult(
        figures=tuple(figures),
        plots=(_matrix(bench, reductions),),
        notes=(
            "One architecture and one trial to train on for each hand, as in table 5.1; tested on "
            "the tests of every hand, where the thesis takes one file of each. Which surgeon of "
            "the thesis would stand beside which hand is nobody's to say: its twelve reductions "
            "are compared as a whole.",
        ),
    )


def _matrix(bench: Protocol, reductions: np.ndarray) -> Plot:
    names = [hand.name for hand in bench.hands]
    cells = go.Heatmap(
        x=names,
        y=names,
        z=reductions,
        text=np.round(reductions, 1),
        texttemplate="%{text}",
        colorscale="RdBu",
        zmid=0.0,
        colorbar={"title": "%"},
    )
    figure = chart([cells], "tested on hand", "trained on hand", 420)
    figure.update_yaxes(autorange="reversed")
    return Plot(
        "Across hands",
        "Reduction of the rmse in per cent; on the diagonal, a network on the other trials of its "
        "own hand.",
        figure,
    )


ITEM = Item(
    name="table-5.3",
    source=SOURCE,
    title="Neural filters of one hand on the trials of others",
    group="neural-filter",
    run=run,
    recordings=(HANDS,),
)
