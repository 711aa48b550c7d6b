"""Trials of a hand that holds still: one axis of a recording each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from fmu_src.tremor.cascade_neural import SAMPLE_PERIOD
from harness.common.types import FloatArray
from harness.identify.tremor_nn.cascade import RATE
from harness.recordings.motion import Recording, read_recording
from harness.recordings.quality import select_samples

__all__ = ["AXES", "StillTrial", "at_rate", "read_trials"]

AXES = "xyz"
STILL = 1e-3
"""Largest rms of a hand that holds still; A04 table 5.1 has 0.05 to 0.13 mm [m]."""


@dataclass(frozen=True)
class StillTrial:
    """One axis of a recording in which somebody held still.

    Attributes:
        name: name for people.
        error: deviation from the place that was held, (n,) [m], at RATE.
        role: use of the trial: `trained`, `rest` of a recording of which a part was trained on, or
            `other` recordings.
        note: sentence about what is unusual; empty if nothing is.
    """

    name: str
    error: FloatArray
    role: str = "trained"
    note: str = ""

    @property
    def rms(self) -> float:
        """Rms about the mean [m]."""
        return float(np.std(self.error))


def at_rate(recording: Recording) -> FloatArray:
    """Return the position at RATE: as recorded if that is its rate, else by a quintic spline.

    Returns:
        (n, 3) [m].
    """
    count = int(recording.seconds * RATE + 1e-6) + 1
    time = np.arange(count) * SAMPLE_PERIOD
    if len(time) == len(recording.time) and np.abs(time - recording.time).max() < 1e-6:
        return recording.position
    found: FloatArray = make_interp_spline(recording.time, recording.position, 5)(time)
    return found


def read_trials(path: Path, axes: str, part: str, role: str = "trained") -> list[StillTrial]:
    """Read the trials of a recording.

    Args:
        path: the recording.
        axes: some of x, y, z.
        part: part with the role, as the option `--fit` writes it; the rest makes trials of its own.
        role: role of the part.

    Raises:
        SteadytipError: the recording cannot be read, or has no such part.
    """
    recording = read_recording(path)
    chosen = select_samples(part, path, recording.time)
    position = at_rate(recording)
    time = np.arange(len(position)) * SAMPLE_PERIOD
    inside = np.interp(time, recording.time, chosen.astype(float)) >= 0.5
    begin, end = int(np.argmax(inside)), len(inside) - int(np.argmax(inside[::-1]))
    pieces = [(begin, end, role)]
    if role == "trained" and end < len(inside):
        pieces.append((end, len(inside), "rest"))
    found = []
    for first, past, what in pieces:
        for axis in axes:
            values = position[first:past, AXES.index(axis)]
            error = values - values.mean()
            name = f"{path.name}, {axis}, {time[first]:.4g} to {time[past - 1]:.4g} s"
            note = (
                f"{name} moves by {1e3 * np.std(error):.3g} mm rms, which is more than holding "
                "still; all of it counts as error: choose a part with --fit, or other recordings"
                if np.std(error) > STILL
                else ""
            )
            found.append(StillTrial(name, error, what, note))
    return found
