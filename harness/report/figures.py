"""Figures of the report. Everything in display units: µm, V, deg, s, Hz."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy import signal

from harness.common.quantities import DISPLAY
from harness.common.types import FloatArray
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, chart, components, grid, layout, line, thinned
from harness.results.metrics import TREMOR_BAND, MetricInputs, angle_between, intent_of

__all__ = ["SPECTRUM_WINDOW", "amplitude_density", "colour", "figures", "three_rows"]

_AXES = "xyz"
_WITH, _WITHOUT, _BAND = SERIES[:3]
_INTENT = GREY
_ZOOM = 1.0  # s
_LOOP_SECONDS = 4.0
_SPECTRUM = (0.5, 50.0)  # Hz
SPECTRUM_WINDOW = 2.0  # s
_ATTENUATION = (0.5, 20.0)  # Hz
_LEAST_LOOKS = 4
_LARGEST_ERROR = 0.2
_MICRO = DISPLAY["m"][1]
_DEGREES = DISPLAY["rad"][1]


def figures(
    time: FloatArray, inputs: MetricInputs, stroke: FloatArray | None, delays: tuple[int, ...]
) -> Iterator[Plot]:
    """Yield all figures that the given signals allow.

    Args:
        time: (n,) [s].
        inputs: signals by role.
        stroke: (n, k) strokes of the actuators [m].
        delays: of the wires that carry the k voltages to the actuators [ticks].
    """
    intent = intent_of(inputs)
    if inputs.tip is not None and intent is not None:
        curves: dict[str, FloatArray] = {"with compensation": inputs.tip}
        if inputs.tip_uncompensated is not None:
            curves = {"without compensation": inputs.tip_uncompensated} | curves
        yield _errors(time, inputs.warm_up, curves, intent)
        yield _zoom(time, curves, intent)
    if inputs.tip is not None and inputs.tip_uncompensated is not None:
        spectrum = _spectra(inputs.tip_uncompensated, inputs.tip, inputs)
        if spectrum is not None:
            yield spectrum
        attenuation = _attenuation(inputs.tip_uncompensated, inputs.tip, inputs)
        if attenuation is not None:
            yield attenuation
    if inputs.actuator_voltage is not None:
        yield _voltages(time, inputs.actuator_voltage)
    if (
        inputs.actuator_voltage is not None
        and stroke is not None
        and stroke.shape == inputs.actuator_voltage.shape
    ):
        yield _hysteresis(inputs, inputs.actuator_voltage, stroke, delays)
    if inputs.attitude_true is not None and inputs.attitude_estimated is not None:
        angle = angle_between(inputs.attitude_true, inputs.attitude_estimated) * _DEGREES
        text = "Angle of the rotation from the true to the estimated attitude"
        yield _estimated(time, inputs.warm_up, angle, ("Attitude error", "angle, deg", text))
    if inputs.position_true is not None and inputs.position_estimated is not None:
        difference = inputs.position_estimated - inputs.position_true
        distance = np.linalg.norm(difference, axis=1) * _MICRO
        text = "Distance of the estimated position from the true one"
        yield _estimated(time, inputs.warm_up, distance, ("Position error", "distance, µm", text))


def three_rows(x_title: str, y_title: str) -> go.Figure:
    """Return axes x, y and z one below the other, empty."""
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    for row, axis in enumerate(_AXES, start=1):
        figure.update_yaxes(title_text=f"{axis}, {y_title}", row=row, col=1)
    figure.update_xaxes(title_text=x_title, row=3, col=1)
    return figure


def colour(name: str) -> str:
    """Return the colour of a curve by its name."""
    return {"without compensation": _WITHOUT, "with compensation": _WITH}.get(name, _INTENT)


def _three_axes(time: FloatArray, curves: Mapping[str, FloatArray]) -> go.Figure:
    """Return a figure of vectors (n, 3) [µm] by name."""
    drawn = ((name, colour(name), time, vectors) for name, vectors in curves.items())
    return components(drawn, [f"{axis}, µm" for axis in _AXES], 560)


def _errors(
    time: FloatArray, warm_up: float, curves: Mapping[str, FloatArray], intent: FloatArray
) -> Plot:
    after = time >= warm_up if (time >= warm_up).any() else slice(None)
    errors = {name: (tip - intent) * _MICRO for name, tip in curves.items()}
    figure = _three_axes(
        time, {name: error - error[after].mean(axis=0) for name, error in errors.items()}
    )
    if warm_up > 0.0:
        figure.add_vrect(
            0.0, min(warm_up, time[-1]), fillcolor="#999999", opacity=0.15, line_width=0
        )
    return Plot(
        "Tip error",
        "Distance of the tip from the intent along each axis of the world, about its mean; the "
        "grey beginning is left out of the figures of merit.",
        figure,
    )


def _zoom(time: FloatArray, curves: Mapping[str, FloatArray], intent: FloatArray) -> Plot:
    begin = np.round(0.5 * time[-1])
    part = (time >= begin) & (time < begin + _ZOOM)
    # Voluntary motion is ten times the tremor: without its trend one would see nothing else.
    trend = intent[part] - signal.detrend(intent[part], axis=0)
    shown = {name: values[part] - trend for name, values in {**curves, "intent": intent}.items()}
    figure = _three_axes(
        time[part],
        {name: (values - values.mean(axis=0)) * _MICRO for name, values in shown.items()},
    )
    return Plot(
        "One second of it",
        "Position of the tip, the straight line that fits the intent taken out, each curve about "
        "its mean.",
        figure,
    )


def _spectra(moved: FloatArray, tip: FloatArray, inputs: MetricInputs) -> Plot | None:
    first = round(inputs.warm_up / inputs.step)
    window = round(SPECTRUM_WINDOW / inputs.step)
    if len(tip) - first < window:
        return None
    figure = go.Figure()
    for name, position in (("without compensation", moved), ("with compensation", tip)):
        frequency, density = amplitude_density(position[first:], inputs.step)
        shown = (frequency >= _SPECTRUM[0]) & (frequency <= _SPECTRUM[1])
        figure.add_trace(line(frequency[shown], density[shown] * _MICRO, colour(name), name))
    low, high = TREMOR_BAND
    figure.add_vrect(low, high, fillcolor=_BAND, opacity=0.1, line_width=0)
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
    return Plot(
        "Spectra",
        f"Welch's estimate over the three axes together, Hann windows of {SPECTRUM_WINDOW:g} s, "
        "linear trend removed.",
        layout(figure, 380),
    )


def amplitude_density(x: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Estimate by Welch over all columns together: Hann windows, linear trend removed.

    Args:
        x: (n, k), longer than `SPECTRUM_WINDOW`.
        step: sample period [s].

    Returns:
        Frequencies [Hz], and the root of the spectral density [unit of x per root Hz].
    """
    frequency, power = signal.welch(
        x, 1 / step, nperseg=round(SPECTRUM_WINDOW / step), detrend="linear", axis=0
    )
    return frequency, np.sqrt(power.sum(axis=1))


def _attenuation(moved: FloatArray, tip: FloatArray, inputs: MetricInputs) -> Plot | None:
    """Plot what is left of the motion, and the phase of the correction, as recorded."""
    first = round(inputs.warm_up / inputs.step)
    window = round(SPECTRUM_WINDOW / inputs.step)
    # Half overlapped Hann windows; two of them are hardly more than one independent estimate.
    looks = (len(tip) - first) // window
    if looks < _LEAST_LOOKS:
        return None
    how: dict[str, Any] = {"fs": 1 / inputs.step, "nperseg": window, "detrend": "linear", "axis": 0}
    x, correction = moved[first:], (tip - moved)[first:]
    frequency, power = signal.welch(x, **how)
    made = signal.welch(correction, **how)[1].sum(axis=1)
    cross = signal.csd(x, correction, **how)[1].sum(axis=1)
    total = np.maximum(power.sum(axis=1), np.finfo(float).tiny)
    response = cross / total
    error = np.sqrt(np.maximum(made / total - np.abs(response) ** 2, 0.0) / (2 * looks))
    known = (frequency >= _ATTENUATION[0]) & (frequency <= _ATTENUATION[1])
    left = np.where(error > _LARGEST_ERROR, np.nan, np.abs(1.0 + response))[known]
    faint = np.abs(response) < 2.0 * np.maximum(error, _LARGEST_ERROR / 4)
    phase = np.where(faint, np.nan, np.degrees(np.angle(-response)))[known]
    panels = (
        [[line(frequency[known], left, _WITH, "tip by hand")]],
        [[line(frequency[known], phase, _WITHOUT, "phase of the correction")]],
    )
    figure = grid(panels, "frequency, Hz", ["tip by hand", "phase, deg"], 460)
    figure.add_hline(1.0, line={"color": _INTENT, "width": 0.8, "dash": "dot"}, row=1, col=1)
    figure.add_vrect(*TREMOR_BAND, fillcolor=_BAND, opacity=0.1, line_width=0)
    figure.update_yaxes(rangemode="tozero", row=1, col=1)
    figure.update_xaxes(range=[0, _ATTENUATION[1]])
    return Plot(
        "Attenuation",
        "What is left of the motion, and by what angle the correction leads it (negative: lags): "
        f"cross spectra of the record, three axes together, Hann windows of {SPECTRUM_WINDOW:g} "
        "s. Left out: where the hand moves too little for a standard error of "
        f"{_LARGEST_ERROR:g}, and phases of what is hardly a correction. 'steadytip analyze' tells "
        "which part costs what.",
        figure,
    )


def _voltages(time: FloatArray, drive: FloatArray) -> Plot:
    curves = [
        line(*thinned(time, volts), SERIES[i % len(SERIES)], f"actuator {i + 1}")
        for i, volts in enumerate(drive.T)
    ]
    figure = chart(curves, "time, s", "voltage, V", 320)
    return Plot("Voltages", "Commands to the actuators.", figure)


def _hysteresis(
    inputs: MetricInputs, drive: FloatArray, stroke: FloatArray, delays: tuple[int, ...]
) -> Plot:
    count = min(round(_LOOP_SECONDS / inputs.step), len(drive) - max(delays, default=0))
    panels = []
    for i, delay in enumerate(delays):
        end = len(drive) - delay
        volts, made = drive[end - count : end, i], stroke[len(stroke) - count :, i] * _MICRO
        panels.append([line(volts, made, SERIES[i % len(SERIES)], f"actuator {i + 1}")])
    figure = grid(
        [panels], "voltage, V", ["stroke, µm"], 380, shared_yaxes=True, horizontal_spacing=0.03
    )
    return Plot(
        "Hysteresis",
        f"Stroke over the voltage that acts on it, last {count * inputs.step:g} s.",
        figure,
    )


def _estimated(
    time: FloatArray, warm_up: float, size: FloatArray, texts: tuple[str, str, str]
) -> Plot:
    """Plot the error of an estimate, scaled to what counts: a start may lie far above."""
    title, unit, text = texts
    curve = line(*thinned(time, size), _WITH, title.lower())
    figure = chart([curve], "time, s", unit, 300, showlegend=False)
    counted = size[time >= warm_up] if warm_up < time[-1] else size
    top = 1.1 * float(counted.max())
    figure.update_yaxes(range=[0.0, top] if top > 0.0 else None)
    beyond = f"; more than shown before {warm_up:g} s" if size.max() > max(top, 0.0) > 0.0 else ""
    return Plot(title, f"{text}{beyond}.", figure)
