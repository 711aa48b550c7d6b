"""The unit on the turntable of A04 4.2.2: calibrated on its grid, tested between its angles.

The unit is scenario `raw_unit`, which no estimator shares a model with. It is calibrated as
`steadytip identify imu` does it, from what `steadytip identify turntable` records. It is tested
with other noise and other errors of the turntable, at angles that it was not calibrated at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from fmu_src.estimation.micron.model import MODEL
from fmu_src.kit.runner import Runner
from harness.common.types import FloatArray
from harness.identify.imu import fit as calibration
from harness.identify.imu import turntable
from harness.recordings.turntable import CHANNELS, group_positions, join_positions

__all__ = ["Parameters", "TiltErrors", "identified", "sweep", "sweeps"]

Parameters = Mapping[str, float]
"""Of MicronEstimator, by element."""
SCENARIO = "raw_unit"
DWELL = 0.5
"""Mean at each test angle: 500 samples (A04 4.2.2.1) [s]."""
STEP = 30.0
"""Of the sweeps [deg]."""
SHIFT = 15.0
"""By which their angles are off those of the calibration [deg]."""
SEEN = 0.5
"""Least share of gravity across the axis of beta for it to count."""
_CALIBRATED, _TESTED = 1, 9  # seeds


@dataclass(frozen=True)
class TiltErrors:
    """Errors of the two tilt angles at each test angle, (3 sweeps, 12) [rad].

    Attributes:
        alpha: of the tilt.
        beta: of the turn; NaN where its axis is near the vertical.
        attitude: angle of the whole attitude's error, heading included.
    """

    alpha: FloatArray
    beta: FloatArray
    attitude: FloatArray

    def counted(self) -> dict[str, FloatArray]:
        """Return errors of each angle in the sweeps in which it moves."""
        beta = self.beta[1:]
        return {"alpha": self.alpha[[0, 2]].ravel(), "beta": beta[np.isfinite(beta)]}


def sweeps() -> tuple[FloatArray, FloatArray]:
    """Return angles of the three sweeps: alpha, beta, both at once, (36,) [rad].

    A04 counts alpha from where the instrument's axis is level, which is 90 deg here.
    """
    moving = np.radians(np.arange(-180.0 + SHIFT, 180.0, STEP))
    still = np.zeros_like(moving)
    alpha = np.concatenate((moving, still, moving)) + np.pi / 2
    return alpha, np.concatenate((still, moving, moving))


@cache
def identified(
    dwell: float = turntable.DWELL, rooms: tuple[float, ...] = (turntable.ROOM,)
) -> dict[str, Parameters]:
    """Identify parameters by model: those of the data sheet, linear and physical ones.

    Args:
        dwell: of the calibration at each pair of angles [s].
        rooms: temperatures at which the procedure is run [degC].
    """
    alpha, beta = turntable.grid()
    settings, parts = turntable.sensors(SCENARIO, "sensors"), []
    for seed, room in enumerate(rooms, start=_CALIBRATED):
        table = turntable.Turntable(seed=seed)
        done = turntable.simulate(settings, alpha, beta, table, seed, room, dwell)
        columns = (done.alpha, done.beta, done.volts, done.temperature)
        parts.append(group_positions(*columns, CHANNELS, "the bench"))
    found = join_positions(parts)
    return {
        "data sheet": {},
        "linear": calibration.linear(found),
        "physical": calibration.calibrate(found, "the bench").parameters(),
    }


def sweep(
    models: Mapping[str, Parameters],
    seed: int = _TESTED,
    room: float = turntable.ROOM,
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> dict[str, TiltErrors]:
    """Return errors of the estimator's attitude after some samples at the angles of the sweeps.

    It starts anew at each, with means of a fifth of the dwell as its samples: what errs is what
    calibration leaves.

    Args:
        models: parameters of the estimator by name.
        seed: of noise and turntable.
        room: its temperature [degC].
        progress: called with the number of angles done, and of all angles.
    """
    alpha, beta = sweeps()
    done = turntable.simulate(
        turntable.sensors(SCENARIO, "sensors"),
        alpha,
        beta,
        turntable.Turntable(seed=seed),
        seed,
        room,
        DWELL,
        progress=progress,
    )
    truth = done.attitudes[:: turntable.ROWS]
    return {
        name: _errors(_attitudes(parameters, done), truth, alpha, beta)
        for name, parameters in models.items()
    }


def _attitudes(parameters: Parameters, done: turntable.TurntableRun) -> Rotation:
    found, rows = [], turntable.ROWS
    for k in range(0, len(done.volts), rows):
        inputs = {
            "volts": done.volts[k : k + rows],
            "temperature": done.temperature[k : k + rows],
        }
        found.append(Runner(MODEL, parameters).run(rows, inputs)["attitude"][-1])
    return Rotation.from_quat(np.roll(found, -1, axis=1))


def _errors(found: Rotation, truth: Rotation, alpha: FloatArray, beta: FloatArray) -> TiltErrors:
    up = truth.inv().apply([0.0, 0.0, 1.0])
    # The rotation that takes the true vertical to the estimated one, along the axes of the angles.
    off = np.cross(up, found.inv().apply([0.0, 0.0, 1.0]))
    axis = Rotation.from_euler("z", -beta[:, None]).apply([0.0, 1.0, 0.0])
    across = np.sin(alpha)
    seen = np.abs(across) >= SEEN
    turn = np.where(
        seen, np.sum(off * np.cross(up, axis), axis=1) / np.where(seen, across, 1.0), np.nan
    )
    return TiltErrors(
        np.sum(off * axis, axis=1).reshape(3, -1),
        turn.reshape(3, -1),
        (truth.inv() * found).magnitude().reshape(3, -1),
    )
