"""Motions that filters are tested with, and how what they find is scored."""

from pathlib import Path

import numpy as np
from scipy import interpolate, signal

from harness.recordings.motion import read_recording, recordings

T = 1e-3


def tones(seconds: float, frequency: float, amplitude: float = 20e-6) -> np.ndarray:
    """A tone along each axis, a radian apart, (n, 3) [m]."""
    time = np.arange(round(seconds / T)) * T
    return amplitude * np.sin(2 * np.pi * frequency * time[:, None] + np.arange(3.0))


def recorded(data_dir: Path) -> list[np.ndarray]:
    """Positions of the ten recorded hands at the filters' rate, each (n, 3) [m]."""
    found = []
    for path in recordings([data_dir / "hand_motion_m2s2"]):
        recording = read_recording(path)
        spline = interpolate.make_interp_spline(recording.time, recording.position, k=5)
        found.append(spline(np.arange(0, recording.time[-1], T)))
    assert len(found) == 10
    return found


def reductions(
    position: np.ndarray, tremor: np.ndarray, skipped: int = 3000
) -> tuple[float, float]:
    """A-posteriori and in-band reduction [%], means over the axes.

    A-posteriori: of the distance to the position's own 6 to 15 Hz band, second-order Butterworth
    band-pass run both ways. In-band: of the rms in 6 to 16 Hz, fourth-order, both ways.

    Args:
        position: (n, 3) [m].
        tremor: what is taken from it, (n, 3) [m].
        skipped: samples at the beginning that do not count.
    """

    def band(order: int, edges: tuple[float, float], motion: np.ndarray) -> np.ndarray:
        sections = signal.butter(order, edges, "bandpass", fs=1 / T, output="sos")
        return signal.sosfiltfilt(sections, motion, axis=0)[skipped:]

    def left(after: np.ndarray, before: np.ndarray) -> float:
        return float(np.mean(100 * (1 - after.std(axis=0) / before.std(axis=0))))

    target = band(2, (6, 15), position)
    in_band = left(band(4, (6, 16), position - tremor), band(4, (6, 16), position))
    return left(target - tremor[skipped:], target), in_band
