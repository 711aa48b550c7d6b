"""Pose estimators on BROAD: optical samples thinned, the others held back as truth (E13 3.5, 4).

| symbol | meaning |
| --- | --- |
| steps | inertial samples since the last optical one (E13 3.5.1.2) |
| error of position | length of the difference, 3-D [m] |
| error of attitude | angle between estimate and truth [rad] |

Causal, one set of parameters for all trials: `SETTINGS`, chosen on those trials that come with the
project's checks. Lever arm, lags, biases, scale, misalignment and gravity are states and start from
zero, or from what is usual.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fmu_src.kit.model import Model
from fmu_src.pack.compiled_runner import CompiledRunner
from harness.common.types import FloatArray
from harness.reproduce.experiments.broad import LIMITS, THINNED, BoolArray, BroadTrial, since

__all__ = ["SETTINGS", "FilteredTrial", "PoseErrors", "errors", "follow", "occlusions"]

SETTINGS: Mapping[str, float] = {
    **LIMITS,
    "gravity_sigma": 0.03,
    "inertial.rate_noise": 7e-4,
    "inertial.force_noise": 1.1e-2,
    "inertial.rate_bias_walk": 1e-4,
    "inertial.force_bias_walk": 2e-3,
    "inertial.rate_matrix_walk": 4e-4,
    "inertial.force_matrix_walk": 3e-4,
    "inertial.between": 0.3,
    "tracker.position_noise": 4.5e-5,
    "tracker.attitude_noise": 1.2e-3,
    "tracker.position_offset_sigma": 5e-4,
    "tracker.position_offset_memory": 5.0,
    "tracker.flicker_sigma": 2.5e-4,
    "tracker.flicker_memory": 0.05,
    "tracker.attitude_offset_sigma": 3e-3,
    "tracker.attitude_offset_memory": 0.17,
    "tracker.gate": 1.5,
}
"""Of `OpticalInertialEkf` and `OpticalInertialUkf`, for this inertial unit and this tracker."""


@dataclass(frozen=True)
class PoseErrors:
    """Root mean squares, one value for each number of steps or each duration.

    Attributes:
        position: [m].
        attitude: [rad].
        count: samples that each is of.
    """

    position: FloatArray
    attitude: FloatArray
    count: FloatArray


@dataclass(frozen=True)
class FilteredTrial:
    """A run over a trial.

    Attributes:
        trial: the recording.
        new: optical samples that the estimator got, (n,).
        outputs: by field, a row for each sample.
    """

    trial: BroadTrial
    new: BoolArray
    outputs: Mapping[str, FloatArray]

    def by_step(self, every: int = THINNED) -> PoseErrors:
        """Return errors of the samples that count, by steps since the last optical sample."""
        position, attitude = errors(self.trial, self.outputs)
        steps, scored = since(self.new), self.trial.scored()
        groups = [scored & (steps == k) for k in range(every)]
        return _summed([(position[g], attitude[g]) for g in groups])


def runner(
    model: Model, trial: BroadTrial, settings: Mapping[str, Any] = SETTINGS
) -> CompiledRunner:
    """Return an instance of a model, sampled as the trial is."""
    return CompiledRunner(dataclasses.replace(model, sample_period=trial.period), settings)


def follow(
    model: Model,
    trial: BroadTrial,
    every: int = THINNED,
    late: int = 0,
    settings: Mapping[str, Any] = SETTINGS,
) -> FilteredTrial:
    """Run an estimator over a trial.

    Args:
        model: with the ports of `OpticalInertialEkf`.
        trial: the recording.
        every: inertial samples to an optical one.
        late: samples after which an optical one arrives.
        settings: parameters.
    """
    new = trial.thinned(every)
    inputs = _inputs(model, trial, new, late)
    outputs = runner(model, trial, settings).run(len(trial), inputs)
    return FilteredTrial(trial, new, outputs)


def errors(
    trial: BroadTrial, outputs: Mapping[str, FloatArray], at: slice = slice(None)
) -> tuple[FloatArray, FloatArray]:
    """Return errors of position [m] and attitude [rad] of each sample of a part of a trial."""
    position = np.linalg.norm(outputs["position"] - trial.position[at], axis=1)
    turned = _rotation(outputs["attitude"]).inv() * _rotation(trial.attitude[at])
    return np.asarray(position), np.asarray(turned.magnitude())


def occlusions(
    model: Model,
    trial: BroadTrial,
    durations: Sequence[float],
    every: int = THINNED,
    stride: int = 1,
    settings: Mapping[str, Any] = SETTINGS,
) -> PoseErrors:
    """Return errors at the end of occlusions that begin after an optical sample, at each of them.

    Args:
        model: with the ports of `OpticalInertialEkf`.
        trial: the recording.
        durations: of the occlusions [s].
        every: inertial samples to an optical one.
        stride: of the optical samples, at each so many of which an occlusion begins.
        settings: parameters.
    """
    instance = runner(model, trial, settings)
    new, scored = trial.thinned(every), trial.scored()
    inputs = _inputs(model, trial, new, 0)
    blind = {**inputs, "optical_new": np.zeros(len(trial))}
    lengths = [round(duration / trial.period) for duration in durations]
    places = np.flatnonzero(new & scored)
    places = places[places + max(lengths) < len(trial)][::stride]
    found: list[list[tuple[float, float]]] = [[] for _ in lengths]
    at = 0
    for place in places.tolist():
        _run(instance, inputs, at, place + 1)
        at, state = place + 1, instance.x.copy()
        position, attitude = errors(
            trial, _run(instance, blind, at, at + max(lengths)), slice(at, at + max(lengths))
        )
        instance.x[:] = state
        for length, list_ in zip(lengths, found, strict=True):
            if scored[place + length]:
                list_.append((position[length - 1], attitude[length - 1]))
    pairs = [np.array(list_).reshape(-1, 2).T for list_ in found]
    return _summed([(pair[0], pair[1]) for pair in pairs])


def _run(
    instance: CompiledRunner, inputs: Mapping[str, FloatArray], begin: int, end: int
) -> dict[str, FloatArray]:
    return instance.run(end - begin, {name: value[begin:end] for name, value in inputs.items()})


def _inputs(model: Model, trial: BroadTrial, new: BoolArray, late: int) -> dict[str, FloatArray]:
    """Return the signals of a trial that an estimator has ports for."""
    given = {**trial.inertial(), **trial.optical(new, late)}
    return {name: value for name, value in given.items() if name in model.inputs.fields}


def _summed(groups: Sequence[tuple[FloatArray, FloatArray]]) -> PoseErrors:
    squares = [[float(np.sqrt(np.mean(part**2))) for part in pair] for pair in groups]
    position, attitude = np.array(squares).T
    return PoseErrors(position, attitude, np.array([len(pair[0]) for pair in groups]))


def _rotation(quaternion: FloatArray) -> Rotation:
    return Rotation.from_quat(quaternion, scalar_first=True)
