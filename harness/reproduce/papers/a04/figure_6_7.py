"""A04 figure 6.7: the workspace of the tip, and the tremor to cancel in it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    from harness.report.page import Plot
    from harness.reproduce.experiments.workspace import Workspace

TREMOR = 50.0
"""Diameter of the sphere that stands for tremor [um]."""
SOURCE = "A04 figure 6.7"


def run(context: Context) -> ItemResult:
    """The boundary of the workspace with the tremor sphere at rest."""
    from harness.reproduce.experiments.workspace import workspace

    context.progress(0.1, "workspace")
    reach = workspace()
    context.progress(0.8, "plots")
    return ItemResult(
        figures=(
            Figure(
                SOURCE,
                "diameter of the largest sphere about rest (paper: tremor, which it has to hold)",
                "um",
                TREMOR,
                2 * reach.sphere * 1e6,
                "rest at half stroke of all stacks",
            ),
        ),
        plots=(_space(reach), _outlines(reach)),
        notes=(
            "The tremor space, a sphere of 50 um, lies about the rest position inside the places "
            "that the tip can be brought to; the axial range is what limits it.",
        ),
    )


def _space(reach: Workspace) -> Plot:
    import numpy as np
    import plotly.graph_objects as go

    from harness.report.page import Plot
    from harness.report.plots import SERIES, layout

    figure = go.Figure()
    x, y, z = reach.points.T * 1e6
    i, j, k = reach.triangles.T
    figure.add_trace(
        go.Mesh3d(
            x=x, y=y, z=z, i=i, j=j, k=k, color=SERIES[5], opacity=0.3, name="workspace",
            showlegend=True, flatshading=True,
        )
    )  # fmt: skip
    # One curve with gaps: NaN lifts the pen between two edges.
    pen = np.full((len(reach.edges), 1, 3), np.nan)
    x, y, z = np.concatenate((reach.edges * 1e6, pen), axis=1).reshape(-1, 3).T
    ink = {"color": SERIES[0], "width": 3}
    figure.add_trace(go.Scatter3d(x=x, y=y, z=z, mode="lines", line=ink, showlegend=False))
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 41), np.linspace(0, np.pi, 21))
    half = TREMOR / 2
    figure.add_trace(
        go.Surface(
            x=half * np.cos(turn) * np.sin(rise),
            y=half * np.sin(turn) * np.sin(rise),
            z=half * np.cos(rise),
            colorscale=[[0, SERIES[1]], [1, SERIES[1]]],
            showscale=False,
            showlegend=True,
            name="tremor",
        )
    )
    layout(figure, 560)
    axis: dict[str, Any] = {"backgroundcolor": "#f5f7f9", "gridcolor": "#d9dee3"}
    figure.update_layout(
        scene={
            "xaxis": {**axis, "title": "x, µm"},
            "yaxis": {**axis, "title": "y, µm"},
            "zaxis": {**axis, "title": "z, µm", "nticks": 4},
            "aspectmode": "data",
            "camera": {
                "eye": {"x": 1.2, "y": -1.9, "z": 1.2},
                "center": {"x": 0.0, "y": 0.0, "z": -0.25},
            },
        }
    )
    return Plot(
        "Workspace and tremor",
        "Boundary of the reachable tip places about rest, and the sphere of 50 µm; all axes to "
        "one scale, z along the shaft.",
        figure,
    )


def _outlines(reach: Workspace) -> Plot:
    import numpy as np
    from plotly.subplots import make_subplots
    from scipy.spatial import ConvexHull

    from harness.report.page import Plot
    from harness.report.plots import SERIES, layout, line

    figure = make_subplots(rows=1, cols=2, horizontal_spacing=0.1)
    turn = np.linspace(0, 2 * np.pi, 101)
    for column, (across, up) in enumerate(((0, 1), (0, 2)), start=1):
        flat = reach.points[:, [across, up]] * 1e6
        ring = flat[ConvexHull(flat).vertices]
        ring = np.vstack((ring, ring[:1]))
        first = column == 1
        for trace in (
            line(ring[:, 0], ring[:, 1], SERIES[0], "workspace, seen from outside", first),
            line(TREMOR / 2 * np.cos(turn), TREMOR / 2 * np.sin(turn), SERIES[1], "tremor", first),
        ):
            figure.add_trace(trace, row=1, col=column)
        figure.update_xaxes(title_text=f"{'xyz'[across]}, µm", row=1, col=column)
        figure.update_yaxes(title_text=f"{'xyz'[up]}, µm", row=1, col=column)
        # Both views to one scale: what looks round is round.
        figure.update_yaxes(scaleanchor=f"x{column if column > 1 else ''}", row=1, col=column)
    return Plot(
        "Outlines",
        "The same along the shaft (left) and from the side (right), each to one scale.",
        layout(figure, 460),
    )


ITEM = Item(
    name="figure-6.7",
    source=SOURCE,
    title="Workspace of the tip, and the tremor in it",
    group="manipulator",
    run=run,
)
