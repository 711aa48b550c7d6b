"""Attitude from trackers and inertial units on a robot's wrist: plants, filters, errors.

Plants and filters have the settings of the shipped scenarios; only faults and metal are added.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fmu_src.estimation import em_ekf, optical_ekf
from fmu_src.kit.model import Model
from fmu_src.pack.compiled_runner import CompiledRunner
from harness.common.types import FloatArray
from harness.scenario.load import load
from plants import em_tracker, gyro_imu, optical_tracker, robot

EM, OPTICAL = "em_tracking", "optical_tracking"
"""Scenarios."""
T = robot.MODEL.sample_period
SETTLED = 2.0
"""From where errors count [s]."""
AFTER = 1.0
"""For so long after a start or stop an overshoot belongs to it [s]."""
PRINTED = {
    "tracker.hard_switching": True,
    "tracker.distortion_sigma": 0.0,
    "inertial.force_bias_sigma": 0.0,
}
"""RK's filter as printed: seven states and hard switching."""
Outputs = dict[str, FloatArray]


@dataclass(frozen=True)
class EmRun:
    """A robot's wrist, its tracker and filters.

    Attributes:
        time: (n,) [s].
        robot: outputs of the robot.
        tracker: outputs of the tracker.
        ours: outputs of the filter.
        printed: outputs of the filter with `PRINTED`.
    """

    time: FloatArray
    robot: Outputs
    tracker: Outputs
    ours: Outputs
    printed: Outputs

    def attitudes(self) -> dict[str, FloatArray]:
        """Return quaternions by what gives them, (n, 4)."""
        return {
            "tracker alone": self.tracker["em_attitude"],
            "fused, switched as printed": self.printed["attitude"],
            "fused": self.ours["attitude"],
        }


@dataclass(frozen=True)
class OpticalRun:
    """A robot's wrist under an optical tracker, and the filter.

    Attributes:
        time: (n,) [s].
        robot: outputs of the robot.
        tracker: outputs of the tracker.
        imu: outputs of the inertial unit.
        filtered: outputs of the filter.
        bias: of the gyro, as the plant has it, (3,) [rad/s].
    """

    time: FloatArray
    robot: Outputs
    tracker: Outputs
    imu: Outputs
    filtered: Outputs
    bias: FloatArray


def settings(scenario: str, part: str) -> dict[str, Any]:
    """Return values that a scenario gives a part, by dotted name."""

    def flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
        for name, value in table.items():
            if isinstance(value, Mapping):
                yield from flat(value, f"{prefix}{name}.")
            else:
                yield prefix + name, value

    table = load(scenario).parts[part].settings.table
    return {name: value for name, value in flat(table) if name != "fmu"}


def _run(model: Model, scenario: str, part: str, count: int, inputs: Mapping[str, Any],
         **more: Any) -> Outputs:  # fmt: skip
    runner = CompiledRunner(model, settings(scenario, part) | more)
    return runner.run(count, {**inputs})


def _moved(scenario: str, seconds: float) -> tuple[FloatArray, Outputs, Outputs, Outputs]:
    """Time, outputs of the robot, pose for a tracker, motion for an inertial unit."""
    count = round(seconds / T)
    out = _run(robot.MODEL, scenario, "robot", count, {})
    pose = {name: out[name] for name in ("body", "attitude")}
    motion = pose | {name: out[name] for name in ("body_acceleration", "angular_acceleration")}
    return T * np.arange(float(count)), out, pose, motion | {"body_rate": out["rate"]}


def em_run(
    seconds: float, metal: FloatArray | None = None, seed: int = 1, **surroundings: Any
) -> EmRun:
    """Run the scenario `em_tracking`.

    Args:
        seconds: how long [s].
        metal: place of the piece that is moved, (n, 3) [m]; None for far away.
        seed: of tracker and inertial unit.
        surroundings: further parameters of the tracker.
    """
    time, moved, pose, motion = _moved(EM, seconds)
    count = len(time)
    given = pose if metal is None else pose | {"metal": metal}
    tracker = _run(em_tracker.MODEL, EM, "tracker", count, given, seed=seed, **surroundings)
    imu = _run(gyro_imu.MODEL, EM, "imu", count, motion, seed=seed + 1)
    sensed = {n: tracker[n] for n in ("em_position", "em_attitude", "em_new", "em_age")}
    sensed |= {n: imu[n] for n in ("rate", "force", "field", "inertial_valid")}
    ours = _run(em_ekf.MODEL, EM, "estimator", count, sensed)
    printed = CompiledRunner(em_ekf.MODEL, settings(EM, "estimator") | PRINTED).run(count, sensed)
    return EmRun(time, moved, tracker, ours, printed)


@cache
def rk_run() -> EmRun:
    """Run the scenario of RK figures 3 and 4 as it is shipped."""
    return em_run(load(EM).seconds)


def optical_run(seconds: float, occluded: FloatArray | None = None, seed: int = 1) -> OpticalRun:
    """Run the scenario `optical_tracking`, its occlusions replaced by given ones.

    Args:
        seconds: how long [s].
        occluded: whether the line of sight is blocked, (n,); None for never.
        seed: of tracker and inertial unit.
    """
    time, moved, pose, motion = _moved(OPTICAL, seconds)
    count = len(time)
    given = pose if occluded is None else pose | {"occluded": occluded}
    tracker = _run(
        optical_tracker.MODEL, OPTICAL, "tracker", count, given, seed=seed, occlusion_rate=0.0
    )
    imu = _run(gyro_imu.MODEL, OPTICAL, "imu", count, motion, seed=seed + 1)
    sensed = {n: tracker[n] for n in ("optical_attitude", "optical_new", "optical_age")}
    sensed |= {n: imu[n] for n in ("rate", "inertial_valid")}
    filtered = _run(optical_ekf.MODEL, OPTICAL, "estimator", count, sensed)
    (bias,) = (gyro_imu.Params.unpack(gyro_imu.Params.starts()).gyro_bias,)
    return OpticalRun(time, moved, tracker, imu, filtered, np.asarray(bias))


def rotation(quaternions: FloatArray) -> Rotation:
    """Return attitudes of quaternions, scalar first, (n, 4)."""
    return Rotation.from_quat(quaternions, scalar_first=True)


def total_angle(found: FloatArray, true: FloatArray) -> FloatArray:
    """Return angle between attitudes, (n,) [deg]."""
    return np.degrees((rotation(true).inv() * rotation(found)).magnitude())


def angles(quaternions: FloatArray) -> FloatArray:
    """Return roll, pitch and yaw, (n, 3) [deg]."""
    turned: FloatArray = np.degrees(rotation(quaternions).as_euler("ZYX"))[:, ::-1]
    return turned


def angle_errors(found: FloatArray, true: FloatArray) -> FloatArray:
    """Return errors of roll, pitch and yaw, (n, 3) [deg]."""
    return (angles(found) - angles(true) + 180) % 360 - 180


def rms(values: FloatArray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def overshoot(run: EmRun, error: FloatArray) -> float:
    """Return the largest error within `AFTER` of a start or a stop of the robot."""
    moving = run.robot["moving"] > 0
    edges = np.flatnonzero(np.diff(moving.astype(int))) + 1
    span = round(AFTER / T)
    return max(float(np.abs(error[k : k + span]).max()) for k in edges if run.time[k] > SETTLED)
