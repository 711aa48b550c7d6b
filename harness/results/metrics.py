"""Figures of merit of a run, each with its definition in words.

    x   where the tip would be without compensation     (n, 3) [m] in W
    y   where it is                                     (n, 3) [m] in W
    v   where the hand wants it: the intent             (n, 3) [m] in W
    bp  zero-phase band-pass 6 to 16 Hz: butter(4, band-pass), eight poles, forwards and backwards
    lp  zero-phase low-pass at 6 Hz: butter(4), forwards and backwards
    t   zero-phase band-pass 6 to 15 Hz of x: butter(2, band-pass), forwards and backwards

Errors y - v and x - v are taken about their mean over time: the manipulator rests at half its
stroke, so that y has a constant offset from x, with which the surgeon aims.

In band, what counts is how much of the band is left; a-posteriori, how close the tip is to the
intent. Each can be gamed alone, so both are always given, over all axes together and as the mean of
the axes. Filters see the whole record; figures are of the samples after `warm_up`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from harness.common.endpoint import Endpoint
from harness.common.types import FloatArray
from harness.scenario.schema import SHORTEST_EVALUATION

if TYPE_CHECKING:
    from harness.results.signals import RecordedSignals

__all__ = [
    "LEAST_MOTION",
    "TREMOR_BAND",
    "Metric",
    "MetricInputs",
    "angle_between",
    "intent_of",
    "metric_inputs_of",
    "metrics_of",
    "metrics_of_result",
    "rotation_between",
]

TREMOR_BAND = (6.0, 16.0)
"""Band of the in-band figures [Hz]."""
LEAST_MOTION = 1e-8
"""Motion that can be reduced [m] rms; there are no per cent of less."""
_LEAST_AXIS = 0.01  # of the rms of the axis that moves most
_TARGET_BAND = (6.0, 15.0)
_INTENT_CORNER = 6.0
_BAND_ORDER, _TARGET_ORDER, _INTENT_ORDER = 4, 2, 4
_PADDING = 1.0  # s of odd extension at both ends, longer than the filters ring


@dataclass(frozen=True)
class Metric:
    """One figure.

    Attributes:
        value: in `unit`.
        unit: SI, `%`, or `1`.
        definition: what was computed, in words.
    """

    value: float
    unit: str
    definition: str


@dataclass(frozen=True)
class MetricInputs:
    """What the metrics are computed from; anything but the time base may be missing.

    Attributes:
        step: sample period [s].
        warm_up: left out at the start [s].
        ticks: samples of the run, where `wall` is given.
        wall: wall-clock time that they took [s].
        tip_uncompensated: x, (n, 3) [m].
        tip: y, (n, 3) [m].
        intent: v, (n, 3) [m]; None: obtained from x by `lp`.
        actuator_voltage: voltages, (n, k) [V].
        attitude_true: q_WB, (n, 4), scalar first.
        attitude_estimated: q_WB, (n, 4), scalar first.
        position_true: in W, (n, 3) [m].
        position_estimated: in W, (n, 3) [m].
        saturated: (n,) or (n, 1), not 0 while a command is at its limit.
    """

    step: float
    warm_up: float = 0.0
    ticks: int = 0
    wall: float | None = None
    tip_uncompensated: FloatArray | None = None
    tip: FloatArray | None = None
    intent: FloatArray | None = None
    actuator_voltage: FloatArray | None = None
    attitude_true: FloatArray | None = None
    attitude_estimated: FloatArray | None = None
    position_true: FloatArray | None = None
    position_estimated: FloatArray | None = None
    saturated: FloatArray | None = None


def metrics_of_result(result: RecordedSignals) -> dict[str, Metric]:
    """Metrics of a recorded run; see `metrics_of`."""
    return metrics_of(metric_inputs_of(result))


def metric_inputs_of(result: RecordedSignals) -> MetricInputs:
    """Signals of a run by their roles.

    While a recording moves the part that gives the intent, that part does not know the intent.
    """
    metadata = result.metadata
    intent = (Endpoint.find(name, metadata.parts) for name in metadata.roles.get("intent", []))
    replayed = any(endpoint and endpoint.part in metadata.motions for endpoint in intent)
    return MetricInputs(
        step=metadata.step_size,
        warm_up=metadata.warm_up,
        ticks=len(result.time),
        wall=metadata.wall,
        tip_uncompensated=result.role("tip_uncompensated"),
        tip=result.role("tip"),
        intent=None if replayed else result.role("intent"),
        actuator_voltage=result.role("actuator_voltage"),
        attitude_true=result.role("attitude_true"),
        attitude_estimated=result.role("attitude_estimated"),
        position_true=result.role("position_true"),
        position_estimated=result.role("position_estimated"),
        saturated=result.role("saturated"),
    )


def metrics_of(inputs: MetricInputs) -> dict[str, Metric]:
    """Compute all figures that the given signals allow, by name.

    A figure is left out where a signal is missing, the record after `warm_up` is shorter than a
    second, or there is no tremor to be reduced; a mean over axes also where an axis has none.
    """
    truths = (inputs.attitude_true, inputs.position_true)
    signals = (
        inputs.tip,
        inputs.tip_uncompensated,
        inputs.actuator_voltage,
        *truths,
        inputs.saturated,
    )
    samples = max((len(s) for s in signals if s is not None), default=0)
    first = round(inputs.warm_up / inputs.step)
    metrics: dict[str, Metric] = {}
    if (samples - first) * inputs.step >= SHORTEST_EVALUATION:
        after = slice(first, None)
        metrics |= _tip(inputs, after)
        metrics |= _drive(inputs, after)
        metrics |= _pose(inputs, after)
    return metrics | dict(_speed(inputs))


def intent_of(inputs: MetricInputs) -> FloatArray | None:
    """v, (n, 3) [m]: given, or lp(x); None without either."""
    if inputs.intent is not None:
        return inputs.intent
    if inputs.tip_uncompensated is None:
        return None
    lowpass = _filter(_INTENT_ORDER, _INTENT_CORNER, "lowpass", inputs.step)
    return _zero_phase(lowpass, inputs.tip_uncompensated, inputs.step)


def angle_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n,) angle of the rotation between unit quaternions, (n, 4), scalar first [rad]."""
    return np.asarray(np.linalg.norm(rotation_between(a, b), axis=1))


def rotation_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n, 3) shortest rotation vector from a to b, unit quaternions (n, 4), in the body of a [rad].

    b = a (x) exp(theta / 2), scalar first.
    """
    scalar = np.sum(a * b, axis=1)
    vector = a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - np.cross(a[:, 1:], b[:, 1:])
    length = np.linalg.norm(vector, axis=1)
    # Near 0, arctan2 keeps the digits that arccos would lose.
    angle = 2.0 * np.arctan2(length, np.abs(scalar))
    along = np.where(scalar < 0.0, -angle, angle) / np.where(length > 0.0, length, 1.0)
    return np.asarray(along[:, np.newaxis] * vector)


def _band_pass(order: int, band: tuple[float, float], x: FloatArray, step: float) -> FloatArray:
    return _zero_phase(_filter(order, band, "bandpass", step), x, step)


@cache
def _filter(order: int, corners: float | tuple[float, float], kind: str, step: float) -> FloatArray:
    """Second-order sections of a Butterworth filter; a sweep designs them once."""
    return np.asarray(signal.butter(order, corners, btype=kind, fs=1 / step, output="sos"))


def _zero_phase(sos: FloatArray, x: FloatArray, step: float) -> FloatArray:
    padding = min(round(_PADDING / step), len(x) - 1)
    return np.asarray(signal.sosfiltfilt(sos, x, axis=0, padlen=padding))


def _rms(x: FloatArray) -> float:
    """Root of the mean square of the vectors' lengths."""
    return float(np.sqrt(np.mean(np.sum(np.square(x), axis=1))))


def _about_mean(x: FloatArray) -> FloatArray:
    return np.asarray(x - x.mean(axis=0))


def _reduction(left: FloatArray, before: FloatArray) -> float | None:
    whole = _rms(before)
    return 100.0 * (1.0 - _rms(left) / whole) if whole > LEAST_MOTION else None


def _reduction_by_axis(left: FloatArray, before: FloatArray) -> float | None:
    spread = before.std(axis=0)
    # Per cent of an axis that hardly moves would outweigh the others without meaning anything.
    if spread.min() < max(LEAST_MOTION, _LEAST_AXIS * spread.max()):
        return None
    return float(np.mean(100.0 * (1.0 - left.std(axis=0) / spread)))


def _tip(inputs: MetricInputs, after: slice) -> Iterator[tuple[str, Metric]]:
    x, y, v = inputs.tip_uncompensated, inputs.tip, intent_of(inputs)
    low, high = TREMOR_BAND
    band = (
        f"the zero-phase {low:g} to {high:g} Hz Butterworth band-pass "
        f"(butter({_BAND_ORDER}, band-pass), forwards and backwards)"
    )
    source = (
        "v the intent that the hand's generator states"
        if inputs.intent is not None
        else f"v the intent, obtained off line from x by a zero-phase Butterworth low-pass "
        f"(butter({_INTENT_ORDER}), {_INTENT_CORNER:g} Hz, forwards and backwards)"
    )
    if x is not None and y is not None and v is not None:
        bx = _band_pass(_BAND_ORDER, TREMOR_BAND, x, inputs.step)[after]
        by = _band_pass(_BAND_ORDER, TREMOR_BAND, y, inputs.step)[after]
        target = _band_pass(_TARGET_ORDER, _TARGET_BAND, x, inputs.step)[after]
        xy = "x the tip without and y the tip with compensation, rms over time and all three axes"
        reductions = {
            "reduction_in_band": (
                _reduction(by, bx),
                f"100 (1 - rms(bp(y)) / rms(bp(x))): {xy}, bp {band}",
            ),
            "reduction_a_posteriori": (
                _reduction(_about_mean((y - v)[after]), _about_mean((x - v)[after])),
                f"100 (1 - rms(y - v) / rms(x - v)), both about their means: {xy}, {source}",
            ),
            "reduction_in_band_axes": (
                _reduction_by_axis(by, bx),
                "as reduction_in_band, but the mean over the axes of 100 (1 - std(bp(y)) / "
                "std(bp(x)))",
            ),
            "reduction_a_posteriori_axes": (
                _reduction_by_axis(target - (x - y)[after], target),
                "mean over the axes of 100 (1 - std(t - (x - y)) / std(t)), t the zero-phase "
                f"{_TARGET_BAND[0]:g} to {_TARGET_BAND[1]:g} Hz band-pass of x "
                f"(butter({_TARGET_ORDER}, band-pass), forwards and backwards)",
            ),
        }
        for name, (value, text) in reductions.items():
            if value is not None:
                yield name, Metric(value, "%", text)
    if y is not None and v is not None:
        error = _about_mean((y - v)[after])
        yield (
            "tip_rms",
            Metric(_rms(error), "m", f"rms of y - v about its mean: y the tip, {source}"),
        )
        yield (
            "worst_excursion",
            Metric(
                float(np.linalg.norm(error, axis=1).max()),
                "m",
                "largest |y - v|, y - v about its mean",
            ),
        )
    if x is not None and v is not None:
        error = _about_mean((x - v)[after])
        yield (
            "tip_rms_uncompensated",
            Metric(
                _rms(error),
                "m",
                f"rms of x - v about its mean: x the tip without compensation, {source}",
            ),
        )


def _drive(inputs: MetricInputs, after: slice) -> Iterator[tuple[str, Metric]]:
    if inputs.actuator_voltage is not None:
        volts = inputs.actuator_voltage[after]
        about = volts - volts.mean(axis=0)
        yield (
            "drive_rms",
            Metric(
                float(np.sqrt(np.mean(about**2))),
                "V",
                "rms of the voltages about their means, over time and all actuators",
            ),
        )
        rate = np.diff(volts, axis=0) / inputs.step
        yield (
            "drive_rate",
            Metric(
                float(np.sqrt(np.mean(rate**2))),
                "V/s",
                "rms of the voltages' change from sample to sample, over the sample period",
            ),
        )
    if inputs.saturated is not None:
        share = float(np.mean(inputs.saturated[after] != 0.0))
        yield (
            "saturated",
            Metric(100.0 * share, "%", "share of samples with a command at its limit"),
        )


def _pose(inputs: MetricInputs, after: slice) -> Iterator[tuple[str, Metric]]:
    """Errors of an estimated attitude and position."""
    if inputs.attitude_true is not None and inputs.attitude_estimated is not None:
        angle = angle_between(inputs.attitude_true[after], inputs.attitude_estimated[after])
        text = "angle of the rotation from the true to the estimated attitude"
        yield from _error("attitude_error", angle, "rad", text)
    if inputs.position_true is not None and inputs.position_estimated is not None:
        apart = inputs.position_estimated[after] - inputs.position_true[after]
        distance = np.linalg.norm(apart, axis=1)
        yield from _error("position_error", distance, "m", "distance of the estimated position")


def _error(name: str, size: FloatArray, unit: str, text: str) -> Iterator[tuple[str, Metric]]:
    yield f"{name}_rms", Metric(float(np.sqrt(np.mean(size**2))), unit, f"rms of the {text}")
    yield f"{name}_max", Metric(float(size.max()), unit, f"largest {text}")


def _speed(inputs: MetricInputs) -> Iterator[tuple[str, Metric]]:
    if inputs.wall:
        yield (
            "real_time_factor",
            Metric(
                inputs.ticks * inputs.step / inputs.wall,
                "1",
                "simulated time over wall-clock time of the loop, recording included, without "
                "start, metrics and report",
            ),
        )
