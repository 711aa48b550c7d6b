"""What identifying an actuator gives: parameters with units, how well they explain, and the files.

A fit is seen here through `Identified` alone: the record that it fills, the values, and the stroke
that it predicts for a voltage. Which fits there are stands in `OPERATORS`; exchanging the inside of
one changes nothing else.

The residual is what the prediction leaves of the recording, an offset and a straight drift of the
sensor left out. Both are fitted on the part that the parameters were fitted to, and carried on to
the rest, which validates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy import signal

from fmu_src.kit import Model, Parameters
from fmu_src.kit.records import Field, Scalar
from fmu_src.kit.runner import Runner
from fmu_src.pack.build import load_model, model_names
from fmu_src.piezo import creeping, prandtl_ishlinskii, rate_dependent
from fmu_src.piezo import modulated_stops as stops
from harness.common.errors import SteadytipError
from harness.common.files import reason
from harness.common.types import FloatArray
from harness.identify.hysteresis import modulated_stops
from harness.identify.hysteresis import plays as hysteresis
from harness.identify.parameter_files import write_scalars
from harness.recordings.stack import Response, runs
from harness.report.page import Plot, Section, Table, made_with, write_sections
from harness.report.plots import GREY, SERIES, layout, line, thinned

__all__ = [
    "OPERATORS",
    "Evaluation",
    "Identified",
    "Operator",
    "evaluate",
    "fit_part",
    "places",
    "write_page",
    "write_set",
]

Progress = Callable[[int, int], None]
"""Told the number of steps done, and of all."""

BANDS = (0.0, 1.0, 5.0, 8.0, 12.0, 20.0, 50.0, 200.0)
"""Edges of the bands in which the residual is counted [Hz]; 8 to 12 Hz is tremor."""
SHORTEST_PART = 100
"""Samples that a part of a recording has at least, to be fitted or to validate."""
_MICRO = 1e6
_RAMP = 400  # samples of the loading curve
_WINDOW = 1.0  # s, of the spectra
_LOOPS = 1000  # samples of each part that are drawn over the voltage


@dataclass(frozen=True)
class Identified:
    """A fit, whatever made it.

    Attributes:
        parameters: values of the operator's record by field, in SI.
        predict: stroke for a voltage that begins at rest, (n,) [V] to (n,) [m], from any zero.
        order: how large the operator is, in words.
        tried: what else was tried: order, rms fitted [m], rms validated [m].
        first: samples at the beginning that the fit does not count with.
    """

    parameters: Mapping[str, Any]
    predict: Callable[[FloatArray], FloatArray]
    order: str
    tried: tuple[tuple[str, float, float], ...] = ()
    first: int = 0


@dataclass(frozen=True)
class Operator:
    """A kind of operator that can be fitted.

    Attributes:
        title: what it is, for people.
        model: computes it; where the parameters go unless another model is named.
        fit: makes a fit of a voltage (n,) [V], a stroke (n,) [m] and a sample period [s].
    """

    title: str
    model: Model
    fit: Callable[[FloatArray, FloatArray, float, Progress], Identified]

    @property
    def record(self) -> type[Parameters]:
        """Record class that holds its parameters, with units and ranges."""
        return self.model.parameters


def _played(
    model: Model,
    identify: Callable[[FloatArray, FloatArray, float], hysteresis.HysteresisFit],
    order: str,
    **inputs: Callable[[Mapping[str, Any], FloatArray, float], FloatArray],
) -> Callable[[FloatArray, FloatArray, float, Progress], Identified]:
    """A fit of an operator of plays, whose model then predicts.

    Args:
        model: of the operator.
        identify: makes the fit.
        order: how large the operator is, in words.
        inputs: of the model beside the voltage, from parameters, voltage and period.
    """

    def fit(volts: FloatArray, stroke: FloatArray, period: float, progress: Progress) -> Identified:
        progress(0, 1)
        found = identify(volts, stroke, period)
        progress(1, 1)

        def predict(volts: FloatArray) -> FloatArray:
            more = {name: of(found.parameters, volts, period) for name, of in inputs.items()}
            sampled = replace(model, sample_period=period)
            runner = Runner(sampled, found.parameters)
            return runner.run(len(volts), {"volts": volts, **more})["stroke"] + found.offset

        return Identified(found.parameters, predict, order, first=found.first)

    return fit


def _modulated_stops(
    volts: FloatArray, stroke: FloatArray, period: float, progress: Progress
) -> Identified:
    fit = modulated_stops.identify_stops(volts, stroke, period, progress=progress)
    return Identified(
        fit.parameters,
        fit.predict,
        f"{fit.order} stops",
        tuple(
            (f"{one.order} stops, power {one.power:g}", one.fitted, one.validated)
            for one in fit.candidates
        ),
        fit.first,
    )


_PLAYS = f"{prandtl_ishlinskii.PLAYS} plays, {prandtl_ishlinskii.DEAD_ZONES} dead zones"

OPERATORS = {
    "modulated-stops": Operator(
        "stop operators modulated by the voltage, with creep and lead",
        stops.MODEL,
        _modulated_stops,
    ),
    "prandtl-ishlinskii": Operator(
        "modified Prandtl-Ishlinskii operator (A04 7.2)",
        prandtl_ishlinskii.MODEL,
        _played(
            prandtl_ishlinskii.MODEL,
            lambda volts, stroke, period: hysteresis.identify_hysteresis(volts, stroke),
            _PLAYS,
        ),
    ),
    "rate-dependent": Operator(
        "rate-dependent Prandtl-Ishlinskii operator (A04 7.3)",
        rate_dependent.MODEL,
        _played(
            rate_dependent.MODEL,
            hysteresis.identify_rate_dependence,
            _PLAYS,
            rate=hysteresis.stroke_rate,
        ),
    ),
    "creeping": Operator(
        "Prandtl-Ishlinskii operator with creep (Krejci and Kuhnen 2001)",
        creeping.MODEL,
        _played(
            creeping.MODEL,
            hysteresis.identify_creeping,
            f"{_PLAYS}, {creeping.WIDTHS * creeping.LAGS} creep operators",
        ),
    ),
}
"""By the name that the command line has for them."""


@dataclass(frozen=True)
class Evaluation:
    """A fit against the whole recording that a part of was fitted.

    Attributes:
        response: the recording.
        operator: what was fitted.
        identified: the fit.
        fitted: whether each sample was fitted, (n,).
        counted: whether it counts, (n,); what is before the fit's first sample does not.
        predicted: stroke with the sensor's offset and drift, (n,) [m].
        drift: of the sensor [m/s].
    """

    response: Response
    operator: Operator
    identified: Identified
    fitted: np.ndarray
    counted: np.ndarray
    predicted: FloatArray
    drift: float

    @property
    def residual(self) -> FloatArray:
        """Measured less predicted, (n,) [m]."""
        return self.response.stroke - self.predicted

    @property
    def parts(self) -> dict[str, np.ndarray]:
        """Samples that were fitted and those that validate, by name; without empty ones."""
        both = {
            "fit": self.fitted & self.counted,
            "validation": ~self.fitted & self.counted,
        }
        return {name: part for name, part in both.items() if part.any()}

    def residual_table(self) -> Table:
        """Rms and largest residual of each part."""
        travel = np.ptp(self.response.stroke)
        rows = []
        for name, part in self.parts.items():
            left, time = self.residual[part], self.response.time[part]
            rms, worst = float(np.sqrt(np.mean(left**2))), int(np.abs(left).argmax())
            rows.append(
                (
                    name,
                    f"{part.sum() * self.response.period:.4g}",
                    f"{rms * _MICRO:.4g}",
                    f"{100 * rms / travel:.3g}",
                    f"{abs(left[worst]) * _MICRO:.4g}",
                    f"{100 * abs(left[worst]) / travel:.3g}",
                    f"{time[worst]:.4g}",
                )
            )
        columns = ("part", "s", "rms, µm", "% of p-p", "largest, µm", "% of p-p", "at, s")
        return Table(columns, tuple(rows), frozenset(range(1, 7)))

    def band_table(self) -> Table:
        """Rms of stroke and residual by frequency, each part; what it does not reach is left out.

        Sums of the periodogram over each band, a Hann window on each part; of a part in two pieces
        the longer one.
        """
        rate, parts = 1 / self.response.period, self.parts
        edges = [edge for edge in BANDS if edge < rate / 2]
        columns = ["frequency, Hz"]
        columns += [f"{what}, {name}, µm" for name in parts for what in ("stroke", "residual")]
        found = []
        for part in parts.values():
            piece = _longest(part)
            for values in (self.response.stroke[piece], self.residual[piece]):
                f, power = signal.periodogram(values, rate, "hann", detrend="linear")
                power = power * (f[1] - f[0])
                bins = np.searchsorted(edges, f, side="right") - 1
                found.append(np.sqrt(np.bincount(bins, power, len(edges))) * _MICRO)
        rows = [
            (f"{low:g} to {high:g}", *(f"{column[k]:.3g}" for column in found))
            for k, (low, high) in enumerate(zip(edges, (*edges[1:], rate / 2), strict=True))
        ]
        return Table(tuple(columns), tuple(rows), frozenset(range(1, len(columns))))


class Timed(Protocol):
    """A recording of anything."""

    @property
    def path(self) -> Path:
        """File that it comes from."""

    @property
    def time(self) -> FloatArray:
        """(n,) [s], from 0 on, rising."""


def fit_part(text: str, response: Timed) -> np.ndarray:
    """Samples to fit, (n,).

    Args:
        text: `START:END` in seconds, either of which may be missing, or the share of the recording
            from its beginning, `0.75` or `75%`.
        response: the recording.

    Raises:
        SteadytipError: not of that form, or a part that is too short.
    """
    n, time = len(response.time), response.time
    where = f"--fit {text}"
    try:
        if ":" in text:
            begin, end = (float(word) if word.strip() else None for word in text.split(":"))
            low, high = begin or 0.0, float(time[-1]) if end is None else end
            part = (time >= low) & (time <= high)
        else:
            share = float(text[:-1]) / 100 if text.strip().endswith("%") else float(text)
            if not 0 < share <= 1:
                raise SteadytipError(f"{where}: a share must be in (0, 1], or up to 100 %")
            part = np.arange(n) < round(share * n)
    except ValueError:
        raise SteadytipError(
            f"{where}: write START:END in seconds, as in 0:30, or a share, as in 0.75 or 75%"
        ) from None
    if part.sum() < SHORTEST_PART:
        raise SteadytipError(
            f"{where}: holds {part.sum()} of the {n} samples of {response.path} (0 to "
            f"{time[-1]:.6g} s); at least {SHORTEST_PART} are needed"
        )
    return part


def evaluate(
    response: Response, operator: Operator, fitted: np.ndarray, progress: Progress
) -> Evaluation:
    """Fit an operator to a part of a recording and predict all of it.

    Args:
        response: the recording.
        operator: what to fit.
        fitted: whether each sample is fitted, (n,); one piece.
        progress: told the steps done.

    Raises:
        SteadytipError: the part holds too little to fit.
    """
    begin = int(np.argmax(fitted))
    try:
        identified = operator.fit(
            response.volts[fitted], response.stroke[fitted], response.period, progress
        )
    except SteadytipError as error:
        part = f"{response.time[fitted][0]:.4g} to {response.time[fitted][-1]:.4g} s"
        raise SteadytipError(f"recording {response.path}, {part}: {error}") from None
    # What comes before a part in the middle validates, but for the beginning of the recording.
    counted = np.ones(len(fitted), dtype=bool)
    counted[: identified.first] = False
    counted[begin : begin + identified.first] = False
    raw = response.stroke - identified.predict(response.volts)
    used = fitted & counted
    middle = response.time[used].mean()
    drift, offset = np.polyfit(response.time[used] - middle, raw[used], 1)
    sensor = offset + drift * (response.time - middle)
    return Evaluation(
        response,
        operator,
        identified,
        fitted,
        counted,
        response.stroke - raw + sensor,
        float(drift),
    )


# The parameter set --------------------------------------------------------------------------------


def places(model: str, record: type[Parameters]) -> list[str]:
    """Prefixes under which a model takes a record: `""`, or `stack_1.`, `stack_2.`, ...

    Raises:
        SteadytipError: no such model, or one that takes no such record; names those that do.
    """
    found = list(_prefixes(load_model(model).parameters, record))
    if not found:
        others = [
            name
            for name in model_names()
            if any(True for _ in _prefixes(load_model(name).parameters, record))
        ]
        raise SteadytipError(
            f"--model {model}: takes no parameters of this operator; those that do are "
            f"{', '.join(others)}"
        )
    return found


def _prefixes(parameters: type, record: type[Parameters], prefix: str = "") -> Iterator[str]:
    if issubclass(parameters, record):
        yield prefix
        return
    for name, field in parameters.fields.items():  # type: ignore[attr-defined]
        if not isinstance(field, Field):
            yield from _prefixes(field, record, f"{prefix}{name}.")


def write_set(path: Path, record: type[Parameters], fits: Mapping[str, Identified]) -> Path:
    """Write an SSP parameter set (`.ssv`) that any run accepts.

    Args:
        path: file to write.
        record: that the parameters fill.
        fits: fits by the prefix under which the model takes them.

    Raises:
        ProblemsError: values that the model would refuse.
        SteadytipError: the file cannot be written.
    """
    found: list[tuple[Scalar, float]] = []
    for prefix, one in fits.items():
        stacked = np.concatenate(
            [
                np.asarray(one.parameters[key], dtype=float).flatten(order="F")
                for key in record.fields
            ]
        )
        found += zip(record.scalars(prefix), stacked.tolist(), strict=True)
    return write_scalars(
        path,
        found,
        "the recording does not suit the operator (is its voltage that ahead of an amplifier? give "
        "--gain; --operator modulated-stops takes any range)",
    )


# The page -----------------------------------------------------------------------------------------


def write_page(path: Path, operator: Operator, evaluations: list[Evaluation]) -> Path:
    """Write the page beside the parameter set.

    Args:
        path: file to write.
        operator: what was fitted.
        evaluations: one for each recording.

    Raises:
        SteadytipError: the file cannot be written.
    """
    names = ", ".join(one.response.path.name for one in evaluations)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_sections(
            path,
            "Hysteresis identified",
            f"{operator.title}, from {names}",
            (
                "The residual is what the operator's prediction leaves of the recording; an offset "
                "and a drift of the sensor are left out, both as fitted. The prediction runs from "
                "the beginning of the recording and never sees the measured stroke.",
            ),
            [_section(one) for one in evaluations],
            made_with("casadi", "numpy", "scipy", "plotly"),
        )
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {reason(error)}") from None


def _section(one: Evaluation) -> Section:
    response = one.response
    tables = [one.residual_table(), one.band_table()]
    if one.identified.tried:
        rows = [(name, f"{a * _MICRO:.4g}", f"{b * _MICRO:.4g}") for name, a, b in
                one.identified.tried]  # fmt: skip
        heads = ("tried", "rms fitted, µm", "rms validated, µm")
        tables.append(Table(heads, tuple(rows), frozenset({1, 2})))
    tables.append(_parameter_table(one))
    metadata = (
        f"{one.identified.order}. {len(response.time)} samples in {response.time[-1]:.4g} s, "
        f"period {response.period * 1e3:.4g} ms; "
        + ", ".join(response.columns.values())
        + ". Drift of "
        f"the sensor {one.drift * _MICRO:.3g} µm/s."
    )
    return Section(
        response.path.name,
        (metadata, *(f"Note: {note}." for note in response.notes)),
        tuple(tables),
        (_loops(one), _residuals(one), _spectra(one), _loading(one)),
    )


def _parameter_table(one: Evaluation) -> Table:
    rows = []
    for name, field in one.operator.record.fields.items():
        if isinstance(field, Field):
            values = np.atleast_1d(np.asarray(one.identified.parameters[name], dtype=float))
            shown = ", ".join(f"{value:.4g}" for value in values)
            rows.append((name, shown, field.unit or "", field.description))
    return Table(("parameter", "values", "unit", "meaning"), tuple(rows))


def _loops(one: Evaluation) -> Plot:
    parts = one.parts
    figure: go.Figure = make_subplots(
        rows=1, cols=len(parts), shared_yaxes=True, horizontal_spacing=0.04,
        subplot_titles=list(parts),
    )  # fmt: skip
    for column, part in enumerate(parts.values(), start=1):
        rows = np.flatnonzero(part)[:_LOOPS]
        volts, first = one.response.volts[rows], column == 1
        for values, colour, name, style in (
            (one.response.stroke, SERIES[5], "measured", {"width": 2.4}),
            (one.predicted, SERIES[1], "model", {"width": 1.0}),
        ):
            trace = line(volts, values[rows] * _MICRO, colour, name, first, **style)
            figure.add_trace(trace, row=1, col=column)
        figure.update_xaxes(title_text="voltage, V", row=1, col=column)
    figure.update_yaxes(title_text="displacement, µm", row=1, col=1)
    return Plot(
        "Loops",
        f"Displacement over voltage, measured and as the operator has it; the first {_LOOPS} "
        "samples of each part.",
        layout(figure, 440),
    )


def _longest(part: np.ndarray) -> slice:
    """The longest piece of a part."""
    return slice(*max(runs(part), key=lambda run: run[1] - run[0]))


def _residuals(one: Evaluation) -> Plot:
    figure = go.Figure()
    for (name, part), colour in zip(one.parts.items(), SERIES, strict=False):
        for index, (begin, end) in enumerate(runs(part)):
            x, y = thinned(one.response.time[begin:end], one.residual[begin:end] * _MICRO)
            figure.add_trace(line(x, y, colour, name, index == 0))
    figure.update_xaxes(title_text="time, s")
    figure.update_yaxes(title_text="residual, µm")
    return Plot("Residual", "Measured less predicted.", layout(figure, 320))


def _spectra(one: Evaluation) -> Plot:
    figure = go.Figure()
    rate = 1 / one.response.period
    part = _longest(one.parts.get("validation", one.parts["fit"]))
    window = min(round(_WINDOW * rate), part.stop - part.start)
    for values, colour, name in (
        (one.response.stroke, GREY, "displacement"),
        (one.residual, SERIES[1], "residual"),
    ):
        f, power = signal.welch(values[part], rate, nperseg=window, detrend="linear")
        density = np.sqrt(power[1:]) * _MICRO
        figure.add_trace(line(f[1:], density, colour, name))
    figure.update_xaxes(type="log", title_text="frequency, Hz")
    figure.update_yaxes(
        type="log", title_text="amplitude density, µm/√Hz", exponentformat="power", dtick=1
    )
    what = "validation" if "validation" in one.parts else "fit"
    return Plot(
        "Spectrum of the residual",
        f"Welch's estimate over the {what}, Hann windows of {window / rate:.3g} s.",
        layout(figure, 360),
    )


def _loading(one: Evaluation) -> Plot:
    top = float(one.response.volts.max())
    up = np.linspace(0.0, top, _RAMP)
    volts = np.concatenate((up, up[-2::-1]))
    stroke = one.identified.predict(volts)
    stroke = (stroke - stroke[0]) * _MICRO
    figure = go.Figure()
    figure.add_trace(line(up, stroke[:_RAMP], SERIES[0], "loading from rest", width=2.2))
    back = slice(_RAMP - 1, None)
    figure.add_trace(line(volts[back], stroke[back], GREY, "and back", dash="dot"))
    figure.update_xaxes(title_text="voltage, V")
    figure.update_yaxes(title_text="stroke, µm")
    return Plot(
        "Loading curve",
        f"The operator from rest to {top:.4g} V and back.",
        layout(figure, 380),
    )
