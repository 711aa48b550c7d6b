"""Numbers and plots of E13's frequency augmentation: populations of each filter, by origin."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from harness.common.figures import Figure
from harness.common.types import FloatArray
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, layout, line
from harness.reproduce.experiments.augmentation import (
    ALONE,
    FILTERS,
    Motion,
    Populations,
    category,
    followed,
    recorded,
    speeds,
)
from harness.reproduce.experiments.broad import TRIALS
from harness.reproduce.item import Context

__all__ = [
    "HAND",
    "MISSING",
    "UNITS",
    "Augmented",
    "augmented",
    "by_step",
    "figures",
    "of",
    "part_of",
    "speed_note",
]

HAND = "simulated hand"
ACQUISITIONS = 12
"""Of each category (E13 3.5.1.2)."""
RECORDED = {1: (TRIALS[0], TRIALS[2]), 2: (TRIALS[1],)}
"""Trials of BROAD that stand for a category: slow and fast ones."""
MISSING = (
    "The part on recorded motion (BROAD) is left out: there is no folder 'broad' among the"
    " recordings; give theirs with --data FOLDER."
)
UNITS = {"position": ("mm", 1e3), "attitude": ("deg", float(np.degrees(1.0)))}
NAMES = (*FILTERS, ALONE)
COLOURS = dict(zip(NAMES, (*SERIES[:3], GREY), strict=True))


@dataclass(frozen=True)
class Augmented:
    """What some motions of one origin give.

    Attributes:
        origin: where they come from, for people.
        speeds: mean and largest speed [m/s] and rate [rad/s].
        found: populations by filter.
    """

    origin: str
    speeds: tuple[float, float, float, float]
    found: Mapping[str, Populations]


def of(
    origin: str,
    motions: list[Motion],
    told: Callable[[float, str], None] = lambda share, what: None,
) -> Augmented:
    """Follow some motions by all filters and by the tracker alone."""
    found = {}
    for place, name in enumerate(NAMES):
        told(place / len(NAMES), f"{name}, {origin}")
        found[name] = Populations.together(followed(name, motion) for motion in motions)
    each = np.array([speeds(motion) for motion in motions])
    mean, largest = each.mean(axis=0), each.max(axis=0)
    return Augmented(origin, (mean[0], largest[1], mean[2], largest[3]), found)


def part_of(context: Context, place: int, count: int) -> Callable[[float, str], None]:
    """Progress of one of some parts that are as long as each other."""
    return lambda share, what: context.progress((place + share) / count, what)


def augmented(
    context: Context, number: int, ratio: int, told: Callable[[float, str], None]
) -> tuple[Augmented, ...]:
    """A velocity category at some ratio: the simulated hand, and BROAD where it is at hand."""
    told(0.0, f"category {number}, ratio {ratio}")
    return _augmented(context.data, number, ratio, ACQUISITIONS)


@cache
def _augmented(
    data: Path | None, number: int, ratio: int, acquisitions: int
) -> tuple[Augmented, ...]:
    # Two tables have the same experiments, one their positions, the other their attitudes.
    hand = [category(number, seed, ratio) for seed in range(1, acquisitions + 1)]
    trials = recorded(Context(data=data), ratio, RECORDED[number])
    parts = [of(HAND, hand)]
    if trials:
        names = ", ".join(trial.name.removeprefix("trial ") for trial in trials)
        parts.append(of(f"BROAD {names}", trials))
    return tuple(parts)


def figures(
    source: str,
    what: str,
    setting: str,
    parts: Iterable[Augmented],
    paper: tuple[float, float] | None,
) -> Iterable[Figure]:
    """At the worst step: rms and 95 % along axis y beside the paper's, and rms of the length.

    Args:
        source: of the paper's numbers.
        what: "position" or "attitude".
        setting: under which conditions.
        parts: by origin.
        paper: rms and 95 %, in the unit for people.
    """
    unit, scale = UNITS[what]
    rms, interval = paper or (None, None)
    for part in parts:
        for name, found in part.found.items():
            where = f"{setting}; {part.origin}"
            for quantity, number, values in (
                (f"{what}, rms, axis y", rms, found.rms(what)),
                (f"{what}, 95 %, axis y", interval, found.interval(what)),
                (f"{what}, rms, 3-D", None, found.rms(what, None)),
            ):
                worst = float(scale * values.max())
                yield Figure(source, f"{quantity}: {name}", unit, number, worst, where)


def by_step(title: str, what: str, parts: Iterable[Augmented]) -> Plot:
    """Rms and 95 % along axis y, by steps since the correction, a panel for each origin."""
    parts = list(parts)
    unit, scale = UNITS[what]
    plot = make_subplots(
        rows=1,
        cols=len(parts),
        subplot_titles=[part.origin for part in parts],
        shared_yaxes=True,
        horizontal_spacing=0.04,
    )
    for column, part in enumerate(parts, start=1):
        for name, found in part.found.items():
            for values, dash in ((found.rms(what), "solid"), (found.interval(what), "dot")):
                steps = np.arange(float(len(values)))
                # What is exact but for rounding has no place on a logarithmic axis.
                values = np.where(values > 1e-6 * values.max(), values, np.nan)
                shown = dash == "solid" and column == 1
                curve = line(steps, scale * values, COLOURS[name], name, shown, dash=dash)
                curve.mode = "lines+markers"
                plot.add_trace(curve, row=1, col=column)
        plot.update_xaxes(title_text="steps since the correction", row=1, col=column)
    plot.update_yaxes(type="log")
    plot.update_yaxes(title_text=f"{what}, axis y, {unit}", row=1, col=1)
    layout(plot, 460)
    plot.update_layout(legend_y=1.1, margin_t=72)
    return Plot(title, "Rms (lines) and what 95 % of the errors are below (dotted).", plot)


def curves(
    plot: go.Figure, x: FloatArray, found: Mapping[str, FloatArray], row: int, column: int
) -> None:
    """A curve for each filter; the legend shows them once."""
    for name, values in found.items():
        first = row == 1 and column == 1
        plot.add_trace(line(x, values, COLOURS[name], name, first), row=row, col=column)


def speed_note(parts: Iterable[Augmented]) -> str:
    """How fast the motions are."""
    told = "; ".join(
        f"{part.origin}: {1e3 * part.speeds[0]:.0f} and {1e3 * part.speeds[1]:.0f} mm/s,"
        f" {np.degrees(part.speeds[2]):.0f} and {np.degrees(part.speeds[3]):.0f} deg/s"
        for part in parts
    )
    return f"Mean and largest speed and rate. {told}."
