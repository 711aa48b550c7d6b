"""Numbers and plots of E13's frequency augmentation: populations of each filter, by origin."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from harness.common.figures import Figure
from harness.common.types import FloatArray
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, grid, line
from harness.reproduce.experiments.augmentation import (
    FILTERS,
    TRACKER_ALONE,
    Populations,
    RecordedTrack,
    category,
    errors_by_step,
    recorded,
    speeds,
)
from harness.reproduce.experiments.broad import TRIALS
from harness.reproduce.item import Context, figures_of

__all__ = [
    "HAND",
    "MISSING",
    "UNITS",
    "Augmented",
    "augmented",
    "by_step",
    "figures",
    "follow_all",
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
NAMES = (*FILTERS, TRACKER_ALONE)
COLOURS = dict(zip(NAMES, (*SERIES[:3], GREY), strict=True))


@dataclass(frozen=True)
class Augmented:
    """Results of some motions of one origin.

    Attributes:
        origin: where they come from, for people.
        speeds: mean and largest speed [m/s] and rate [rad/s].
        found: populations by filter.
    """

    origin: str
    speeds: tuple[float, float, float, float]
    found: Mapping[str, Populations]


def follow_all(
    origin: str,
    motions: list[RecordedTrack],
    progress: Callable[[float, str], None] = lambda share, what: None,
) -> Augmented:
    """Follow some motions by all filters and by the tracker alone."""
    found = {}
    for place, name in enumerate(NAMES):
        progress(place / len(NAMES), f"{name}, {origin}")
        found[name] = Populations.together(errors_by_step(name, motion) for motion in motions)
    each = np.array([speeds(motion) for motion in motions])
    mean, largest = each.mean(axis=0), each.max(axis=0)
    return Augmented(origin, (mean[0], largest[1], mean[2], largest[3]), found)


def augmented(context: Context, number: int, ratio: int) -> tuple[Augmented, ...]:
    """Follow a velocity category at some ratio: the simulated hand, and BROAD if it is there."""
    context.progress(0.0, f"category {number}, ratio {ratio}")
    return _augmented(context.data, number, ratio, ACQUISITIONS)


@cache
def _augmented(
    data: Path | None, number: int, ratio: int, acquisitions: int
) -> tuple[Augmented, ...]:
    # Two tables have the same experiments, one their positions, the other their attitudes.
    hand = [category(number, seed, ratio) for seed in range(1, acquisitions + 1)]
    broad_trials = recorded(Context(data=data), ratio, RECORDED[number])
    parts = [follow_all(HAND, hand)]
    if broad_trials:
        names = ", ".join(trial.name.removeprefix("trial ") for trial in broad_trials)
        parts.append(follow_all(f"BROAD {names}", broad_trials))
    return tuple(parts)


def figures(
    source: str,
    what: str,
    setting: str,
    parts: Iterable[Augmented],
    paper: tuple[float, float] | None,
) -> Iterable[Figure]:
    """Yield errors at the worst step: rms and 95 % along axis y, and rms of the length.

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
            rows = (
                (f"{what}, rms, axis y: {name}", unit, rms, scale * found.rms(what).max()),
                (f"{what}, 95 %, axis y: {name}", unit, interval,
                 scale * found.interval(what).max()),
                (f"{what}, rms, 3-D: {name}", unit, None, scale * found.rms(what, None).max()),
            )  # fmt: skip
            yield from figures_of(source, f"{setting}; {part.origin}", rows)


def by_step(title: str, what: str, parts: Sequence[Augmented]) -> Plot:
    """Plot rms and 95 % along axis y by steps since the correction, a panel for each origin."""
    unit, scale = UNITS[what]
    panels = []
    for part in parts:
        panel = []
        for name, found in part.found.items():
            for values, dash in ((found.rms(what), "solid"), (found.interval(what), "dot")):
                # What is exact but for rounding has no place on a logarithmic axis.
                values = scale * np.where(values > 1e-6 * values.max(), values, np.nan)
                steps = np.arange(float(len(values)))
                mode = "lines+markers"
                panel.append(line(steps, values, COLOURS[name], name, mode=mode, dash=dash))
        panels.append(panel)
    plot = grid(
        [panels],
        "steps since the correction",
        [f"{what}, axis y, {unit}"],
        460,
        subplot_titles=[part.origin for part in parts],
        shared_yaxes=True,
    )
    plot.update_yaxes(type="log")
    plot.update_layout(legend_y=1.1, margin_t=72)
    return Plot(title, "Rms (lines) and what 95 % of the errors are below (dotted).", plot)


def curves(x: FloatArray, found: Mapping[str, FloatArray]) -> list[go.Scatter]:
    """Return a curve for each filter."""
    return [line(x, values, COLOURS[name], name) for name, values in found.items()]


def speed_note(parts: Iterable[Augmented]) -> str:
    """Return a sentence on how fast the motions are."""
    texts = "; ".join(
        f"{part.origin}: {1e3 * part.speeds[0]:.0f} and {1e3 * part.speeds[1]:.0f} mm/s,"
        f" {np.degrees(part.speeds[2]):.0f} and {np.degrees(part.speeds[3]):.0f} deg/s"
        for part in parts
    )
    return f"Mean and largest speed and rate. {texts}."
