"""The estimator when sensors or surroundings are not as they should be, each case by its name.

A hand moves the instrument; the sensors are written out here, with the noise of their data sheets
behind their lag and a converter of 16 bits. Then one thing goes wrong.
"""

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from fmu_src.estimation.micron import MODEL
from fmu_src.kit import design
from fmu_src.pack import build
from tests.compiled import CompiledRunner
from tests.estimation.test_micron import NORTH, SITES, T, voltages

STEP = design.ADC_SPAN / 2**16
TILTED = Rotation.from_euler("xyz", [20, 40, 10], degrees=True)
HAND = {"slow": np.radians(3.0), "tremor": 2e-4, "push": 0.05}
STILL = {"slow": 0.0, "tremor": 0.0, "push": 0.0}


class Run:
    """A hand's motion, what the sensors make of it, and what the estimator makes of that.

    Args:
        seconds: duration.
        base: attitude about which the hand moves.
        slow: amplitude of a turn at 0.3 Hz about an axis across [rad].
        tremor: the same at 9 Hz [rad].
        push: acceleration of the whole instrument along x of W at 9 Hz [m/s2].
        turn: steady rate about the vertical [rad/s].
        seed: of the noise.
    """

    def __init__(self, seconds, base=TILTED, slow=0.0, tremor=0.0, push=0.0, turn=0.0, seed=1):
        rng = np.random.default_rng(seed)
        self.t = t = np.arange(round(seconds / T)) * T
        ramp = np.clip((t - 0.5) / 1.5, 0, 1)  # at rest at first, as the estimator supposes
        fade = ramp**3 * (10 - 15 * ramp + 6 * ramp**2)
        sway = slow * fade * np.sin(2 * np.pi * 0.3 * t)
        shake = tremor * fade * np.sin(2 * np.pi * 9 * t)
        self.attitude = (
            Rotation.from_rotvec(np.outer(turn * t, [0, 0, 1]))
            * base
            * Rotation.from_rotvec(np.outer(sway, [0.6, -0.7, 0.387]))
            * Rotation.from_rotvec(np.outer(shake, [0.8, 0.6, 0.0]))
        )
        steps = (self.attitude[:-1].inv() * self.attitude[1:]).as_rotvec() / T
        self.rate = np.vstack([steps[:1], (steps[1:] + steps[:-1]) / 2, steps[-1:]])
        self.alpha = np.gradient(self.rate, T, axis=0)
        self.pushed = np.outer(push * fade * np.cos(2 * np.pi * 9 * t), [1.0, 0, 0])
        self.field = np.tile(NORTH, (len(t), 1))
        self.noise = rng.normal(size=(len(t), 9))
        self.heard = np.ones(len(t))

    def volts(self) -> np.ndarray:
        """Of the nine channels, (n, 9)."""
        force = self.attitude.inv().apply(self.pushed + [0, 0, design.SITE_GRAVITY])
        volts = voltages(self.attitude, self.rate, self.alpha, force)
        m = self.attitude.inv().apply(self.field)
        volts[:, 6:] = 2.5 + m * design.MAGNETOMETER_SCALE
        keep = np.exp(-T / design.SENSOR_LAG)
        clean = volts[:, :6] - volts[0, :6]
        volts[:, :6] = lfilter([1 - keep], [1, -keep], clean, axis=0) + volts[0, :6]
        size = design.ACCELEROMETER_NOISE / np.sqrt(4 * design.SENSOR_LAG)
        drive = self.noise[:, :6] * np.sqrt(1 - keep**2)
        drive[0] = self.noise[0, :6]
        volts[:, :6] += design.ACCELEROMETER_SCALE * size * lfilter([1], [1, -keep], drive, axis=0)
        volts[:, 6:] += design.MAGNETOMETER_SCALE * 5e-8 * self.noise[:, 6:]
        return np.clip(np.round(volts / STEP) * STEP, 0, design.ADC_SPAN - STEP)

    def estimate(self, volts=None, **parameters) -> "Run":
        """Outputs as attributes; errors as rotation vectors in W."""
        given = {name.replace("__", "."): value for name, value in parameters.items()}
        self.out = CompiledRunner(MODEL, given).run(
            len(self.t),
            {"volts": self.volts() if volts is None else volts, "inertial_valid": self.heard},
        )
        assert all(np.isfinite(values).all() for values in self.out.values())
        found = Rotation.from_quat(self.out["attitude"], scalar_first=True)
        self.error = np.degrees((found * self.attitude.inv()).as_rotvec())
        self.tilt = np.linalg.norm(self.error[:, :2], axis=1)
        self.heading = np.abs(self.error[:, 2])
        return self

    def at(self, begin: float, end: float) -> slice:
        """Samples between two times [s]."""
        return slice(round(begin / T), round(end / T))

    def flag(self, name: str, begin: float, end: float) -> np.ndarray:
        """A boolean output between two times."""
        return self.out[name][self.at(begin, end)] > 0.5


def test_nothing_wrong_nothing_flagged() -> None:
    """What the cases below are held against: a hand as it is."""
    run = Run(12, **HAND).estimate()
    for name in (
        "magnetic_disturbance",
        "acceleration_disturbance",
        "at_rest",
        "frozen",
        "clipped",
    ):
        assert not run.flag(name, 2, 12).any(), name
    assert run.flag("valid", 1, 12).all()
    print(run.tilt[2000:].max(), run.heading[2000:].max())
    assert run.tilt[2000:].max() < 0.5
    assert run.heading[2000:].max() < 0.5
