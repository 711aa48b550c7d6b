"""Estimators of attitude alone on the BROAD trials, beside VQF."""

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go

from harness.common.figures import Figure
from harness.report.page import Plot
from harness.report.plots import SERIES, grid, line, thinned
from harness.reproduce.experiments.broad import TRIALS, read_trial
from harness.reproduce.experiments.orientation import KINDS, AttitudeErrors, errors, estimators
from harness.reproduce.item import Context, Item, ItemResult, figures_of

SOURCE = "BROAD"
FOLDER = "broad"


def run(context: Context) -> ItemResult:
    """Run every estimator on every trial, and score it as the benchmark does."""
    known = estimators()
    folder = context.recordings(FOLDER)
    found: dict[str, dict[str, AttitudeErrors]] = {each.name: {} for each in known}
    for number, name in enumerate(TRIALS):
        trial = read_trial(folder / f"{name}.mat")
        for place, each in enumerate(known):
            context.progress(
                (number + place / len(known)) / len(TRIALS), f"{each.name}, {_short(name)}"
            )
            found[each.name][name] = errors(trial, each.attitude(trial))
    context.progress(0.98, "plots")
    figures: list[Figure] = []
    for each in known:
        for kind in KINDS:
            rms = [np.degrees(found[each.name][name].rms(kind)) for name in TRIALS]
            values = [*map(float, rms), float(np.mean(rms))]
            settings = [*map(_short, TRIALS), f"mean of {len(TRIALS)} trials"]
            for setting, value in zip(settings, values, strict=True):
                row = (f"{kind} error, rms: {each.name}", "deg", None, value)
                figures += figures_of(SOURCE, setting, [row])
    return ItemResult(
        figures=tuple(figures),
        plots=(_bars(found), _over_time(found)),
        notes=(
            "Recorded: an inertial unit of 285.7 Hz, and optical motion capture as the truth. "
            "Every estimator gets the raw samples one after the other, with one set of parameters "
            "for all trials. Errors are over the samples of movement, in the world: heading is the "
            "error's turn about the vertical, inclination that about a horizontal axis, total both "
            "together. Nothing is aligned beforehand.",
            f"What each of them sees: {'; '.join(f'{each.name}: {each.sees}' for each in known)}.",
            "Trial 25 is disturbed by taps of a finger, trial 33 by a magnet 2 cm beside the unit. "
            "What sees the tracker gets each tenth of its attitudes as it comes, and is scored at "
            "all the others, too: it is no rival of those that do not, but tells what a tracker is "
            "worth. MicronEstimator needs six accelerometers at three sites, and is not here.",
        ),
    )


def _short(name: str) -> str:
    """Return `trial 06, fast rotation` for `06_undisturbed_fast_rotation_A`."""
    number, _, *words = name.split("_")
    return f"trial {number}, {' '.join(word for word in words if len(word) > 1)}"


def _bars(found: Mapping[str, Mapping[str, AttitudeErrors]]) -> Plot:
    panels = [
        [
            [
                go.Bar(
                    x=[_short(trial) for trial in trials],
                    y=[np.degrees(each.rms(kind)) for each in trials.values()],
                    name=name,
                    legendgroup=name,
                    marker_color=SERIES[place % len(SERIES)],
                )
                for place, (name, trials) in enumerate(found.items())
            ]
        ]
        for kind in KINDS
    ]
    plot = grid(panels, "", [f"{kind}, deg" for kind in KINDS], 640)
    plot.update_layout(barmode="group")
    return Plot(
        "Errors of attitude",
        "Rms over the movement of each trial.",
        plot,
    )


def _over_time(found: Mapping[str, Mapping[str, AttitudeErrors]]) -> Plot:
    trials = list(next(iter(found.values())))
    panels = []
    for trial in trials:
        curves = []
        for place, (name, of_trial) in enumerate(found.items()):
            each = of_trial[trial]
            curve = thinned(each.time, np.degrees(each.total))
            curves.append(line(*curve, SERIES[place % len(SERIES)], name))
        panels.append([curves])
    plot = grid(
        panels,
        "time, s",
        ["total, deg"] * len(trials),
        160 * len(trials),
        shared_xaxes=False,
        row_titles=[trial[:2] for trial in trials],
    )
    plot.update_yaxes(rangemode="tozero")
    return Plot(
        "Errors over time",
        "Total error of each trial's movement, numbers of the trials on the right.",
        plot,
    )


ITEM = Item(
    name="attitude-broad",
    source=SOURCE,
    title="Attitude from one inertial unit on recorded motion, beside VQF",
    group="sensing",
    run=run,
    recordings=(FOLDER,),
)
