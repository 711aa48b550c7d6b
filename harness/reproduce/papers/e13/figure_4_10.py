"""E13 figure 4.10: errors by the length of an occlusion."""

from collections.abc import Mapping

import numpy as np

from fmu_src.pack.discovery import load_model
from harness.common.figures import Figure
from harness.report.page import Plot
from harness.report.plots import grid
from harness.reproduce.experiments.augmentation import (
    FILTERS,
    SETTINGS_E13,
    Populations,
    broad_trials,
    category,
    occluded_errors,
)
from harness.reproduce.experiments.augmented import HAND, MISSING, UNITS, curves
from harness.reproduce.experiments.pose import SETTINGS, PoseErrors, occlusions
from harness.reproduce.item import Context, Item, ItemResult, Row, figures_of

SOURCE = "E13 figure 4.10"
RATIO = 5
ACQUISITIONS = 6
SAMPLES = 100
PAPER = {"position": 2.7}
"""At the end, axis y [mm]; of the attitude there is no number."""
LIMITS = {"position": (1e-3, "1 mm", 55), "attitude": (0.0174533, "1 deg", 95)}
"""Of an rms, and the samples for which E13 stays below (E13 5.2)."""
DURATIONS = (0.05, 0.1, 0.15, 0.2, 0.275, 0.35, 0.5, 0.65, 0.8, 1.0)
"""On BROAD [s]."""
REPORTED = (0.275, 0.5, 1.0)
STRIDES = {"OpticalInertialEkf": 1, "OpticalInertialUkf": 12, "OpticalPoseUkf": 12}
"""Of the optical samples at which an occlusion of BROAD begins."""


def run(context: Context) -> ItemResult:
    """Hide the markers at each place."""
    motions = [category(1, seed, RATIO) for seed in range(1, ACQUISITIONS + 1)]
    found = {}
    for place, name in enumerate(FILTERS):
        context.progress(0.1 * place / len(FILTERS), f"{name}, simulated hand")
        found[name] = occluded_errors(name, motions, SAMPLES)
    figures = [figure for name, errors in found.items() for figure in _simulated(name, errors)]
    plots = [_plot(found)]
    recorded = _recorded(context)
    for (trial, name), errors in recorded.items():
        figures.extend(_figures(trial, name, errors))
    if recorded:
        plots.append(_plot_recorded(recorded))
    return ItemResult(
        figures=tuple(figures),
        plots=tuple(plots),
        notes=(
            "Simulated, as E13 3.5.2: six acquisitions of a hand of 40 mm/s in the mean and 100 at "
            "the most through the plants, inertial 200 Hz, optical 40 Hz; 54 occlusions of 100 "
            "samples, moved over each acquisition. Rms along axis y by samples since an occlusion "
            "began. E13 stays below 1 mm for 55 samples and below 1 deg for 95.",
            "Recorded: BROAD, each tenth optical sample given. An occlusion begins after each one "
            "that counts; for the unscented filters after each twelfth. Errors are 3-D.",
            *(() if recorded else (MISSING,)),
        ),
    )


def _simulated(name: str, errors: Populations) -> list[Figure]:
    rows: list[Row] = []
    for what, (unit, scale) in UNITS.items():
        end, length = errors.rms(what)[-1], errors.rms(what, None)[-1]
        limit, limit_text, paper_samples = LIMITS[what]
        below = np.append(errors.rms(what) < limit, False).argmin()
        at_most = f"samples below {limit_text}, axis y, {SAMPLES} at the most"
        rows += (
            (f"{what}, rms at the end, axis y: {name}", unit, PAPER.get(what), scale * end),
            (f"{what}, rms at the end, 3-D: {name}", unit, None, scale * length),
            (f"{what}, {at_most}: {name}", "", paper_samples, below),
        )
    setting = f"{HAND}, {9 * ACQUISITIONS} occlusions of {SAMPLES} samples (0.5 s)"
    return figures_of(SOURCE, setting, rows)


def _recorded(context: Context) -> dict[tuple[str, str], PoseErrors]:
    """Return errors by trial and filter; none where there are no recordings."""
    found = {}
    known = broad_trials(context)
    for place, trial in enumerate(known):
        for number, (name, stride) in enumerate(STRIDES.items()):
            share = (place + number / len(STRIDES)) / len(known)
            context.progress(0.1 + 0.9 * share, f"{name}, trial {trial.name[:2]}")
            settings = SETTINGS_E13 if name == "OpticalPoseUkf" else SETTINGS
            found[trial.name[:2], name] = occlusions(
                load_model(name), trial, DURATIONS, stride=stride, settings=settings
            )
    return found


def _figures(trial: str, name: str, errors: PoseErrors) -> list[Figure]:
    stride = STRIDES[name]
    where = "each place" if stride == 1 else f"each {stride}th place"
    found: list[Figure] = []
    for duration in REPORTED:
        at = DURATIONS.index(duration)
        rows = (
            (f"{what}, rms at the end, 3-D: {name}", unit, None, scale * getattr(errors, what)[at])
            for what, (unit, scale) in UNITS.items()
        )
        setting = f"BROAD, trial {trial}, occlusions of {duration:g} s at {where}"
        found += figures_of(SOURCE, setting, rows)
    return found


def _plot(found: Mapping[str, Populations]) -> Plot:
    steps = np.arange(1.0, SAMPLES + 1)
    panels = [
        curves(steps, {name: scale * errors.rms(what) for name, errors in found.items()})
        for what, (_, scale) in UNITS.items()
    ]
    titles = [f"{what}, axis y, {unit}" for what, (unit, _) in UNITS.items()]
    plot = grid([panels], "samples since the occlusion began", titles, 420)
    plot.update_yaxes(rangemode="tozero")
    return Plot(
        "Figure 4.10: simulated hand",
        f"Rms of {9 * ACQUISITIONS} occlusions along, and about, axis y.",
        plot,
    )


def _plot_recorded(found: Mapping[tuple[str, str], PoseErrors]) -> Plot:
    places = list(dict.fromkeys(trial for trial, _ in found))
    panels = [
        [
            curves(
                np.array(DURATIONS),
                {name: scale * getattr(errors, what)
                 for (of, name), errors in found.items() if of == trial},
            )
            for trial in places
        ]
        for what, (_, scale) in UNITS.items()
    ]  # fmt: skip
    plot = grid(
        panels,
        "occlusion, s",
        [f"{what}, 3-D, {unit}" for what, (unit, _) in UNITS.items()],
        560,
        shared_yaxes="rows",
        subplot_titles=[f"trial {trial}" for trial in places],
    )
    plot.update_layout(legend_y=1.08, margin_t=72)
    return Plot("Figure 4.10: BROAD", "Rms at the end of occlusions, by their length.", plot)


ITEM = Item(
    name="e13-figure-4.10",
    source=SOURCE,
    title="Errors by the length of an occlusion",
    group="sensing",
    run=run,
)
