"""Hands as an instrument's own sensors feel them: what a filter on accelerometers gets.

The hand moves the instrument, whose tip stays where it is in the handle; noise, lag and errors of
the sensors are the plants', and the estimator gives forces and attitude as in the loop.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from fmu_src.device import design
from fmu_src.estimation.micron import model as micron
from fmu_src.pack.compiled_runner import CompiledRunner
from harness.recordings.motion import Recording
from harness.reproduce.experiments.tremor import RATE, TipMotion
from plants import hand, inertial_sensors, instrument

A04_NOISE = 4.535e-3
"""Of A04 Table 2.3 [m/s2/Hz0.5]: 2.25 mg rms behind the 15.1 Hz output filter."""
MOTIONS = ("body", "body_acceleration", "attitude", "rate", "angular_acceleration")
FELT = ("force1", "force2", "force3", "field")


@dataclass(frozen=True)
class SensedMotion(TipMotion):
    """A motion of the tip, and what the estimator makes of the sensors.

    Attributes:
        force: compensated specific forces, (n, 6) [m/s2], B.
        attitude: q_WB as estimated, (n, 4).
        displacement: of the tip, washed out, (n, 3) [m], W.
        valid: whether they can be trusted, (n,).
        density: of the accelerometers' noise [m/s2/Hz0.5].
    """

    force: np.ndarray
    attitude: np.ndarray
    displacement: np.ndarray
    valid: np.ndarray
    density: float


def sensed(recording: Recording, noise: float = 1.0, seed: int = 1) -> SensedMotion:
    """Simulate the sensors on a recorded hand.

    Args:
        recording: of the tip.
        noise: of the accelerometers, over that of their data sheet.
        seed: of the noise, and of what the recording does not say.
    """
    spline = make_interp_spline(recording.time, recording.position, 5)
    time = np.arange(int(recording.time[-1] * RATE + 1e-6) + 1) / RATE
    position = spline(time)
    inputs = {
        "recorded": 1.0,
        **{f"recorded_{axis}": position[:, k] for k, axis in enumerate("xyz")},
        "recorded_velocity": spline(time, 1),
        "recorded_acceleration": spline(time, 2),
    }
    return _felt(CompiledRunner(hand.MODEL, {"seed": seed}).run(len(time), inputs), noise, seed)


def generated(seconds: float, noise: float = 1.0, seed: int = 1) -> SensedMotion:
    """Simulate the sensors on a hand of the generator.

    Args:
        seconds: how long.
        noise: of the accelerometers, over that of their data sheet.
        seed: of hand and noise.
    """
    return _felt(
        CompiledRunner(hand.MODEL, {"seed": seed}).run(round(seconds * RATE) + 1), noise, seed
    )


def _felt(motion: dict[str, np.ndarray], noise: float, seed: int) -> SensedMotion:
    samples = len(motion["tip"])
    density = noise * design.ACCELEROMETER_NOISE
    forces = CompiledRunner(instrument.MODEL).run(samples, {name: motion[name] for name in MOTIONS})
    volts = CompiledRunner(
        inertial_sensors.MODEL, {"seed": seed, "accelerometer_noise": density}
    ).run(samples, {name: forces[name] for name in FELT})["volts"]
    known = CompiledRunner(micron.MODEL, {"accelerometer.density": density}).run(
        samples, {"volts": volts}
    )
    position = forces["free_tip"] - forces["free_tip"][0]
    time = np.arange(samples) / RATE
    return SensedMotion(
        "sensed",
        lambda t: position[np.rint(np.asarray(t) * RATE).astype(int)],
        float(time[-1]),
        known["force"],
        known["attitude"],
        known["tip_displacement"],
        known["valid"],
        density,
    )
