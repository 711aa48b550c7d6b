"""Demands of A04 7.4, and what a stack behind an inverse operator makes of them.

A tracker is an operator identified from recordings of the stack alone, with its inverse. The
voltage at an instant is computed from demands up to it, held for a sample of 1 kHz, and what comes
of it is compared with the demand at the sample's end. A demand is ahead of nothing: only the
horizon of one sample, for the hold, is given to the inverse.

Before a demand the stack is driven through its range twice and led to the demand's beginning; that,
and 0.3 s more, does not count. Demands lie in the middle of what the operator can reach.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from fmu_src.device import design
from fmu_src.kit.model import Model
from fmu_src.pack.compiled_runner import CompiledRunner
from fmu_src.piezo import (
    inverse_modulated_stops,
    inverse_prandtl_ishlinskii,
    inverse_rate_dependent,
    modulated_stops,
    prandtl_ishlinskii,
    rate_dependent,
)
from harness.identify.hysteresis import plays as hysteresis
from harness.identify.hysteresis.modulated_stops import StopsFit, excitation, identify_stops
from harness.recordings.motion import read_recording
from harness.reproduce.experiments.stack import (
    ATTEMPTS,
    FINE_RATE,
    FIRST_TOP,
    RATE,
    TRAVEL,
    Stack,
    off_line,
    read,
    respond,
    sine,
)
from plants import displacement_sensor, piezo_stack

FREQUENCIES = (1.0, 4.0, 7.0, 10.0, 13.0, 16.0, 19.0)
"""Of the stationary sines (A04 table 7.1) [Hz]."""
SECONDS = 5.0
"""Of a demand (A04 7.4)."""
PROFILES = 7
"""Non-stationary demands that are averaged over (A04 table 7.2)."""
TREMOR_BAND = (6.0, 16.0)
"""Of a recorded hand that is tracked [Hz]."""
SWEEP = (*(k / 2 for k in range(1, 10)), *map(float, range(5, 41)))
"""Saw-teeth of the identification [Hz]: A04's down to 0.1 Hz creep more than the operator knows."""
EXERCISE, WAY, QUIET = 800, 200, 300
"""Samples of exercise, of the way to the demand, and of the demand that do not count."""
SEEDS = {"sine": 71, "sweep": 72, "excitation": 1}
"""Of the sensor's noise in recordings for identification."""


def tone(frequency: float) -> np.ndarray:
    """Return a sine from its lowest point on, any size."""
    return -np.cos(2 * np.pi * frequency * np.arange(round(SECONDS * RATE)) / RATE)


def profile(number: int = 0) -> np.ndarray:
    """Return 1, 10 and 19 Hz together, each swelling and fading (A04 table 7.2), any size.

    Args:
        number: of the choice of phases.
    """
    t = np.arange(round(SECONDS * RATE)) / RATE
    phases = 2 * np.pi * np.random.default_rng(number).uniform(size=3) if number else (0, 1, 2)
    tones = ((1, 1.0, 0.3), (10, 0.6, 0.23), (19, 0.35, 0.41))
    parts = [
        weight * (0.6 + 0.4 * np.sin(2 * np.pi * pace * t + phase)) * np.sin(2 * np.pi * f * t)
        for (f, weight, pace), phase in zip(tones, phases, strict=True)
    ]
    return np.sum(parts, axis=0)


def tremor(path: Path) -> np.ndarray:
    """Return 5 s of tremor of a recorded hand along x, from 4 s on, at 1 kHz, any size.

    The band-pass is what makes it a demand of tremor; the tracker sees it sample by sample.

    Args:
        path: recording.
    """
    recording = read_recording(path)
    rate = (len(recording.time) - 1) / recording.time[-1]
    band = butter(2, TREMOR_BAND, "bandpass", fs=rate, output="sos")
    moved = sosfiltfilt(band, recording.position[:, 0])
    first = round(4.0 * rate)
    part = moved[first : first + round(SECONDS * rate)]
    t = np.arange(len(part)) / rate
    return make_interp_spline(t, part, 5)(np.arange(0, t[-1], 1 / RATE))


@dataclass(frozen=True)
class Track:
    """Demand and measurement at the same instants.

    Attributes:
        wanted: (n,) [m].
        measured: by the sensor, its reading at zero stroke taken off, (n,) [m].
    """

    wanted: np.ndarray
    measured: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """Measured less wanted, (n,) [m]."""
        return self.measured - self.wanted

    @property
    def moving(self) -> np.ndarray:
        """Error less its mean, (n,) [m]: a displacement sensor has no zero."""
        return self.error - self.error.mean()


@dataclass(frozen=True)
class TrackingController:
    """An identified operator with its inverse.

    Attributes:
        forward: model of the operator.
        inverse: model of its inverse.
        record: name of the operator's parameters in the inverse.
        parameters: identified values.
        offset: what the sensor reads at the operator's zero stroke [m].
    """

    forward: Model
    inverse: Model
    record: str
    parameters: Mapping[str, Any] = field(repr=False)
    offset: float

    def demand(self, shape: np.ndarray) -> np.ndarray:
        """Return exercise, and a shape of TRAVEL peak to peak in mid-range, (n,) [m]."""
        volts = np.tile(np.concatenate((np.linspace(0, 1, 500), np.linspace(1, 0, 500))), 2)
        stroke = CompiledRunner(self.forward, dict(self.parameters)).run(
            2000, {"volts": design.STACK_VOLTS * volts}
        )["stroke"]
        low, high = stroke[1000:].min(), stroke[1000:].max()
        lowest = (low + high - TRAVEL) / 2
        wanted = lowest + TRAVEL * (shape - shape.min()) / np.ptp(shape)
        turn = 4 * np.pi * np.arange(EXERCISE) / EXERCISE
        way = np.linspace(0, 1, WAY, endpoint=False)
        rise = wanted[0] * way**2 * (3 - 2 * way)
        return np.concatenate((0.6 * high * (1 - np.cos(turn)), rise, wanted))

    def volts(self, demand: np.ndarray) -> np.ndarray:
        """Return voltages for a demand, each from what has been demanded until then, (n,) [V]."""
        named = {f"{self.record}.{name}": value for name, value in self.parameters.items()}
        inverse = CompiledRunner(self.inverse, {**named, "horizon": 1 / RATE})
        return inverse.run(len(demand), {"stroke": demand})["volts"]

    def adapted_volts(self, demand: np.ndarray, seed: int, time: float, stack: Stack) -> np.ndarray:
        """Return voltages with the gain adapted to what a sensor reads of a stack, (n,) [V].

        Args:
            demand: (n,) [m].
            seed: of the sensor's noise.
            time: of the adaptation [s].
            stack: parameters of the stack that differ from those of the identified one.
        """
        named = {f"{self.record}.{name}": value for name, value in self.parameters.items()}
        inverse = CompiledRunner(
            self.inverse, {**named, "horizon": 1 / RATE, "adaptation_time": time}
        )
        plant = CompiledRunner(piezo_stack.MODEL, stack)
        sensor = CompiledRunner(displacement_sensor.MODEL, {"seed": seed})
        substeps = round(FINE_RATE / RATE)
        volts, stroke = np.empty(len(demand)), 0.0
        for k, wanted in enumerate(demand):
            reading = sensor.run(1, {"stroke": stroke})["measured"][0] - self.offset
            seen = {"measured": reading, "measured_valid": float(k > EXERCISE + WAY)}
            volts[k] = inverse.run(1, {"stroke": wanted, **seen})["volts"][0]
            stroke = plant.run(substeps, {"volts": volts[k]})["stroke"][-1]
        return volts

    def track(
        self,
        shape: np.ndarray,
        seed: int | None,
        stack: Stack | None = None,
        adaptation: float = 0.0,
    ) -> Track:
        """Drive a stack.

        Args:
            shape: of the demand, any size, (n,).
            seed: of the sensor's noise; None for a sensor without noise.
            stack: parameters of the stack that differ from those of the identified one.
            adaptation: time in which the gain is adapted [s]; 0 for not at all.
        """
        demand = self.demand(shape)
        volts = (
            self.adapted_volts(demand, seed or 0, adaptation, stack or {})
            if adaptation
            else self.volts(demand)
        )
        stroke = respond(volts, parameters=stack)
        measured = stroke if seed is None else read(stroke, seed)
        return compared(demand, measured - self.offset)


def compared(demand: np.ndarray, measured: np.ndarray) -> Track:
    """Return the part of a run that counts: measured at the end of each sample, wanted there."""
    first = EXERCISE + WAY + QUIET
    return Track(demand[first + 1 :], measured[first:-1])


def track_without_model(shape: np.ndarray, seed: int) -> Track:
    """Track without a model: a smooth voltage in proportion to the demand.

    Args:
        shape: of the demand, any size, (n,).
        seed: of the sensor's noise.
    """
    substeps = round(FINE_RATE / RATE)
    coarse = np.arange(len(shape)) * substeps
    fine = make_interp_spline(coarse, shape, 3)(np.arange(coarse[-1] + 1))
    part = (fine - fine.min()) / np.ptp(fine)
    top = FIRST_TOP
    for _ in range(ATTEMPTS):
        stroke = respond(top * part, FINE_RATE)
        top *= TRAVEL / np.ptp(stroke[QUIET * substeps :])
    part, measured = part[::substeps][QUIET:], read(stroke[::substeps], seed)[QUIET:]
    return Track(measured - off_line(part, measured), measured)


@cache
def rate_independent() -> TrackingController:
    """Identify the modified operator from a sine of 10 Hz and 12.5 um p-p (A04 7.4)."""
    volts, stroke = sine(10.0, round(SECONDS * 10))
    fit = hysteresis.identify_hysteresis(volts, read(stroke, SEEDS["sine"]))
    return TrackingController(
        prandtl_ishlinskii.MODEL,
        inverse_prandtl_ishlinskii.MODEL,
        "hysteresis",
        fit.parameters,
        fit.offset,
    )


@cache
def sweep() -> tuple[np.ndarray, np.ndarray, list[slice]]:
    """Record successive saw-teeth: voltage, reading, and the place of each frequency."""
    parts = hysteresis.sweep(RATE, SWEEP)
    ends = np.cumsum([len(part) for part in parts])
    volts = np.concatenate(parts)
    where = [slice(end - len(part), end) for end, part in zip(ends, parts, strict=True)]
    return volts, read(respond(volts), SEEDS["sweep"]), where


@cache
def rate_dependence() -> TrackingController:
    """Identify the rate-dependent operator from saw-teeth of 0.5 to 40 Hz (A04 7.3.2)."""
    volts, measured, _ = sweep()
    fit = hysteresis.identify_rate_dependence(volts, measured, 1 / RATE)
    return TrackingController(
        rate_dependent.MODEL,
        inverse_rate_dependent.MODEL,
        "hysteresis",
        fit.parameters,
        fit.offset,
    )


@cache
def recorded() -> tuple[np.ndarray, np.ndarray]:
    """Record the excitation for modulated stops and its stroke, without sensor noise."""
    volts = excitation(RATE)
    return volts, respond(volts)


@cache
def stops() -> TrackingController:
    """Identify modulated stops from their excitation."""
    volts, stroke = recorded()
    return stops_tracker(identify_stops(volts, read(stroke, SEEDS["excitation"]), 1 / RATE))


def stops_tracker(fit: StopsFit) -> TrackingController:
    """Return the tracker of identified stops."""
    return TrackingController(
        modulated_stops.MODEL,
        inverse_modulated_stops.MODEL,
        "operator",
        fit.parameters,
        fit.offset,
    )


CONTROLLERS: dict[str, Callable[[], TrackingController]] = {
    "rate-independent": rate_independent,
    "rate-dependent": rate_dependence,
    "modulated stops": stops,
}
"""How each column of the tables is tracked; beside them there is `track_without_model`."""
