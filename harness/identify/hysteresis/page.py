"""Results of a fitted operator: tables for the terminal, and the page beside the parameter file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy import signal

from fmu_src.kit.records import Field
from harness.identify.hysteresis.evaluation import HysteresisEvaluation
from harness.identify.hysteresis.operators import Operator
from harness.identify.page import write_topic_page
from harness.recordings.quality import BoolArray, runs
from harness.report.page import Plot, Section, Table
from harness.report.plots import GREY, SERIES, layout, line, thinned

__all__ = ["band_table", "residual_table", "write_page"]

BANDS = (0.0, 1.0, 5.0, 8.0, 12.0, 20.0, 50.0, 200.0)
"""Edges of the bands of the residual [Hz]; 8 to 12 Hz is tremor."""
_MICRO = 1e6
_RAMP = 400  # samples of the loading curve
_WINDOW = 1.0  # s, of the spectra
_LOOPS = 1000  # samples of each part that are drawn over the voltage


def write_page(path: Path, operator: Operator, evaluations: list[HysteresisEvaluation]) -> Path:
    """Write the page beside the parameter file.

    Args:
        path: file to write.
        operator: operator that was fitted.
        evaluations: one for each recording.

    Raises:
        SteadytipError: the file cannot be written.
    """
    names = ", ".join(one.response.path.name for one in evaluations)
    return write_topic_page(
        path,
        "Hysteresis identified",
        f"{operator.title}, from {names}",
        (
            "The residual is what the operator's prediction leaves of the recording; an offset "
            "and a drift of the sensor are left out, both as fitted. The prediction runs from "
            "the beginning of the recording and never sees the measured stroke.",
        ),
        [_section(one) for one in evaluations],
        "casadi",
    )


def residual_table(one: HysteresisEvaluation) -> Table:
    """Tabulate rms and largest residual of each part."""
    travel = np.ptp(one.response.stroke)
    rows = []
    for name, part in one.parts.items():
        left, time = one.residual[part], one.response.time[part]
        rms, worst = float(np.sqrt(np.mean(left**2))), int(np.abs(left).argmax())
        rows.append(
            (
                name,
                f"{part.sum() * one.response.period:.4g}",
                f"{rms * _MICRO:.4g}",
                f"{100 * rms / travel:.3g}",
                f"{abs(left[worst]) * _MICRO:.4g}",
                f"{100 * abs(left[worst]) / travel:.3g}",
                f"{time[worst]:.4g}",
            )
        )
    columns = ("part", "s", "rms, µm", "% of p-p", "largest, µm", "% of p-p", "at, s")
    return Table(columns, tuple(rows), frozenset(range(1, 7)))


def band_table(one: HysteresisEvaluation) -> Table:
    """Tabulate the rms of stroke and residual of each part by frequency.

    Each rms is a sum of the periodogram over a band, with a Hann window on each part. Of a part in
    two pieces the longer one is used. Bands beyond half the sample rate are left out.
    """
    rate, parts = 1 / one.response.period, one.parts
    edges = [edge for edge in BANDS if edge < rate / 2]
    columns = ["frequency, Hz"]
    columns += [f"{what}, {name}, µm" for name in parts for what in ("stroke", "residual")]
    found = []
    for part in parts.values():
        piece = _longest(part)
        for values in (one.response.stroke[piece], one.residual[piece]):
            f, power = signal.periodogram(values, rate, "hann", detrend="linear")
            power = power * (f[1] - f[0])
            bins = np.searchsorted(edges, f, side="right") - 1
            found.append(np.sqrt(np.bincount(bins, power, len(edges))) * _MICRO)
    rows = [
        (f"{low:g} to {high:g}", *(f"{column[k]:.3g}" for column in found))
        for k, (low, high) in enumerate(zip(edges, (*edges[1:], rate / 2), strict=True))
    ]
    return Table(tuple(columns), tuple(rows), frozenset(range(1, len(columns))))


def _section(one: HysteresisEvaluation) -> Section:
    response = one.response
    tables = [residual_table(one), band_table(one)]
    if one.fit.tried:
        rows = [(name, f"{a * _MICRO:.4g}", f"{b * _MICRO:.4g}") for name, a, b in
                one.fit.tried]  # fmt: skip
        heads = ("tried", "rms fitted, µm", "rms validated, µm")
        tables.append(Table(heads, tuple(rows), frozenset({1, 2})))
    tables.append(_parameter_table(one))
    metadata = (
        f"{one.fit.order}. {len(response.time)} samples in {response.time[-1]:.4g} s, "
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


def _parameter_table(one: HysteresisEvaluation) -> Table:
    rows = []
    for name, field in one.operator.record.fields.items():
        if isinstance(field, Field):
            values = np.atleast_1d(np.asarray(one.fit.parameters[name], dtype=float))
            shown = ", ".join(f"{value:.4g}" for value in values)
            rows.append((name, shown, field.unit or "", field.description))
    return Table(("parameter", "values", "unit", "meaning"), tuple(rows))


def _loops(one: HysteresisEvaluation) -> Plot:
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


def _longest(part: BoolArray) -> slice:
    """Return the longest piece of a part."""
    return slice(*max(runs(part), key=lambda run: run[1] - run[0]))


def _residuals(one: HysteresisEvaluation) -> Plot:
    figure = go.Figure()
    for (name, part), colour in zip(one.parts.items(), SERIES, strict=False):
        for index, (begin, end) in enumerate(runs(part)):
            x, y = thinned(one.response.time[begin:end], one.residual[begin:end] * _MICRO)
            figure.add_trace(line(x, y, colour, name, index == 0))
    figure.update_xaxes(title_text="time, s")
    figure.update_yaxes(title_text="residual, µm")
    return Plot("Residual", "Measured less predicted.", layout(figure, 320))


def _spectra(one: HysteresisEvaluation) -> Plot:
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


def _loading(one: HysteresisEvaluation) -> Plot:
    top = float(one.response.volts.max())
    up = np.linspace(0.0, top, _RAMP)
    volts = np.concatenate((up, up[-2::-1]))
    stroke = one.fit.predict(volts)
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
