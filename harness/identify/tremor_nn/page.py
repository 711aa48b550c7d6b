"""Results of a trained filter: tables for the terminal, and the page beside the parameter file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from fmu_src.tremor.cascade_neural import ACTIVATIONS, SAMPLE_PERIOD
from harness.common.types import FloatArray
from harness.identify.page import write_topic_page
from harness.identify.tremor_nn.cascade import CUTOFF, RATE, Network
from harness.identify.tremor_nn.fit import TESTS, FilterEvaluation, unseen_motion
from harness.report.page import Plot, Section, Table
from harness.report.plots import GREY, SERIES, layout, line, thinned

__all__ = ["over_time", "trial_table", "unit_table", "write_page"]

_MICRO = 1e6
_SHOWN = 12.0  # s, of a trial in a plot


def trial_table(done: FilterEvaluation) -> Table:
    """Tabulate the rms error of each trial before and after the filter."""
    rows = []
    for role, scores in done.scores.items():
        last = scores[-1]
        for trial, raw, left in zip(done.trials_of(role), last.raw, last.filtered, strict=True):
            rows.append(_row(trial.name, role, raw, left))
        if len(done.trials_of(role)) > 1:
            rows.append(_row("mean", role, last.raw.mean(), last.filtered.mean()))
    columns = ("trial", "for", "rms error, µm", "filtered, µm", "reduction, %")
    return Table(columns, tuple(rows), frozenset({2, 3, 4}))


def unit_table(done: FilterEvaluation) -> Table:
    """Tabulate the reduction with each number of hidden units."""
    names = list(ACTIVATIONS)
    rows = []
    for k, left in enumerate(done.network.errors):
        kind = names[done.network.nodes[k - 1].kind - 1] if k else "linear"
        shown = (f"{scores[k].reduction:.1f}" for scores in done.scores.values())
        rows.append((str(k), kind, f"{100 * left:.2f}", *shown))
    reductions = (f"reduction, {role}, %" for role in done.scores)
    columns = ("hidden units", "the last one", "left in training, %", *reductions)
    return Table(columns, tuple(rows), frozenset({0, *range(2, len(columns))}))


def _row(name: str, role: str, raw: float, left: float) -> tuple[str, ...]:
    values = (f"{raw * _MICRO:.4g}", f"{left * _MICRO:.4g}", f"{100 * (1 - left / raw):.1f}")
    return (name, role, *values)


def write_page(path: Path, done: FilterEvaluation) -> Path:
    """Write the page beside the parameter file.

    Raises:
        SteadytipError: the file cannot be written.
    """
    size = done.network.architecture
    window = size.lead * SAMPLE_PERIOD
    metadata = (
        f"{size.inputs} inputs, {1e3 * size.spacing * SAMPLE_PERIOD:g} ms apart, a window of "
        f"{window:.3g} s; {len(done.network.nodes)} hidden units. The motions that are made up "
        f"have {done.rms * _MICRO:.4g} µm rms below {CUTOFF:g} Hz."
    )
    notes = tuple(f"Note: {trial.note}." for trial in done.trials if trial.note)
    section = Section(
        "Cascade neural filter",
        (metadata, *notes),
        (trial_table(done), unit_table(done)),
        (_by_units(done), _over_time(done)),
    )
    return write_topic_page(
        path,
        "Neural filter trained",
        f"on {len(done.trials_of('trained'))} trials of one axis each",
        (
            "Whoever was recorded tried to hold still, so that all of the motion is error. It "
            "is put on a motion that is made up, white noise behind a low-pass, which the "
            "filter is to give back. The error is the rms of what it gives, less that motion; "
            f"mean over {TESTS} motions that the training has not seen.",
        ),
        [section],
        "casadi",
    )


def _by_units(done: FilterEvaluation) -> Plot:
    units = np.arange(float(len(done.network.errors)))
    figure: go.Figure = make_subplots(rows=1, cols=2, horizontal_spacing=0.1)
    left = line(units, 100 * np.array(done.network.errors), GREY, "left in training")
    left.mode = "lines+markers"
    figure.add_trace(left, row=1, col=1)
    for (role, scores), colour in zip(done.scores.items(), SERIES, strict=False):
        curve = line(units, np.array([each.reduction for each in scores]), colour, role)
        curve.mode = "lines+markers"
        figure.add_trace(curve, row=1, col=2)
    figure.update_xaxes(title_text="hidden units", dtick=1)
    figure.update_yaxes(title_text="rms error, % of the motion's rms", row=1, col=1)
    figure.update_yaxes(title_text="reduction, %", row=1, col=2)
    return Plot(
        "By hidden units",
        "Left, what training leaves of its targets with each unit that is added, over all levels "
        "of the error; right, the reduction of the rms error of trials as recorded.",
        layout(figure, 360),
    )


def _over_time(done: FilterEvaluation) -> Plot:
    role = next(role for role in ("other", "rest", "trained") if role in done.scores)
    trial = done.trials_of(role)[0]
    plot = over_time(done.network, trial.error, done.rms)
    return Plot(
        "Before and after",
        f"{trial.name}: motion that was made up, with the error as the filter sees it, and what "
        "it gives (above); error before and after (below).",
        plot,
    )


def over_time(network: Network, error: FloatArray, rms: float) -> go.Figure:
    """Plot motion, input and output of a filter, and the errors before and after, as A04 Fig. 5.7.

    Args:
        network: the filter.
        error: error of a trial, (n,) [m].
        rms: rms of the motion [m].
    """
    lead = network.architecture.lead
    motion = unseen_motion(len(error), rms, 0, 0)
    found = network.filtered(motion + error)
    shown = slice(0, round(_SHOWN * RATE))
    time = (np.arange(float(len(error)))[lead:] * SAMPLE_PERIOD)[shown]
    target, raw = motion[lead:][shown], error[lead:][shown]
    figure: go.Figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for row, curves in enumerate(
        (
            (
                (target + raw, SERIES[5], "input", {"width": 1.2}),
                (target, GREY, "motion", {"dash": "dot"}),
                (found[shown], SERIES[1], "output", {"width": 1.6}),
            ),
            (
                (raw, SERIES[5], "input", {"width": 1.2}),
                (found[shown] - target, SERIES[1], "output", {"width": 1.6}),
            ),
        ),
        start=1,
    ):
        for values, colour, name, style in curves:
            x, y = thinned(time, values * _MICRO)
            figure.add_trace(line(x, y, colour, name, row == 1, **style), row=row, col=1)
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    figure.update_yaxes(title_text="position, µm", row=1, col=1)
    figure.update_yaxes(title_text="error, µm", row=2, col=1)
    return layout(figure, 520)
