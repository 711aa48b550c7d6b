"""Estimators of attitude alone on the BROAD trials, beside VQF."""

from __future__ import annotations

from typing import TYPE_CHECKING

from harness.common.figures import Figure
from harness.reproduce.item import Context, Item, ItemResult

if TYPE_CHECKING:
    from collections.abc import Mapping

    from harness.report.page import Plot
    from harness.reproduce.experiments.orientation import Errors

SOURCE = "BROAD"
FOLDER = "broad"


def run(context: Context) -> ItemResult:
    """Run every estimator on every trial, and score it as the benchmark does."""
    import numpy as np

    from harness.reproduce.experiments.broad import TRIALS, read_trial
    from harness.reproduce.experiments.orientation import KINDS, errors, estimators

    known = estimators()
    folder = context.recordings(FOLDER)
    found: dict[str, dict[str, Errors]] = {each.name: {} for each in known}
    for number, name in enumerate(TRIALS):
        trial = read_trial(folder / f"{name}.mat")
        for place, each in enumerate(known):
            context.progress(
                (number + place / len(known)) / len(TRIALS), f"{each.name}, {_short(name)}"
            )
            found[each.name][name] = errors(trial, each.attitude(trial))
    context.progress(0.98, "plots")
    figures = []
    for each in known:
        for kind in KINDS:
            rms = [np.degrees(found[each.name][name].rms(kind)) for name in TRIALS]
            for setting, value in (
                *((_short(name), rms) for name, rms in zip(TRIALS, rms, strict=True)),
                (f"mean of {len(TRIALS)} trials", float(np.mean(rms))),
            ):
                quantity = f"{kind} error, rms: {each.name}"
                figures.append(Figure(SOURCE, quantity, "deg", None, float(value), setting))
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
    """`06_undisturbed_fast_rotation_A` as `trial 06, fast rotation`."""
    number, _, *words = name.split("_")
    return f"trial {number}, {' '.join(word for word in words if len(word) > 1)}"


def _bars(found: Mapping[str, Mapping[str, Errors]]) -> Plot:
    import numpy as np
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    from harness.report.page import Plot
    from harness.report.plots import SERIES, layout
    from harness.reproduce.experiments.orientation import KINDS

    plot = make_subplots(rows=len(KINDS), cols=1, shared_xaxes=True, vertical_spacing=0.05)
    for row, kind in enumerate(KINDS, start=1):
        for place, (name, trials) in enumerate(found.items()):
            plot.add_trace(
                go.Bar(
                    x=[_short(trial) for trial in trials],
                    y=[np.degrees(errors.rms(kind)) for errors in trials.values()],
                    name=name,
                    legendgroup=name,
                    showlegend=row == 1,
                    marker_color=SERIES[place % len(SERIES)],
                ),
                row=row,
                col=1,
            )
        plot.update_yaxes(title_text=f"{kind}, deg", row=row, col=1)
    return Plot(
        "Errors of attitude",
        "Rms over the movement of each trial.",
        layout(plot, 640, barmode="group"),
    )


def _over_time(found: Mapping[str, Mapping[str, Errors]]) -> Plot:
    import numpy as np
    from plotly.subplots import make_subplots

    from harness.report.page import Plot
    from harness.report.plots import SERIES, layout, line, thinned

    trials = list(next(iter(found.values())))
    plot = make_subplots(
        rows=len(trials), cols=1, vertical_spacing=0.05, row_titles=[t[:2] for t in trials]
    )
    for row, trial in enumerate(trials, start=1):
        for place, (name, of_trial) in enumerate(found.items()):
            errors = of_trial[trial]
            curve = thinned(errors.time, np.degrees(errors.total))
            plot.add_trace(
                line(*curve, SERIES[place % len(SERIES)], name, row == 1), row=row, col=1
            )
        plot.update_yaxes(title_text="total, deg", rangemode="tozero", row=row, col=1)
    plot.update_xaxes(title_text="time, s", row=len(trials), col=1)
    return Plot(
        "Errors over time",
        "Total error of each trial's movement, numbers of the trials on the right.",
        layout(plot, 160 * len(trials)),
    )


ITEM = Item(
    name="attitude-broad",
    source=SOURCE,
    title="Attitude from one inertial unit on recorded motion, beside VQF",
    group="sensing",
    run=run,
    recordings=(FOLDER,),
)
