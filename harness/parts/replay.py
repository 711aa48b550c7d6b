"""A recording as a part: it moves the part that its outputs are wired to.

A quintic spline goes through the raw samples and gives velocity and acceleration as its exact
derivatives. Nothing is smoothed: zero-phase smoothing would let the future leak into the past, and
any predictor behind it would look better than it is. Nothing is extrapolated either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from harness.parts.ports import Port, Unit
from harness.parts.protocols import RunContext, Settings
from harness.parts.rows import RowsPart
from harness.parts.settings import ReplaySettings, check_settings
from harness.recordings.motion import read_recording

_DEGREE = 5
_METRE = Unit("m", (0, 1, 0, 0, 0, 0, 0, 0))
_SPEED = Unit("m/s", (0, 1, -1, 0, 0, 0, 0, 0))
_ACCELERATION = Unit("m/s2", (0, 1, -2, 0, 0, 0, 0, 0))
_VECTORS = (
    ("recorded", _METRE, "recorded tip position"),
    ("recorded_velocity", _SPEED, "its first derivative"),
    ("recorded_acceleration", _ACCELERATION, "its second derivative"),
)

PORTS: Sequence[Port] = (
    *(
        Port(f"{name}_{axis}", "Real", unit, f"{text} along {axis} of W", frozenset())
        for name, unit, text in _VECTORS
        for axis in "xyz"
    ),
    Port("recorded", "Boolean", None, "whether a recording is there", frozenset()),
)
"""What a recording gives, and what a part that can be moved by one takes."""


class ReplayPart(RowsPart):
    """Plays a recording, shifted so that time and position start at 0."""

    def __init__(self, name: str, settings: Settings, seed: int) -> None:
        """Read the recording.

        Raises:
            ProblemsError: a setting that a recording does not have.
            SteadytipError: the recording cannot be used.
        """
        self.name = name
        self.outputs = PORTS
        keys = check_settings(ReplaySettings, name, settings)
        self._recording = read_recording(
            Path(keys.replay), keys.columns, accept=keys.accept, repair=keys.repair
        )
        self.seconds = self._recording.seconds
        self.findings = self._recording.findings
        self._evaluated = (0, 0.0)  # number of ticks, and their period
        self.rows = np.ones((0, len(PORTS)))

    def evaluate(self, run: RunContext) -> None:
        """Evaluate the spline at all ticks of the run; see `RowsPart.evaluate`."""
        if self._evaluated == (run.steps, run.step):
            return
        from scipy.interpolate import make_interp_spline

        self._evaluated = (run.steps, run.step)
        spline = make_interp_spline(self._recording.time, self._recording.position, k=_DEGREE)
        t = np.arange(run.steps) * run.step
        self.rows = np.ones((run.steps, len(PORTS)))
        self.rows[:, :-1] = np.hstack([spline(t, nu) for nu in range(len(_VECTORS))])

    def metadata(self) -> dict[str, Any]:
        """File and length."""
        return {
            "kind": "replay",
            "file": self._recording.path.name,
            "seconds": self.seconds,
            "samples": len(self._recording.time),
            "findings": [asdict(finding) for finding in self.findings],
        }
