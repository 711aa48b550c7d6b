"""A04 figure 6.7: the workspace of the tip, and the tremor to cancel in it."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from scipy.spatial import ConvexHull

from harness.common.figures import Figure
from harness.report.page import Plot
from harness.report.plots import SERIES, grid, layout, line
from harness.reproduce.experiments.workspace import Workspace, workspace
from harness.reproduce.item import Context, Item, ItemResult

TREMOR = 50.0
"""Diameter of the sphere that stands for tremor [um]."""
SOURCE = "A04 figure 6.7"


def run(context: Context) -> ItemResult:
    """Compute the boundary of the workspace with the tremor sphere at rest."""
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
    turn = np.linspace(0, 2 * np.pi, 101)
    views = ((0, 1), (0, 2))
    panels = []
    for across, up in views:
        flat = reach.points[:, [across, up]] * 1e6
        ring = flat[ConvexHull(flat).vertices]
        ring = np.vstack((ring, ring[:1]))
        panels.append(
            [
                line(ring[:, 0], ring[:, 1], SERIES[0], "workspace, seen from outside"),
                line(TREMOR / 2 * np.cos(turn), TREMOR / 2 * np.sin(turn), SERIES[1], "tremor"),
            ]
        )
    x, y = ([f"{'xyz'[axis]}, µm" for axis in axes] for axes in zip(*views, strict=True))
    figure = grid([panels], x, y, 460)
    # Both views to one scale: what looks round is round.
    figure.update_yaxes(scaleanchor="x", row=1, col=1)
    figure.update_yaxes(scaleanchor="x2", row=1, col=2)
    return Plot(
        "Outlines",
        "The same along the shaft (left) and from the side (right), each to one scale.",
        figure,
    )


ITEM = Item(
    name="figure-6.7",
    source=SOURCE,
    title="Workspace of the tip, and the tremor in it",
    group="manipulator",
    run=run,
)
