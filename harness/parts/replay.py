"""A recording as a part: it moves the part that its outputs are wired to.

A quintic spline goes through the raw samples and gives velocity and acceleration as its exact
derivatives. Nothing is smoothed: zero-phase smoothing would let the future leak into the past, and
any predictor behind it would look better than it is. Nothing is extrapolated either.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from harness.errors import ProblemsError
from harness.parts import FloatArray, Port, Rows, Run, Settings, Unit
from harness.parts.recording import read_recording

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


class ReplayPart:
    """Plays a recording, shifted so that time and position start at 0."""

    def __init__(self, name: str, settings: Settings, seed: int) -> None:
        """Read the recording.

        Raises:
            ProblemsError: a setting that a recording does not have.
            SteadytipError: the recording cannot be used.
        """
        self.name = name
        self.inputs: Sequence[Port] = ()
        self.outputs = PORTS
        unknown = set(settings) - {"replay"}
        if unknown:
            raise ProblemsError(
                f"part '{name}'", [f"a recording has no setting '{key}'" for key in sorted(unknown)]
            )
        self._recording = read_recording(Path(settings["replay"]))
        self.seconds = self._recording.seconds
        self.kept = False
        self._evaluated = (0, 0.0)  # number of ticks, and their period
        self._values: FloatArray = np.ones((0, len(PORTS)))

    @classmethod
    def prepare(
        cls, settings: Mapping[str, Settings], progress: Callable[[str], None]
    ) -> Mapping[str, Settings]:
        """Nothing has to be prepared."""
        return settings

    def start(
        self,
        run: Run,
        driven: Sequence[str],
        preset: Sequence[bool],
        u: FloatArray,
        y: FloatArray,
    ) -> None:
        """Evaluate the spline at all ticks of the run; see `harness.parts.Part.start`."""
        self._y = y
        if self._evaluated == (run.steps, run.step):
            self._y[:] = self._values[0]
            return
        from scipy.interpolate import make_interp_spline

        self._evaluated = (run.steps, run.step)
        spline = make_interp_spline(self._recording.time, self._recording.position, k=_DEGREE)
        t = np.arange(run.steps) * run.step
        self._values = np.ones((run.steps, len(PORTS)))
        self._values[:, :-1] = np.hstack([spline(t, nu) for nu in range(len(_VECTORS))])
        self._y[:] = self._values[0]

    def advance(self, t: float, h: float) -> None:
        """Put out the motion at `t`; see `harness.parts.Part.advance`."""
        self._y[:] = self._values[round(t / h)]

    def can_pause(self) -> bool:
        """See `harness.parts.Reusable`: what it puts out depends on the time alone."""
        return True

    def release(self) -> None:
        """Nothing has to be freed."""

    def march(self) -> Rows:
        """See `harness.parts.Marching`."""
        return Rows(self._values)

    def close(self) -> None:
        """Nothing has to be freed."""

    def facts(self) -> dict[str, Any]:
        """File and length."""
        return {
            "kind": "replay",
            "file": self._recording.path.name,
            "seconds": self.seconds,
            "samples": len(self._recording.time),
        }
