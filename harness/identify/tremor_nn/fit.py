"""What training the cascade neural filter on recordings gives: a network, how well it does, files.

A trial is one axis of a recording, about the place that was held, which is its mean: whoever
recorded it tried to hold still, so that all of it is error. What the filter gets is that error on
a motion that is made up, and what it is to give back is that motion (see `cascade`). Reductions
are of the rms error, `1 - rms(m - v) / rms(s - v)`, from the sample on at which the window is full,
on motions that no training has seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy.interpolate import make_interp_spline

from fmu_src.kit.runner import Runner
from fmu_src.tremor.cascade_neural import ACTIVATIONS, MODEL, SAMPLE_PERIOD
from harness.common.errors import SteadytipError
from harness.common.files import reason
from harness.common.types import FloatArray
from harness.identify.hysteresis.evaluation import fit_part
from harness.identify.parameter_files import write_scalars
from harness.identify.tremor_nn.cascade import (
    CUTOFF,
    RATE,
    Architecture,
    Network,
    Progress,
    Training,
    pseudo_motion,
    train_filter,
)
from harness.recordings.motion import Recording, read_recording
from harness.report.page import Plot, Section, Table, made_with, write_sections
from harness.report.plots import GREY, SERIES, layout, line, thinned

__all__ = ["Evaluation", "Score", "Trial", "evaluate", "score", "trials", "write_page", "write_set"]

AXES = "xyz"
STILL = 1e-3
"""Rms beyond which nobody held still; A04 table 5.1 has 0.05 to 0.13 mm [m]."""
TESTS = 4
"""Motions on which a network is tested."""
_UNSEEN = 7919
"""Begins the seeds of motions that no training makes up."""
_MICRO = 1e6
_SHOWN = 12.0
"""Of a trial in a plot [s]."""


@dataclass(frozen=True)
class Trial:
    """One axis of a recording in which somebody held still.

    Attributes:
        name: for people.
        error: about the place that was held, (n,) [m], at RATE.
        role: what it is for: `trained`, `rest` of a recording of which a part was trained on, or
            `other` recordings.
        note: what is odd about it; empty if nothing is.
    """

    name: str
    error: FloatArray
    role: str = "trained"
    note: str = ""

    @property
    def rms(self) -> float:
        """About its mean [m]."""
        return float(np.std(self.error))


@dataclass(frozen=True)
class Score:
    """A filter on some trials, mean over the motions.

    Attributes:
        raw: rms error of each trial before the filter [m].
        filtered: the same after it [m].
    """

    raw: FloatArray
    filtered: FloatArray

    @property
    def reduction(self) -> float:
        """Of the mean rms error [%] (A04 table 5.2)."""
        return 100.0 * float(1.0 - self.filtered.mean() / self.raw.mean())


def at_rate(recording: Recording) -> FloatArray:
    """Position at RATE: as recorded where that is its rate, else through a quintic spline.

    Returns:
        (n, 3) [m].
    """
    count = int(recording.seconds * RATE + 1e-6) + 1
    time = np.arange(count) * SAMPLE_PERIOD
    if len(time) == len(recording.time) and np.abs(time - recording.time).max() < 1e-6:
        return recording.position
    found: FloatArray = make_interp_spline(recording.time, recording.position, 5)(time)
    return found


def trials(path: Path, axes: str, part: str, role: str = "trained") -> list[Trial]:
    """Trials of a recording.

    Args:
        path: of the recording.
        axes: some of x, y, z.
        part: that counts, as `--fit` writes it; the rest makes trials of its own.
        role: of the part.

    Raises:
        SteadytipError: no such recording, or one that cannot be read; no such part.
    """
    recording = read_recording(path)
    chosen = fit_part(part, recording)
    position = at_rate(recording)
    time = np.arange(len(position)) * SAMPLE_PERIOD
    inside = np.interp(time, recording.time, chosen.astype(float)) >= 0.5
    begin, end = int(np.argmax(inside)), len(inside) - int(np.argmax(inside[::-1]))
    pieces = [(begin, end, role)]
    if role == "trained" and end < len(inside):
        pieces.append((end, len(inside), "rest"))
    found = []
    for first, past, what in pieces:
        for axis in axes:
            values = position[first:past, AXES.index(axis)]
            error = values - values.mean()
            name = f"{path.name}, {axis}, {time[first]:.4g} to {time[past - 1]:.4g} s"
            note = (
                f"{name} moves by {1e3 * np.std(error):.3g} mm rms, which is more than holding "
                "still; all of it counts as error: choose a part with --fit, or other recordings"
                if np.std(error) > STILL
                else ""
            )
            found.append(Trial(name, error, what, note))
    return found


def score(network: Network, errors: Sequence[FloatArray], rms: float, seed: int = 0) -> Score:
    """How much of some errors a network takes away, mean over TESTS motions.

    Args:
        network: a filter.
        errors: of each trial, (n,) [m], longer than the window.
        rms: of the motions [m].
        seed: of the motions, which no training sees.
    """
    lead = network.architecture.lead
    raw = np.array([np.sqrt(np.mean(error[lead:] ** 2)) for error in errors])
    left = np.zeros((TESTS, len(errors)))
    for test in range(TESTS):
        for k, error in enumerate(errors):
            motion = unseen(len(error), rms, seed, test)
            found = network.filtered(motion + error)
            left[test, k] = np.sqrt(np.mean((found - motion[lead:]) ** 2))
    return Score(raw, left.mean(axis=0))


def unseen(samples: int, rms: float, seed: int, test: int) -> FloatArray:
    """A motion that no training sees, the same for all trials, (samples,) [m].

    Args:
        samples: how many.
        rms: of the motion [m].
        seed: of the tests.
        test: which of them.
    """
    return pseudo_motion(samples, rms, np.random.default_rng((_UNSEEN, seed, test)))


@dataclass(frozen=True)
class Evaluation:
    """A network on the trials that it was trained on and on others.

    Attributes:
        network: with all hidden units.
        trials: all of them; those too short for the window are left out.
        rms: of the motions that are made up [m].
        scores: of each role, for each number of hidden units from none on.
    """

    network: Network
    trials: tuple[Trial, ...]
    rms: float
    scores: dict[str, tuple[Score, ...]]

    def of(self, role: str) -> list[Trial]:
        """Trials of a role."""
        return [trial for trial in self.trials if trial.role == role]

    def table(self) -> Table:
        """Rms error before and after the filter, of each trial."""
        rows = []
        for role, scores in self.scores.items():
            last = scores[-1]
            for trial, raw, left in zip(self.of(role), last.raw, last.filtered, strict=True):
                rows.append(_row(trial.name, role, raw, left))
            if len(self.of(role)) > 1:
                rows.append(_row("mean", role, last.raw.mean(), last.filtered.mean()))
        columns = ("trial", "for", "rms error, µm", "filtered, µm", "reduction, %")
        return Table(columns, tuple(rows), frozenset({2, 3, 4}))

    def unit_table(self) -> Table:
        """What each hidden unit brought."""
        names = list(ACTIVATIONS)
        rows = []
        for k, left in enumerate(self.network.errors):
            kind = names[self.network.nodes[k - 1].kind - 1] if k else "linear"
            shown = (f"{scores[k].reduction:.1f}" for scores in self.scores.values())
            rows.append((str(k), kind, f"{100 * left:.2f}", *shown))
        reductions = (f"reduction, {role}, %" for role in self.scores)
        columns = ("hidden units", "the last one", "left in training, %", *reductions)
        return Table(columns, tuple(rows), frozenset({0, *range(2, len(columns))}))


def _row(name: str, role: str, raw: float, left: float) -> tuple[str, ...]:
    values = (f"{raw * _MICRO:.4g}", f"{left * _MICRO:.4g}", f"{100 * (1 - left / raw):.1f}")
    return (name, role, *values)


def evaluate(
    found: Sequence[Trial],
    architecture: Architecture,
    training: Training,
    rms: float | None = None,
    progress: Progress = lambda done, count: None,
) -> Evaluation:
    """Train a network and test it.

    Args:
        found: trials; those with the role `trained` are trained on.
        architecture: size of the network.
        training: how.
        rms: of the motions that are made up [m]; the mean of the trials trained on by default, as
            in the thesis.
        progress: told the steps done.

    Raises:
        SteadytipError: trials at rest, or too short to train on.
    """
    trained = [trial for trial in found if trial.role == "trained"]
    level = float(np.mean([trial.rms for trial in trained])) if rms is None else rms
    network = train_filter(
        [trial.error for trial in trained],
        level,
        architecture,
        training,
        progress=progress,
        names=[f"recording {trial.name}" for trial in trained],
    )
    kept = tuple(trial for trial in found if len(trial.error) > architecture.lead)
    scores = {}
    for role in dict.fromkeys(trial.role for trial in kept):
        errors = [trial.error for trial in kept if trial.role == role]
        scores[role] = tuple(
            score(network.cut(k), errors, level, training.seed)
            for k in range(architecture.hidden + 1)
        )
    return Evaluation(network, kept, level, scores)


def write_set(path: Path, network: Network) -> Path:
    """Write a network as a parameter set (`.ssv`) for the model `CascadeNeural`.

    The place that is held is no part of it.

    Raises:
        ProblemsError: values that the model would refuse.
        SteadytipError: the file cannot be written.
    """
    values = Runner(MODEL, network.parameters()).p.tolist()
    found = [
        (scalar, value)
        for scalar, value in zip(MODEL.parameters.scalars(), values, strict=True)
        if not scalar.name.startswith("origin[")
    ]
    return write_scalars(path, found, "the recordings do not suit the model (is their unit right?)")


def write_page(path: Path, done: Evaluation) -> Path:
    """Write the page beside the parameter set.

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
        (done.table(), done.unit_table()),
        (_by_units(done), _over_time(done)),
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_sections(
            path,
            "Neural filter trained",
            f"on {len(done.of('trained'))} trials of one axis each",
            (
                "Whoever was recorded tried to hold still, so that all of the motion is error. It "
                "is put on a motion that is made up, white noise behind a low-pass, which the "
                "filter is to give back. The error is the rms of what it gives, less that motion; "
                f"mean over {TESTS} motions that the training has not seen.",
            ),
            [section],
            made_with("casadi", "numpy", "scipy", "plotly"),
        )
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {reason(error)}") from None


def _by_units(done: Evaluation) -> Plot:
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


def _over_time(done: Evaluation) -> Plot:
    role = next(role for role in ("other", "rest", "trained") if role in done.scores)
    trial = done.of(role)[0]
    plot = over_time(done.network, trial.error, done.rms)
    return Plot(
        "Before and after",
        f"{trial.name}: motion that was made up, with the error as the filter sees it, and what "
        "it gives (above); error before and after (below).",
        plot,
    )


def over_time(network: Network, error: FloatArray, rms: float) -> go.Figure:
    """Motion, input and output of a filter, and the errors before and after it, as A04 Fig. 5.7.

    Args:
        network: the filter.
        error: of a trial, (n,) [m].
        rms: of the motion [m].
    """
    lead = network.architecture.lead
    motion = unseen(len(error), rms, 0, 0)
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
