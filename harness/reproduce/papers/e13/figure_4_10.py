"""E13 figure 4.10: errors by the length of an occlusion."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    from collections.abc import Mapping

    from harness.report.page import Plot
    from harness.reproduce.experiments.augmentation import Populations
    from harness.reproduce.experiments.pose import Errors

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
TOLD = (0.275, 0.5, 1.0)
STRIDES = {"OpticalInertialEkf": 1, "OpticalInertialUkf": 12, "OpticalPoseUkf": 12}
"""Of the optical samples at which an occlusion of BROAD begins."""


def run(context: Context) -> ItemResult:
    """Hide the markers at each place."""
    from harness.reproduce.experiments.augmentation import FILTERS, category, hidden
    from harness.reproduce.experiments.augmented import MISSING

    motions = [category(1, seed, RATIO) for seed in range(1, ACQUISITIONS + 1)]
    found = {}
    for place, name in enumerate(FILTERS):
        context.progress(0.1 * place / len(FILTERS), f"{name}, simulated hand")
        found[name] = hidden(name, motions, SAMPLES)
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
    import numpy as np

    from harness.reproduce.experiments.augmented import HAND, UNITS

    found = []
    setting = f"{HAND}, {9 * ACQUISITIONS} occlusions of {SAMPLES} samples (0.5 s)"
    for what, (unit, scale) in UNITS.items():
        for quantity, paper, values in (
            ("axis y", PAPER.get(what), errors.rms(what)),
            ("3-D", None, errors.rms(what, None)),
        ):
            label = f"{what}, rms at the end, {quantity}: {name}"
            found.append(Figure(SOURCE, label, unit, paper, float(scale * values[-1]), setting))
        limit, told, paper_samples = LIMITS[what]
        below = np.append(errors.rms(what) < limit, False)
        label = f"{what}, samples below {told}, axis y, {SAMPLES} at the most: {name}"
        found.append(Figure(SOURCE, label, "", paper_samples, float(below.argmin()), setting))
    return found


def _recorded(context: Context) -> dict[tuple[str, str], Errors]:
    """Errors by trial and filter; none where there are no recordings."""
    from fmu_src.pack.build import load_model
    from harness.reproduce.experiments.augmentation import SETTINGS_E13, trials
    from harness.reproduce.experiments.pose import SETTINGS, occlusions

    found = {}
    known = trials(context)
    for place, trial in enumerate(known):
        for number, (name, stride) in enumerate(STRIDES.items()):
            share = (place + number / len(STRIDES)) / len(known)
            context.progress(0.1 + 0.9 * share, f"{name}, trial {trial.name[:2]}")
            settings = SETTINGS_E13 if name == "OpticalPoseUkf" else SETTINGS
            found[trial.name[:2], name] = occlusions(
                load_model(name), trial, DURATIONS, stride=stride, settings=settings
            )
    return found


def _figures(trial: str, name: str, errors: Errors) -> list[Figure]:
    from harness.reproduce.experiments.augmented import UNITS

    stride = STRIDES[name]
    where = "each place" if stride == 1 else f"each {stride}th place"
    found = []
    for duration in TOLD:
        at = DURATIONS.index(duration)
        setting = f"BROAD, trial {trial}, occlusions of {duration:g} s at {where}"
        for what, (unit, scale) in UNITS.items():
            value = float(scale * getattr(errors, what)[at])
            label = f"{what}, rms at the end, 3-D: {name}"
            found.append(Figure(SOURCE, label, unit, None, value, setting))
    return found


def _plot(found: Mapping[str, Populations]) -> Plot:
    import numpy as np
    from plotly.subplots import make_subplots

    from harness.report.page import Plot
    from harness.report.plots import layout
    from harness.reproduce.experiments.augmented import UNITS, curves

    plot = make_subplots(rows=1, cols=2, horizontal_spacing=0.1)
    for column, (what, (unit, scale)) in enumerate(UNITS.items(), start=1):
        values = {name: scale * errors.rms(what) for name, errors in found.items()}
        curves(plot, np.arange(1.0, SAMPLES + 1), values, 1, column)
        plot.update_yaxes(
            title_text=f"{what}, axis y, {unit}", rangemode="tozero", row=1, col=column
        )
    plot.update_xaxes(title_text="samples since the occlusion began")
    return Plot(
        "Figure 4.10: simulated hand",
        f"Rms of {9 * ACQUISITIONS} occlusions along, and about, axis y.",
        layout(plot, 420),
    )


def _plot_recorded(found: Mapping[tuple[str, str], Errors]) -> Plot:
    import numpy as np
    from plotly.subplots import make_subplots

    from harness.report.page import Plot
    from harness.report.plots import layout
    from harness.reproduce.experiments.augmented import UNITS, curves

    trials = list(dict.fromkeys(trial for trial, _ in found))
    titles = [f"trial {trial}" for trial in trials]
    plot = make_subplots(
        rows=2, cols=len(trials), subplot_titles=titles, shared_yaxes="rows", shared_xaxes=True
    )
    for row, (what, (unit, scale)) in enumerate(UNITS.items(), start=1):
        for column, trial in enumerate(trials, start=1):
            values = {
                name: scale * getattr(errors, what)
                for (of, name), errors in found.items()
                if of == trial
            }
            curves(plot, np.array(DURATIONS), values, row, column)
        plot.update_yaxes(title_text=f"{what}, 3-D, {unit}", row=row, col=1)
    plot.update_xaxes(title_text="occlusion, s", row=2)
    layout(plot, 560)
    plot.update_layout(legend_y=1.08, margin_t=72)
    return Plot("Figure 4.10: BROAD", "Rms at the end of occlusions, by their length.", plot)


ITEM = Item(
    name="e13-figure-4.10",
    source=SOURCE,
    title="Errors by the length of an occlusion",
    group="sensing",
    run=run,
)
