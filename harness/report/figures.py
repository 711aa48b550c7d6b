"""Figures of the report. Everything in display units: µm, V, deg, s, Hz."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy import signal

from harness.display import DISPLAY
from harness.metrics import TREMOR_BAND, Motion, angle_between, intent_of
from harness.parts import FloatArray

__all__ = ["Figure", "figures"]

_AXES = "xyz"
# Okabe and Ito's palette: tells apart for colour-blind readers, and in print.
_WITHOUT, _WITH, _INTENT = "#d55e00", "#0072b2", "#444444"
_SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_POINTS = 4000  # per curve; more than a screen has columns
_ZOOM = 1.0  # s
_LOOP_SECONDS = 4.0
_SPECTRUM = (0.5, 50.0)  # Hz
_SPECTRUM_WINDOW = 2.0  # s
_MICRO = DISPLAY["m"][1]
_DEGREES = DISPLAY["rad"][1]


@dataclass(frozen=True)
class Figure:
    """One figure of the report.

    Attributes:
        title: heading.
        caption: what is shown, in a sentence.
        plot: plotly figure.
    """

    title: str
    caption: str
    plot: go.Figure


def figures(
    time: FloatArray, motion: Motion, stroke: FloatArray | None, delays: tuple[int, ...]
) -> Iterator[Figure]:
    """All figures that the given signals allow.

    Args:
        time: (n,) [s].
        motion: signals by role.
        stroke: (n, k) strokes of the actuators [m].
        delays: of the wires that carry the k voltages to the actuators [ticks].
    """
    intent = intent_of(motion)
    if motion.tip is not None and intent is not None:
        curves: dict[str, FloatArray] = {"with compensation": motion.tip}
        if motion.moved is not None:
            curves = {"without compensation": motion.moved} | curves
        yield _errors(time, motion.settle, curves, intent)
        yield _zoom(time, curves, intent)
    if motion.tip is not None and motion.moved is not None:
        spectrum = _spectra(motion.moved, motion.tip, motion)
        if spectrum is not None:
            yield spectrum
    if motion.drive is not None:
        yield _voltages(time, motion.drive)
    if motion.drive is not None and stroke is not None and stroke.shape == motion.drive.shape:
        yield _hysteresis(motion, motion.drive, stroke, delays)
    if motion.attitude_true is not None and motion.attitude_estimated is not None:
        yield _attitude(time, motion.attitude_true, motion.attitude_estimated)


def _layout(figure: go.Figure, height: int, **layout: Any) -> go.Figure:
    figure.update_layout(
        template="plotly_white",
        height=height,
        margin={"l": 64, "r": 16, "t": 36, "b": 48},
        legend={"orientation": "h", "x": 0.0, "y": 1.0, "yanchor": "bottom"},
        font={"family": "system-ui, sans-serif", "size": 13, "color": "#222222"},
        hovermode="closest",
        **layout,
    )
    figure.update_xaxes(showline=True, linecolor="#888888", ticks="outside", zeroline=False)
    figure.update_yaxes(showline=True, linecolor="#888888", ticks="outside", zeroline=False)
    return figure


def _thinned(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A curve with at most `_POINTS` points that keeps every extreme: least and largest per bin."""
    size = -(-2 * len(time) // _POINTS)
    if size <= 2:
        return time, values
    bins = len(time) // size
    block = values[: bins * size].reshape(bins, size)
    extremes = np.sort(np.stack([block.argmin(axis=1), block.argmax(axis=1)], axis=1), axis=1)
    index = (extremes + np.arange(bins)[:, None] * size).ravel()
    return time[index], values[index]


def _line(x: FloatArray, y: FloatArray, colour: str, name: str, legend: bool = True) -> go.Scatter:
    return go.Scatter(
        x=x.astype(np.float32),
        y=y.astype(np.float32),
        name=name,
        legendgroup=name,
        showlegend=legend,
        mode="lines",
        line={"color": colour, "width": 1.2},
    )


def _three_rows(x_title: str, y_title: str) -> go.Figure:
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    for row, axis in enumerate(_AXES, start=1):
        figure.update_yaxes(title_text=f"{axis}, {y_title}", row=row, col=1)
    figure.update_xaxes(title_text=x_title, row=3, col=1)
    return figure


def _colour(name: str) -> str:
    return {"without compensation": _WITHOUT, "with compensation": _WITH}.get(name, _INTENT)


def _errors(
    time: FloatArray, settle: float, curves: Mapping[str, FloatArray], intent: FloatArray
) -> Figure:
    figure = _three_rows("time, s", "µm")
    after = time >= settle
    for name, tip in curves.items():
        error = (tip - intent) * _MICRO
        error = error - error[after].mean(axis=0) if after.any() else error
        for i in range(3):
            x, y = _thinned(time, error[:, i])
            figure.add_trace(_line(x, y, _colour(name), name, legend=i == 0), row=i + 1, col=1)
    if settle > 0.0:
        figure.add_vrect(
            0.0, min(settle, time[-1]), fillcolor="#999999", opacity=0.15, line_width=0
        )
    return Figure(
        "Tip error",
        "Distance of the tip from the intent along each axis of the world, about its mean; the "
        "grey beginning is left out of the figures of merit.",
        _layout(figure, 560),
    )


def _zoom(time: FloatArray, curves: Mapping[str, FloatArray], intent: FloatArray) -> Figure:
    figure = _three_rows("time, s", "µm")
    begin = np.round(0.5 * time[-1])
    part = (time >= begin) & (time < begin + _ZOOM)
    lines = {**curves, "intent": intent}
    # Voluntary motion is ten times the tremor: without its trend one would see nothing else.
    trend = intent[part] - signal.detrend(intent[part], axis=0)
    for name, position in lines.items():
        shown = position[part] - trend
        shown = (shown - shown.mean(axis=0)) * _MICRO
        for i in range(3):
            trace = _line(time[part], shown[:, i], _colour(name), name, legend=i == 0)
            figure.add_trace(trace, row=i + 1, col=1)
    return Figure(
        "One second of it",
        "Position of the tip, the straight line that fits the intent taken out, each curve about "
        "its mean.",
        _layout(figure, 560),
    )


def _spectra(moved: FloatArray, tip: FloatArray, motion: Motion) -> Figure | None:
    first = round(motion.settle / motion.step)
    window = round(_SPECTRUM_WINDOW / motion.step)
    if len(tip) - first < window:
        return None
    figure = go.Figure()
    for name, position in (("without compensation", moved), ("with compensation", tip)):
        frequency, power = signal.welch(
            position[first:], 1 / motion.step, nperseg=window, detrend="linear", axis=0
        )
        shown = (frequency >= _SPECTRUM[0]) & (frequency <= _SPECTRUM[1])
        density = np.sqrt(power.sum(axis=1))[shown] * _MICRO
        figure.add_trace(_line(frequency[shown], density, _colour(name), name))
    low, high = TREMOR_BAND
    figure.add_vrect(low, high, fillcolor="#009e73", opacity=0.1, line_width=0)
    # Places on a logarithmic axis are given as exponents.
    figure.add_annotation(
        x=np.log10(np.sqrt(low * high)), y=1.0, yref="paper", text="tremor band", showarrow=False
    )
    ticks = [0.5, 1, 2, 5, 10, 20, 50]
    figure.update_xaxes(
        type="log", title_text="frequency, Hz", tickvals=ticks, range=np.log10(_SPECTRUM)
    )
    figure.update_yaxes(
        type="log", title_text="amplitude density, µm/√Hz", exponentformat="power", dtick=1
    )
    return Figure(
        "Spectra",
        f"Welch's estimate over the three axes together, Hann windows of {_SPECTRUM_WINDOW:g} s, "
        "linear trend removed.",
        _layout(figure, 380),
    )


def _voltages(time: FloatArray, drive: FloatArray) -> Figure:
    figure = go.Figure()
    for i, volts in enumerate(drive.T):
        x, y = _thinned(time, volts)
        figure.add_trace(_line(x, y, _SERIES[i % len(_SERIES)], f"actuator {i + 1}"))
    figure.update_xaxes(title_text="time, s")
    figure.update_yaxes(title_text="voltage, V")
    return Figure("Voltages", "Commands to the actuators.", _layout(figure, 320))


def _hysteresis(
    motion: Motion, drive: FloatArray, stroke: FloatArray, delays: tuple[int, ...]
) -> Figure:
    columns = drive.shape[1]
    figure = make_subplots(rows=1, cols=columns, shared_yaxes=True, horizontal_spacing=0.03)
    count = min(round(_LOOP_SECONDS / motion.step), len(drive) - max(delays, default=0))
    for i, delay in enumerate(delays):
        end = len(drive) - delay
        volts, made = drive[end - count : end, i], stroke[len(stroke) - count :, i] * _MICRO
        trace = _line(volts, made, _SERIES[i % len(_SERIES)], f"actuator {i + 1}")
        figure.add_trace(trace, row=1, col=i + 1)
        figure.update_xaxes(title_text="voltage, V", row=1, col=i + 1)
    figure.update_yaxes(title_text="stroke, µm", row=1, col=1)
    return Figure(
        "Hysteresis",
        f"Stroke over the voltage that acts on it, last {count * motion.step:g} s.",
        _layout(figure, 380),
    )


def _attitude(time: FloatArray, true: FloatArray, estimated: FloatArray) -> Figure:
    figure = go.Figure()
    x, y = _thinned(time, angle_between(true, estimated) * _DEGREES)
    figure.add_trace(_line(x, y, _WITH, "attitude error"))
    figure.update_xaxes(title_text="time, s")
    figure.update_yaxes(title_text="angle, deg", rangemode="tozero")
    return Figure(
        "Attitude error",
        "Angle of the rotation from the true to the estimated attitude.",
        _layout(figure, 300, showlegend=False),
    )
