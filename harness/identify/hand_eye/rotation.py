"""Turns of the body by its gyro, and relative rotations of body and coils."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from harness.common.types import FloatArray
from harness.identify.hand_eye.read import TrackedMotion

__all__ = ["APART", "GyroRotation", "relative_rotations"]

APART = 0.5
"""Time between the attitudes of a pair [s]."""


class GyroRotation:
    """Turn of the body since the start by the gyro less a bias, and its slope with the bias."""

    def __init__(self, recorded: TrackedMotion, bias: FloatArray) -> None:
        self.time, self.rate = recorded.time, recorded.rate - bias
        step = np.diff(self.time)
        mean = (self.rate[1:] + self.rate[:-1]) / 2
        quaternions = Rotation.from_rotvec(mean * step[:, None]).as_quat()
        quaternions = np.vstack(([0.0, 0.0, 0.0, 1.0], quaternions))
        shift = 1
        while shift < len(quaternions):  # all products of the first k in log2(n) rounds
            joined = Rotation.from_quat(quaternions[:-shift]) * Rotation.from_quat(
                quaternions[shift:]
            )
            quaternions[shift:] = joined.as_quat()
            shift *= 2
        self.turn = Rotation.from_quat(quaternions)
        matrices = self.turn.as_matrix()
        area = np.zeros_like(matrices)
        area[1:] = np.cumsum((matrices[1:] + matrices[:-1]) / 2 * step[:, None, None], axis=0)
        # R(t)^T times the integral of R: turn back in B by a change of the bias.
        self.slope = matrices.swapaxes(1, 2) @ area

    def at(self, time: FloatArray, change: FloatArray) -> Rotation:
        """Return the turn until some instants, with a small change of the bias, (3,)."""
        place = np.clip(np.searchsorted(self.time, time) - 1, 0, len(self.time) - 2)
        after = time - self.time[place]
        step = (self.time[place + 1] - self.time[place])[:, None]
        half = self.rate[place] + (self.rate[place + 1] - self.rate[place]) / step * (
            after[:, None] / 2
        )
        missed = -self.slope[place] @ change
        return (
            self.turn[place]
            * Rotation.from_rotvec(missed)
            * Rotation.from_rotvec(half * after[:, None])
        )


def relative_rotations(
    turns: Rotation, z: Rotation, at: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return rotation vectors of body and coils over `APART`, (m, 3) each [rad].

    Args:
        turns: turn of the body at each attitude.
        z: attitudes of the coils.
        at: when they were measured, (n,) [s].
    """
    later = np.searchsorted(at, at + APART)
    first = np.flatnonzero(later < len(at))
    later = later[first]
    body = (turns[first].inv() * turns[later]).as_rotvec()
    return body, (z[first].inv() * z[later]).as_rotvec()
