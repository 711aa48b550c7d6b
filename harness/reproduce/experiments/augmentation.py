"""Experiments of E13 chapters 3 and 4: an optical tracker's rate augmented by an inertial unit.

| symbol | meaning |
| --- | --- |
| ratio | inertial samples to an optical one (E13's FAR) |
| step | inertial samples since the last optical one (E13 3.5.1.2); 0 at it |
| population | all errors of one step (E13 fig. 3.8) |
| 95 % | half the interval about zero that holds so many of the errors of an axis |

Three kinds of motion are followed. E13's own simulation (3.5.1.1): differences of a random path,
and noise. A hand that moves as in E13 3.5.1.2, seen by the plants `OpticalTracker` and `GyroImu`,
which share nothing with the filters. And BROAD, recorded. Errors are those of every sample that
counts, along axis y of the world as in E13, or of the length; angles are those of the rotation from
truth to estimate, in the world.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from fmu_src.errors import SteadytipError
from fmu_src.pack.compiled_runner import CompiledRunner
from fmu_src.pack.discovery import load_model
from harness.common.types import FloatArray
from harness.reproduce.experiments.broad import (
    FOLDER,
    LIMITS,
    TRIALS,
    BoolArray,
    BroadTrial,
    read_trial,
    since,
)
from harness.reproduce.experiments.pose import SETTINGS
from harness.reproduce.item import Context

__all__ = [
    "E13",
    "FILTERS",
    "SETTINGS_E13",
    "Populations",
    "RecordedTrack",
    "broad_trials",
    "category",
    "errors_by_step",
    "estimate",
    "extrapolate",
    "occluded_errors",
    "recorded",
    "simulated",
    "speeds",
    "stretch",
    "windows",
]

PERIOD = 5e-3
"""Of the inertial samples (E13 3.5.1) [s]."""
GRAVITY = 9.80131
SETTLE = 10.0
"""Before each acquisition, in which a filter may learn; not counted [s]."""
E13 = "OpticalPoseUkf"
FILTERS = ("OpticalInertialUkf", "OpticalInertialEkf", E13)
TRACKER_ALONE = "tracker alone, constant velocity"
AXIS = 1
"""y, which E13 shows."""
SETTINGS_E13: Mapping[str, Any] = {
    "jerk": 100.0,
    "angular_acceleration": 30.0,
    "rate_noise": 0.02,
    "force_noise": 0.2,
    "position_noise": 1e-4,
    "attitude_noise": 1e-3,
    "gravity": 9.813,
    "gate": 1e6,
    **LIMITS,
}
"""Of E13's filter on BROAD: found by trying, as E13 did; it has no gate."""
_SHEET: Mapping[str, Any] = {
    "inertial.rate_noise": np.radians(0.01),
    "inertial.force_noise": 3e-3,
    "inertial.between": 0.05,
    "tracker.position_noise": 7e-5,
    "tracker.attitude_noise": 2e-3,
    "tracker.position_offset_sigma": 0.0,
    "tracker.attitude_offset_sigma": 0.0,
    "gravity_sigma": 0.02,
}
"""Of our filters on the simulated hand: data sheets of unit and tracker."""
_SHEET_E13: Mapping[str, Any] = {
    "jerk": 10.0,
    "angular_acceleration": 5.0,
    "rate_noise": 5e-3,
    "force_noise": 0.05,
    "position_noise": 7e-5,
    "attitude_noise": 2e-3,
    "gate": 1e6,
}
_EXACT: Mapping[str, Any] = {
    "inertial.rate_noise": 1e-4,
    "inertial.force_noise": 0.1 / 3 * np.sqrt(2 * PERIOD),
    "inertial.between": 0.05,
    "tracker.position_noise": 1e-5,
    "tracker.attitude_noise": 1e-4,
    "tracker.position_offset_sigma": 0.0,
    "tracker.attitude_offset_sigma": 0.0,
    "mounting.lever_sigma": 0.0,
    "mounting.rotation_sigma": 0.0,
    "mounting.lag_sigma": 0.0,
    "inertial.rate_bias_sigma": 0.0,
    "inertial.force_bias_sigma": 0.0,
    "inertial.rate_matrix_sigma": 0.0,
    "inertial.force_matrix_sigma": 0.0,
    "gravity_sigma": 0.0,
}
"""Of our filters on E13's simulation: nothing is to be learnt."""
_EXACT_E13: Mapping[str, Any] = {
    "jerk": 10.0,
    "angular_acceleration": 5.0,
    "rate_noise": 1e-3,
    "force_noise": 0.1 / 3,
    "position_noise": 1e-5,
    "attitude_noise": 1e-4,
    "gate": 1e6,
}


@dataclass(frozen=True)
class RecordedTrack:
    """One acquisition; every array has one row for each inertial sample.

    Attributes:
        name: for people.
        kind: "exact", "hand" or "recorded": which settings the filters get.
        period: of the samples [s].
        ratio: inertial samples to an optical one.
        position: true, (n, 3) [m].
        attitude: true, q_WB, (n, 4).
        counted: samples that count, (n,).
        new: at which instants an optical sample arrives, (n,).
        inputs: of an estimator, by field.
    """

    name: str
    kind: str
    period: float
    ratio: int
    position: FloatArray
    attitude: FloatArray
    counted: BoolArray
    new: BoolArray
    inputs: Mapping[str, FloatArray]

    @property
    def time(self) -> FloatArray:
        """Times of the samples, (n,) [s]."""
        return np.asarray(self.period * np.arange(len(self.position)))

    def until(self, end: int) -> RecordedTrack:
        """Return the motion's first samples alone."""
        return replace(
            self,
            position=self.position[:end],
            attitude=self.attitude[:end],
            counted=self.counted[:end],
            new=self.new[:end],
            inputs={name: values[:end] for name, values in self.inputs.items()},
        )

    def occluded(self, *intervals: tuple[int, int]) -> RecordedTrack:
        """Return the motion without the optical samples in some intervals [first, end)."""
        new = self.new.copy()
        for first, end in intervals:
            new[first:end] = False
        return replace(self, new=new, inputs={**self.inputs, "optical_new": new.astype(float)})


@dataclass(frozen=True)
class Populations:
    """Errors of the samples that count, by step.

    Attributes:
        steps: of each sample, (n,).
        position: in W, (n, 3) [m].
        attitude: rotation vector in W, (n, 3) [rad].
    """

    steps: np.ndarray
    position: FloatArray
    attitude: FloatArray

    @staticmethod
    def together(parts: Iterable[Populations]) -> Populations:
        """Join the errors of several acquisitions."""
        parts = list(parts)
        return Populations(
            np.concatenate([part.steps for part in parts]),
            np.vstack([part.position for part in parts]),
            np.vstack([part.attitude for part in parts]),
        )

    def rms(self, what: str, axis: int | None = AXIS) -> FloatArray:
        """Return the rms of each step: along one axis, or of the length if `axis` is None."""
        return self._each(what, axis, lambda e: float(np.sqrt(np.mean(e**2))))

    def interval(self, what: str, axis: int | None = AXIS) -> FloatArray:
        """Return the size that 95 % of the errors of each step are below."""
        return self._each(what, axis, lambda e: float(np.percentile(np.abs(e), 95)))

    def _each(self, what: str, axis: int | None, of: Callable[[FloatArray], float]) -> FloatArray:
        vectors = getattr(self, what)
        sizes = np.linalg.norm(vectors, axis=1) if axis is None else vectors[:, axis]
        return np.array([of(sizes[self.steps == k]) for k in range(int(self.steps.max()) + 1)])


def errors(
    motion: RecordedTrack, outputs: Mapping[str, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return errors in W of each sample: position (n, 3) [m], rotation vector (n, 3) [rad]."""
    turned = _rotation(outputs["attitude"]) * _rotation(motion.attitude).inv()
    return outputs["position"] - motion.position, turned.as_rotvec()


def errors_by_step(name: str, motion: RecordedTrack) -> Populations:
    """Return errors of a filter, or of the tracker alone, by step; as many steps as the ratio."""
    position, attitude = errors(motion, estimate(name, motion))
    steps = since(motion.new)
    kept = motion.counted & (steps >= 0) & (steps < motion.ratio)
    return Populations(steps[kept], position[kept], attitude[kept])


def estimate(name: str, motion: RecordedTrack) -> Mapping[str, FloatArray]:
    """Return outputs of one of FILTERS, or of ALONE, over a motion."""
    if name == TRACKER_ALONE:
        return extrapolate(motion)
    settings = {
        "recorded": (SETTINGS, SETTINGS_E13),
        "hand": (_SHEET, _SHEET_E13),
        "exact": (_EXACT, _EXACT_E13),
    }[motion.kind][name == E13]
    model = replace(load_model(name), sample_period=motion.period)
    given = {key: value for key, value in motion.inputs.items() if key in model.inputs.fields}
    return CompiledRunner(model, settings).run(len(motion.position), given)


def extrapolate(motion: RecordedTrack) -> dict[str, FloatArray]:
    """Extrapolate each optical sample with the velocity and rate between the last two."""
    at = np.flatnonzero(motion.new)
    place, turned = (
        motion.inputs["optical_position"][at],
        _rotation(motion.inputs["optical_attitude"][at]),
    )
    span = np.diff(at)
    velocity = np.vstack([np.zeros(3), np.diff(place, axis=0) / span[:, np.newaxis]])
    turn = (turned[:-1].inv() * turned[1:]).as_rotvec() / span[:, np.newaxis]
    rate = np.vstack([np.zeros(3), turn])
    steps = since(motion.new)
    last = np.maximum(np.searchsorted(at, np.arange(len(steps)), side="right") - 1, 0)
    ahead = np.maximum(steps, 0)[:, np.newaxis]
    attitude = turned[last] * Rotation.from_rotvec(ahead * rate[last])
    return {
        "position": place[last] + ahead * velocity[last],
        "attitude": attitude.as_quat(scalar_first=True),
    }


def recorded(
    context: Context, ratio: int, names: Sequence[str] = TRIALS[:3]
) -> list[RecordedTrack]:
    """Return trials of BROAD as motions; none where there are no recordings."""
    return [_of_trial(trial, ratio) for trial in broad_trials(context, names)]


def broad_trials(context: Context, names: Sequence[str] = TRIALS[:3]) -> list[BroadTrial]:
    """Return trials of BROAD; none where there are no recordings."""
    if context.data is None or not (context.data / FOLDER).is_dir():
        return []
    return [_trial(context.data / FOLDER / f"{name}.mat") for name in names]


@cache
def _trial(path: Path) -> BroadTrial:
    return read_trial(path)


def _of_trial(trial: BroadTrial, ratio: int) -> RecordedTrack:
    new = trial.thinned(ratio)
    inputs = {**trial.inertial(), **trial.optical(new)}
    name = f"trial {trial.name[:2]}"
    return RecordedTrack(
        name,
        "recorded",
        trial.period,
        ratio,
        trial.position,
        trial.attitude,
        trial.scored(),
        new,
        inputs,
    )


def simulated(seed: int, ratio: int = 10, seconds: float = 10.0) -> RecordedTrack:
    """Simulate E13 3.5.1.1: speed 150 mm/s in the mean, 300 at the most; 20 and 70 deg/s about y.

    Acceleration and rate are central differences of the path; Gaussian noise of at most 100 mm/s2,
    taken for three standard deviations, is on the acceleration. Nothing else is wrong.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds / PERIOD)
    t = np.arange(-1.0, n + 1) * PERIOD
    place = _random_path(rng, t)
    a = np.diff(place, 2, axis=0) / PERIOD**2 + rng.normal(size=(n, 3)) * 0.1 / 3
    # sin^7 has the ratio of mean to largest rate.
    rate = np.radians(70.0) * np.sin(2 * np.pi * t / rng.uniform(3.0, 6.0)) ** 7
    angle = np.cumsum(rate) * PERIOD
    turned = Rotation.from_rotvec(angle[:, np.newaxis] * [0.0, 1.0, 0.0])
    w = (turned[:-2].inv() * turned[2:]).as_rotvec() / (2 * PERIOD)
    position, rotation = place[1:-1], turned[1:-1]
    attitude = rotation.as_quat(scalar_first=True)
    new = np.arange(n) % ratio == 0
    inputs = {
        "rate": w,
        "force": rotation.inv().apply(a + np.array([0.0, 0.0, GRAVITY])),
        "inertial_valid": np.ones(n),
        "optical_position": position,
        "optical_attitude": attitude,
        "optical_new": new.astype(float),
        "optical_age": np.zeros(n),
    }
    # As E13 3.62, without the first ten optical samples.
    counted = np.arange(n) >= 10 * ratio
    return RecordedTrack(
        f"path {seed}", "exact", PERIOD, ratio, position, attitude, counted, new, inputs
    )


def _random_path(rng: np.random.Generator, t: FloatArray) -> FloatArray:
    """Return a path (n, 3) [m] of mean speed 0.15 m/s and largest 0.3, within 3 %."""
    while True:
        waves = 2 * np.pi * rng.uniform(0.1, 1.0, (3, 5))
        phase, size = rng.uniform(0, 2 * np.pi, (3, 5)), rng.normal(size=(3, 5)) / waves
        argument = waves[..., np.newaxis] * t + phase[..., np.newaxis]
        place = (size[..., np.newaxis] * np.sin(argument)).sum(axis=1).T
        velocity = ((size * waves)[..., np.newaxis] * np.cos(argument)).sum(axis=1)
        speed = np.linalg.norm(velocity, axis=0)
        if abs(speed.max() / speed.mean() - 2.0) < 0.06:
            return np.asarray(place * 0.15 / speed.mean())


CATEGORIES = {1: (0.04, 0.10), 2: (0.10, 0.33)}
"""Mean and largest speed of E13's categories [m/s] (E13 table 3.1)."""
SIDE = 0.2
"""Of the squares [m]."""


def category(number: int, seed: int, ratio: int = 10, seconds: float = 10.0) -> RecordedTrack:
    """Move a hand along a square (E13 3.5.1.2), with tremor, seen by tracker and inertial unit.

    Each side is a movement of least jerk; the shortest has the category's largest speed. Angles
    swing about all axes, with 20 deg/s in the mean and some 50 at the most. Tremor is 50 um p-p of
    each axis at 8 to 12 Hz.

    Args:
        number: of the category.
        seed: of path, noise, and the unit's own errors.
        ratio: inertial samples to an optical one.
        seconds: that count, after SETTLE.
    """
    rng = np.random.default_rng(1000 * number + seed)
    duration = SETTLE + seconds
    n = round(duration / PERIOD)
    t = np.arange(float(n)) * PERIOD
    place, acceleration = _square(rng, t, *CATEGORIES[number])
    tremor = 2 * np.pi * rng.uniform(8, 12, 3)
    shake = 25e-6 * np.sin(np.outer(t, tremor) + rng.uniform(0, 6, 3))
    knots = np.arange(0, duration + 0.2, 0.1)
    swings = 2 * np.pi * rng.uniform(0.15, 0.5, 3)
    size = np.radians(20.0) / swings * rng.uniform(0.7, 1.1, 3)
    # Now quick, now slow: the largest rate is well above the mean.
    slow = 2 * np.pi * 0.1
    warped = knots + 0.7 / slow * np.sin(slow * knots)
    angles = size * np.sin(np.outer(warped, swings) + rng.uniform(0, 6, 3))
    spline = RotationSpline(knots, Rotation.from_euler("xyz", angles))
    attitude = spline(t).as_quat(scalar_first=True)
    body = place + shake
    motion = {"body": body, "attitude": attitude}
    imu = replace(load_model("GyroImu"), sample_period=PERIOD)
    sensed = CompiledRunner(
        imu, {"seed": seed, "sample_rate": 1 / PERIOD, "gyro_delay": 3e-3, **_unit(rng)}
    ).run(
        n,
        {
            **motion,
            "body_acceleration": acceleration - tremor**2 * shake,
            "body_rate": spline(t, 1),
            "angular_acceleration": spline(t, 2),
        },
    )
    tracker = replace(load_model("OpticalTracker"), sample_period=PERIOD)
    seen = CompiledRunner(
        tracker, {"seed": seed, "rate": 1 / (ratio * PERIOD), "latency": 0.0}
    ).run(n, motion)
    inputs = {**sensed, **seen}
    new = seen["optical_new"] > 0
    name = f"category {number}, acquisition {seed}"
    return RecordedTrack(name, "hand", PERIOD, ratio, body, attitude, t >= SETTLE, new, inputs)


def _unit(rng: np.random.Generator) -> dict[str, Any]:
    """Return biases of an inertial unit of its own kind."""
    return {
        "gyro_bias": np.radians(0.4) * rng.normal(size=3),
        "accelerometer_bias": 0.02 * rng.normal(size=3),
    }


def _square(
    rng: np.random.Generator, t: FloatArray, mean: float, largest: float
) -> tuple[FloatArray, FloatArray]:
    """Return place and acceleration, (n, 3) each, along the sides of a tilted square."""
    duration = t[-1] + PERIOD
    count = round(mean * duration / SIDE)
    shortest = 1.875 * SIDE / largest
    left = duration - count * shortest
    share = rng.dirichlet(np.full(count - 1, 4.0))
    times = shortest + left * np.insert(share, rng.integers(count), 0.0)
    starts = np.insert(np.cumsum(times), 0, 0.0)
    plane = Rotation.random(random_state=int(rng.integers(2**31)))
    corners = SIDE * (np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) - 0.5)
    side = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, count - 1)
    s = ((t - starts[side]) / times[side])[:, np.newaxis]
    begin, end = corners[side % 4], corners[(side + 1) % 4]
    way = 10 * s**3 - 15 * s**4 + 6 * s**5
    bend = (60 * s - 180 * s**2 + 120 * s**3) / times[side, np.newaxis] ** 2
    return plane.apply(begin + (end - begin) * way), plane.apply((end - begin) * bend)


def speeds(motion: RecordedTrack) -> tuple[float, float, float, float]:
    """Return mean and largest speed [m/s] and rate [rad/s] of what counts.

    By differences over five samples; the 99.9th percentile counts as the largest.
    """
    samples_apart = 5
    span = samples_apart * motion.period
    moved = (
        np.linalg.norm(motion.position[samples_apart:] - motion.position[:-samples_apart], axis=1)
        / span
    )
    turned = _rotation(motion.attitude)
    rate = (turned[:-samples_apart].inv() * turned[samples_apart:]).magnitude() / span
    counted = motion.counted[samples_apart:] & motion.counted[:-samples_apart]
    found = [f(v[counted]) for v in (moved, rate) for f in (np.mean, _largest)]
    return float(found[0]), float(found[1]), float(found[2]), float(found[3])


def _largest(values: FloatArray) -> float:
    return float(np.percentile(values, 99.9))


def stretch(motion: RecordedTrack, seconds: float) -> slice:
    """Return the first part of a motion of which every sample counts.

    Raises:
        SteadytipError: there is none as long as that.
    """
    length = round(seconds / motion.period)
    counts = np.convolve(motion.counted, np.ones(length), "valid")
    places = np.flatnonzero(counts > length - 0.5)
    if not len(places):
        raise SteadytipError(f"{motion.name}: no {seconds:g} s of which every sample counts")
    return slice(int(places[0]), int(places[0]) + length)


def windows(motion: RecordedTrack, samples: int = 100, count: int = 9) -> list[tuple[int, int]]:
    """Return successive occlusions over what counts, each of its own run (E13 fig. 3.9)."""
    first = stretch(motion, samples * count * motion.period).start
    starts = first + samples * np.arange(count)
    return [(int(start), int(start) + samples) for start in starts]


def occluded_errors(name: str, motions: Iterable[RecordedTrack], samples: int = 100) -> Populations:
    """Return errors by samples since an occlusion began, of all windows of all motions."""
    parts = []
    for motion in motions:
        for first, end in windows(motion, samples):
            blind = motion.until(end).occluded((first, end))
            position, attitude = errors(blind, estimate(name, blind))
            parts.append(Populations(np.arange(samples), position[first:end], attitude[first:end]))
    return Populations.together(parts)


def _rotation(quaternion: FloatArray) -> Rotation:
    return Rotation.from_quat(quaternion, scalar_first=True)
