"""A04 figure 4.3: tremor-like motion felt at 45 deg, by the linear and the physical model."""

import numpy as np
from scipy.signal import bilinear, lfilter

from fmu_src.device import design
from fmu_src.estimation.micron.model import MODEL
from fmu_src.kit.runner import Runner
from harness.identify.imu import turntable
from harness.report.page import Plot
from harness.report.plots import GREY, SERIES, chart, line
from harness.reproduce.experiments import tilt
from harness.reproduce.item import Context, Item, ItemResult, Row, figures_of
from plants import inertial_sensors

SOURCE = "A04 figure 4.3"
AMPLITUDE, FREQUENCY = 30e-6, 10.0
"""60 um p-p [m], [Hz]."""
SECONDS, SETTLE = 4.0, 1.0
ALPHA, BETA = 45.0, 90.0
"""Of the turntable [deg]."""
NOISE = 4.535e-3
"""2.25 mg rms behind the output filter, as in scenario `closed_loop_a04_noise` [m/s2/Hz0.5]."""
PAPER = {"linear": 299.8, "physical": 20.8}
"""Rms error [mm/s2]."""
_MILLI = 1e3


def run(context: Context) -> ItemResult:
    """Shake the raw unit at 45 deg; compare site 1's x channel with the motion."""
    context.progress(0.0, "calibrating")
    models = tilt.identified()
    context.progress(0.8, "shaking")
    T = inertial_sensors.MODEL.sample_period
    t = (np.arange(round(SECONDS / T)) * T).astype(np.float64)
    pushed = -AMPLITUDE * (2 * np.pi * FREQUENCY) ** 2 * np.sin(2 * np.pi * FREQUENCY * t)
    angles = np.radians([ALPHA]), np.radians([BETA])
    gravity = design.SITE_GRAVITY * turntable.up(*angles)[0]
    force = gravity + np.outer(pushed, [1.0, 0.0, 0.0])
    settings = dict(turntable.sensors(tilt.SCENARIO, "sensors"))
    del settings["fmu"]
    sensors = Runner(inertial_sensors.MODEL, {**settings, "accelerometer_noise": NOISE, "seed": 3})
    inputs = {"force1": force, "force2": force, "force3": force, "field": [2e-5, 0.0, -4e-5]}
    sensed = sensors.run(len(t), inputs)
    # The interferometer's acceleration behind the same filter, instead of the output ahead of it.
    lag = design.SENSOR_LAG
    felt = lfilter(*bilinear([1.0], [lag, 1.0], 1 / T), pushed)
    kept = t >= SETTLE
    setting = (
        f"simulated; alpha {ALPHA:g}, beta {BETA:g} deg, {2e6 * AMPLITUDE:g} um p-p at "
        f"{FREQUENCY:g} Hz, noise of the thesis"
    )
    shown = kept & (t < SETTLE + 0.4)
    curves = [line(t[shown], felt[shown] * _MILLI, GREY, "motion", dash="dot")]
    rows: list[Row] = []
    for (name, paper), colour in zip(PAPER.items(), SERIES, strict=False):
        read = {"volts": sensed["volts"], "temperature": sensed["temperature"]}
        out = Runner(MODEL, models[name]).run(len(t), read)["force"][:, 0] - gravity[0]
        rms = np.sqrt(np.mean((out - felt)[kept] ** 2)) * _MILLI
        rows.append((f"rms error of acceleration, {name} model", "mm/s2", paper, rms))
        curves.append(line(t[shown], out[shown] * _MILLI, colour, f"{name} model"))
    noise = float(np.pi / 2 / (2 * np.pi * lag)) ** 0.5 * NOISE * _MILLI
    rows.append(("noise alone behind the filter", "mm/s2", None, noise))
    return ItemResult(
        figures=tuple(figures_of(SOURCE, setting, rows)),
        plots=(
            Plot(
                "Acceleration at 45 deg",
                "Channel a1x by either model, and the motion behind the same output filter.",
                chart(curves, "time, s", "acceleration along x, mm/s²"),
            ),
        ),
        notes=(
            "Simulated: the unit of `raw_unit`, calibrated as in table 4.1. What the linear model "
            "leaves is a shift of the bias; what the physical one leaves is the noise "
            "and 2 or 3 mg of bias, since the unit's cross-axis forms are no parabolas and have "
            "loops.",
        ),
    )


ITEM = Item(
    name="figure-4.3",
    source=SOURCE,
    title="Tremor-like motion at an inclination, by both models",
    group="sensing",
    run=run,
)
