"""Training of the cascade neural filter on recordings, and its scores.

A trial is one axis of a recording, about the place that was held, which is its mean. The person
tried to hold still, so all of it is error. The filter gets that error on a motion that is made up,
and has to return that motion (see `cascade`). Reductions are of the rms error,
`1 - rms(m - v) / rms(s - v)`, from the sample on at which the window is full, on motions that no
training has seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmu_src.kit.runner import Runner
from fmu_src.tremor.cascade_neural import MODEL
from harness.common.types import FloatArray
from harness.identify.options import Progress
from harness.identify.parameter_files import write_parameters
from harness.identify.tremor_nn.cascade import (
    Architecture,
    Network,
    Training,
    pseudo_motion,
    train_filter,
)
from harness.identify.tremor_nn.read import StillTrial

__all__ = [
    "FilterEvaluation",
    "FilterScore",
    "evaluate",
    "score",
    "unseen_motion",
    "write_network",
]

TESTS = 4
"""Motions on which a network is tested."""
_UNSEEN = 7919
"""First number of the seeds of motions that no training makes up."""


@dataclass(frozen=True)
class FilterScore:
    """A filter on some trials, mean over the motions.

    Attributes:
        raw: rms error of each trial before the filter [m].
        filtered: the same after it [m].
    """

    raw: FloatArray
    filtered: FloatArray

    @property
    def reduction(self) -> float:
        """Reduction of the mean rms error [%] (A04 table 5.2)."""
        return 100.0 * float(1.0 - self.filtered.mean() / self.raw.mean())


def score(network: Network, errors: Sequence[FloatArray], rms: float, seed: int = 0) -> FilterScore:
    """Score a network on some errors, as a mean over TESTS motions.

    Args:
        network: a filter.
        errors: errors of each trial, (n,) [m], longer than the window.
        rms: rms of the motions [m].
        seed: seed of the motions, which no training sees.
    """
    lead = network.architecture.lead
    raw = np.array([np.sqrt(np.mean(error[lead:] ** 2)) for error in errors])
    left = np.zeros((TESTS, len(errors)))
    for test in range(TESTS):
        for k, error in enumerate(errors):
            motion = unseen_motion(len(error), rms, seed, test)
            found = network.filtered(motion + error)
            left[test, k] = np.sqrt(np.mean((found - motion[lead:]) ** 2))
    return FilterScore(raw, left.mean(axis=0))


def unseen_motion(samples: int, rms: float, seed: int, test: int) -> FloatArray:
    """Make a motion that no training sees, the same for all trials, (samples,) [m].

    Args:
        samples: number of samples.
        rms: rms of the motion [m].
        seed: seed of the tests.
        test: number of the test.
    """
    return pseudo_motion(samples, rms, np.random.default_rng((_UNSEEN, seed, test)))


@dataclass(frozen=True)
class FilterEvaluation:
    """A network on the trials that it was trained on and on others.

    Attributes:
        network: with all hidden units.
        trials: all trials, without those too short for the window.
        rms: rms of the motions that are made up [m].
        scores: scores by role, for each number of hidden units from none on.
    """

    network: Network
    trials: tuple[StillTrial, ...]
    rms: float
    scores: dict[str, tuple[FilterScore, ...]]

    def trials_of(self, role: str) -> list[StillTrial]:
        """Return the trials of a role."""
        return [trial for trial in self.trials if trial.role == role]


def evaluate(
    found: Sequence[StillTrial],
    architecture: Architecture,
    training: Training,
    rms: float | None = None,
    progress: Progress = lambda done, count: None,
) -> FilterEvaluation:
    """Train a network and test it.

    Args:
        found: trials; those with the role `trained` are trained on.
        architecture: size of the network.
        training: settings of the training.
        rms: rms of the motions that are made up [m]; the mean of the trials trained on by default,
            as in the thesis.
        progress: takes the steps done.

    Raises:
        SteadytipError: trials at rest, or too short to train on.
    """
    trained = [trial for trial in found if trial.role == "trained"]
    level = float(np.mean([trial.rms for trial in trained])) if rms is None else rms
    network = train_filter(
        [trial.error for trial in trained],
        level,
        architecture,
        training,
        progress=progress,
        names=[f"recording {trial.name}" for trial in trained],
    )
    long_enough = tuple(trial for trial in found if len(trial.error) > architecture.lead)
    scores = {}
    for role in dict.fromkeys(trial.role for trial in long_enough):
        errors = [trial.error for trial in long_enough if trial.role == role]
        scores[role] = tuple(
            score(network.cut(k), errors, level, training.seed)
            for k in range(architecture.hidden + 1)
        )
    return FilterEvaluation(network, long_enough, level, scores)


def write_network(path: Path, network: Network) -> Path:
    """Write a network as a parameter file for `CascadeNeural`, without the place that is held.

    Raises:
        ProblemsError: the model would refuse values.
        SteadytipError: the file cannot be written.
    """
    scalars = [s for s in MODEL.parameters.scalars() if not s.name.startswith("origin[")]
    values = Runner(MODEL, network.parameters()).p.tolist()
    names = [scalar.name for scalar in MODEL.parameters.scalars()]
    found = dict(zip(names, values, strict=True))
    refusal = "the recordings do not suit the model (is their unit right?)"
    return write_parameters(path, scalars, found, refusal)
