"""The piezo stack on the bench of A04 7.4, which items of chapter 7 measure on.

Voltages are held over a sample of 1 kHz unless a test wants them smooth; the stroke is read at the
end of the sample, by a sensor with 0.07 um rms of noise where noise is asked for.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fmu_src.pack.compiled_runner import CompiledRunner
from fmu_src.piezo import prandtl_ishlinskii
from fmu_src.piezo.prandtl_ishlinskii import DEAD_ZONES, NOMINAL, PLAYS
from plants import displacement_sensor, piezo_stack

RATE = 1000.0
"""Samples in a second (A04 7.4)."""
FINE_RATE = 1 / piezo_stack.MODEL.sample_period
"""At which a voltage is as good as smooth [Hz]."""
TRAVEL = 12.5e-6
"""Peak to peak of the sines of A04 chapter 7 [m]."""
SETTLING = 1.0
"""Seconds of a sine that are left out."""
ATTEMPTS, FIRST_TOP = 4, 90.0
"""For a voltage that gives TRAVEL: runs, and where they begin [V]."""


Stack = Mapping[str, Any]
"""Parameters of a stack that differ from the shipped ones."""


def respond(volts: np.ndarray, rate: float = RATE, parameters: Stack | None = None) -> np.ndarray:
    """Return the stroke of a new stack at the end of each sample of a held voltage, (n,) [m].

    Args:
        volts: (n,) [V].
        rate: samples in a second, a whole part of the plant's [Hz].
        parameters: of the stack.
    """
    substeps = round(FINE_RATE / rate)
    held = {"volts": np.append(np.repeat(volts, substeps), volts[-1])}
    run = CompiledRunner(piezo_stack.MODEL, parameters).run(substeps * len(volts) + 1, held)
    return run["stroke"][substeps::substeps]


def read(stroke: np.ndarray, seed: int) -> np.ndarray:
    """Read the stroke with the displacement sensor, (n,) [m]."""
    sensor = CompiledRunner(displacement_sensor.MODEL, {"seed": seed})
    return sensor.run(len(stroke), {"stroke": stroke})["measured"]


def sine(frequency: float, cycles: int, rate: float = RATE) -> tuple[np.ndarray, np.ndarray]:
    """Return voltage and stroke of the last cycles of a sine from 0 V up with a stroke of TRAVEL.

    Args:
        frequency: [Hz].
        cycles: how many are kept.
        rate: of the samples [Hz].

    Returns:
        (n,) [V] and (n,) [m].
    """
    keep = round(cycles / frequency * rate)
    time = np.arange(round(SETTLING * rate) + keep) / rate
    top = FIRST_TOP
    for _ in range(ATTEMPTS):
        volts = top * (1 - np.cos(2 * np.pi * frequency * time)) / 2
        stroke = respond(volts, rate)
        top *= TRAVEL / np.ptp(stroke[-keep:])
    return volts[-keep:], stroke[-keep:]


def off_line(volts: np.ndarray, stroke: np.ndarray) -> np.ndarray:
    """Return what the best straight line leaves of the stroke, (n,) [m]."""
    return stroke - np.polyval(np.polyfit(volts, stroke, 1), volts)


def operator(
    volts: np.ndarray,
    thresholds: Sequence[float] = (0.0,),
    weights: Sequence[float] = (1.0,),
    dead_zones: Sequence[float] = (0.0,),
    saturation: Sequence[float] = (1.0,),
) -> np.ndarray:
    """Return the output of a modified Prandtl-Ishlinskii operator, at rest before, (n,) [V].

    All weights are pure numbers here, as in A04 7.2.

    Args:
        volts: (n,) [V].
        thresholds: r, at most PLAYS [V].
        weights: w_h, as many.
        dead_zones: d, at most DEAD_ZONES [V].
        saturation: w_s, as many.
    """
    wide = 190.0  # thresholds that the order does not have; they weigh nothing
    spare = np.arange(PLAYS)
    values = {
        "thresholds": [*thresholds, *(wide + spare[len(thresholds) :])],
        "weights": [*weights, *np.zeros(PLAYS - len(weights))],
        "dead_zones": [*dead_zones, *(wide + spare[len(dead_zones) : DEAD_ZONES])],
        "saturation": NOMINAL * np.pad(saturation, (0, DEAD_ZONES - len(saturation))),
    }
    return run_operator(values, volts) / NOMINAL


def run_operator(parameters: Mapping[str, Any], volts: np.ndarray) -> np.ndarray:
    """Return stroke of a modified Prandtl-Ishlinskii operator at rest before, (n,) [m]."""
    model = CompiledRunner(prandtl_ishlinskii.MODEL, parameters)
    return model.run(len(volts), {"volts": volts})["stroke"]
