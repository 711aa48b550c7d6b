"""The raw unit motionless for hours, as A04 3.3 records it.

The unit is scenario `raw_unit` with the noise that A04 table 2.3 has. At 1 Hz the plant is the same
model with a sample period of 1 s, which it solves exactly: its samples are those that a converter
takes once in a second, unaveraged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import plotly.graph_objects as go

from fmu_src.device import design
from fmu_src.kit.runner import Runner
from fmu_src.pack.compiled_runner import CompiledRunner
from harness.common.types import FloatArray
from harness.identify.allan.fit import Noise, analyse
from harness.identify.allan.page import curves
from harness.identify.imu import turntable
from harness.reproduce.experiments.tilt import SCENARIO
from plants import inertial_sensors

__all__ = [
    "HOUR",
    "NOISE",
    "RATE",
    "MotionlessRecording",
    "channels_with",
    "means",
    "motionless",
    "noises",
    "plot_deviation",
    "slopes",
    "steady",
]

HOUR = 3600.0
NOISE = 4.535e-3
"""2.25 mg rms behind the output filter, as in scenario `closed_loop_a04_noise` [m/s2/Hz0.5]."""
SETTLED = 0.05
"""Share of the whole drift within which it counts as steady."""
MEANS = 1800.0
"""Of the black circles of figure 3.14 [s]."""
RATE = 1 / inertial_sensors.MODEL.sample_period
"""Of the converter [Hz]."""
_BLOCK = 100_000  # samples at once: their draws take memory
_ATTITUDE = (0.3, 0.4)  # rad, roll and pitch: no axis level, none upright


@dataclass(frozen=True)
class MotionlessRecording:
    """A recording of the six accelerometers.

    Attributes:
        time: (n,) [s].
        force: by the nominal scale, (n, 6) [m/s2].
        period: of the samples [s].
    """

    time: FloatArray
    force: FloatArray
    period: float

    def noise(self, channel: int, begin: float = 0.0) -> Noise:
        """Return noise of one channel from a time on."""
        return analyse(self.force[self.time >= begin, channel], self.period, design.SENSOR_LAG)


@cache
def motionless(
    seconds: float,
    rate: float,
    powered: float,
    seed: int,
    progress: Callable[[float], None] = lambda share: None,
) -> MotionlessRecording:
    """Record.

    Args:
        seconds: how long.
        rate: samples in a second [Hz].
        powered: time that the unit has been on before [s].
        seed: of the noise.
        progress: called with the share that is done.
    """
    settings = dict(turntable.sensors(SCENARIO, "sensors"))
    del settings["fmu"]
    settings |= {"accelerometer_noise": NOISE, "powered": powered, "seed": seed}
    roll, pitch = _ATTITUDE
    up = [-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)]
    force = design.SITE_GRAVITY * np.array(up)
    inputs = {"force1": force, "force2": force, "force3": force, "field": [2e-5, 0.0, -4e-5]}
    n, parts = round(seconds * rate), []
    make = CompiledRunner if n > _BLOCK else Runner  # compiling takes longer than a short run
    runner = make(replace(inertial_sensors.MODEL, sample_period=1 / rate), settings)
    for begin in range(0, n, _BLOCK):
        parts.append(runner.run(min(_BLOCK, n - begin), inputs)["volts"][:, :6])
        progress(min(begin + _BLOCK, n) / n)
    volts = np.concatenate(parts)
    return MotionlessRecording(
        np.arange(n) / rate,
        (volts - design.ZERO_VOLTS) / design.ACCELEROMETER_SCALE,
        1 / rate,
    )


def means(rest: MotionlessRecording, channel: int) -> tuple[FloatArray, FloatArray]:
    """Return means of half hours: their middles [s], and values [m/s2]."""
    count = round(MEANS / rest.period)
    n = len(rest.time) // count
    values = rest.force[: n * count, channel].reshape(n, count).mean(axis=1)
    return np.asarray((np.arange(n) + 0.5) * MEANS, dtype=float), values


def steady(rest: MotionlessRecording, channel: int) -> float:
    """Return when the means of half hours have come to stay near the last ones [s]."""
    time, values = means(rest, channel)
    last = values[-4:].mean()
    away = np.abs(values - last) > SETTLED * np.ptp(values)
    return float(time[np.flatnonzero(away)[-1]] + MEANS / 2) if away.any() else 0.0


def slopes(noise: Noise, low: float, high: float) -> FloatArray:
    """Return slopes of a root Allan variance by octave, between two averaging times [s]."""
    curve = noise.curve
    rises = np.diff(np.log(curve.deviation)) / np.diff(np.log(curve.tau))
    middle = np.sqrt(curve.tau[1:] * curve.tau[:-1])
    return np.asarray(rises[(middle >= low) & (middle <= high)])


def channels_with(noises: Mapping[str, Noise], term: str) -> int:
    """Return in how many channels a term shows."""
    return sum(term in noise.terms for noise in noises.values())


def noises(rest: MotionlessRecording, begin: float = 0.0) -> dict[str, Noise]:
    """Return noise of all six channels from a time on."""
    return {name: rest.noise(i, begin) for i, name in enumerate(inertial_sensors.ACCELEROMETERS)}


def plot_deviation(noises: Mapping[str, Noise]) -> go.Figure:
    """Plot the root Allan variance of all channels."""
    return curves([(name, noise, 1.0) for name, noise in noises.items()], "m/s²")
