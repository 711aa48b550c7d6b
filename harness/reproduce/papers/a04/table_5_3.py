"""A04 table 5.3: networks of one hand on the trials of others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    import numpy as np

    from harness.report.page import Plot
    from harness.reproduce.experiments.cascade import Protocol

SOURCE = "A04 table 5.3"
HANDS = "hand_motion_m2s2"
AS_GOOD, WORSE_THAN_RAW = 100 * 3 / 12, 100 * 4 / 12
"""Share of the thesis's twelve runs [%]."""
MEAN = (26.2 + 38.1 + 45.1 - 85.5 + 28.6 - 243.1 + 0.0 + 15.4 - 0.9 + 32.7 - 30.8 + 22.7) / 12
"""Of the thesis's twelve reductions [%]."""


def run(context: Context) -> ItemResult:
    """Test every hand's network on the tests of each other hand."""
    import numpy as np

    from harness.reproduce.experiments.cascade import protocol

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
    figures += [
        Figure(
            SOURCE,
            f"reduction of the rmse, trained on {hand.name}",
            "%",
            None,
            float(reductions[row, column]),
            f"tested on {other.name}"
            + ("" if row == column else f"; its own network: {own[row, column]:.1f}"),
        )
        for row, hand in enumerate(bench.hands)
        for column, other in enumerate(bench.hands)
    ]
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
    import numpy as np
    import plotly.graph_objects as go

    from harness.report.page import Plot
    from harness.report.plots import layout

    names = [hand.name for hand in bench.hands]
    figure = go.Figure(
        go.Heatmap(
            x=names,
            y=names,
            z=reductions,
            text=np.round(reductions, 1),
            texttemplate="%{text}",
            colorscale="RdBu",
            zmid=0.0,
            colorbar={"title": "%"},
        )
    )
    figure.update_xaxes(title_text="tested on hand")
    figure.update_yaxes(title_text="trained on hand", autorange="reversed")
    return Plot(
        "Across hands",
        "Reduction of the rmse in per cent; on the diagonal, a network on the other trials of its "
        "own hand.",
        layout(figure, 420),
    )


ITEM = Item(
    name="table-5.3",
    source=SOURCE,
    title="Neural filters of one hand on the trials of others",
    group="neural-filter",
    run=run,
    recordings=(HANDS,),
)
