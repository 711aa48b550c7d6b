"""The protocol of A04 5.3.3 on recorded hands: trained on one trial, tested on the hand's others.

    thesis                                            here
    15 files of four surgeons, 1-D, 16 s, 250 Hz      a trial is one axis of the last 16 s of a
                                                      recording of holding on a point, 250 Hz
    held still in a mannequin's eye: all is error     held on a point: all about the mean is error
    motion: white noise below 1 Hz, its rms the       the same
    mean rms error of all files
    one motion to train with, one to test with        one in each epoch; TESTS to test, mean
    trained on a file that is not told                the one whose rms is nearest the hand's mean
    best of several architectures, by the tests       the same, and one architecture for all
    reduction of the mean rmse of a surgeon's tests   the same

Where there is one recording of a hand, as in the set at hand, its trials are its three axes; more
recordings of a hand are more trials. The first seconds of a recording go: there the instrument is
still brought to the point, by up to 1.5 mm.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from fmu_src.errors import SteadytipError
from harness.identify.tremor_nn.cascade import (
    RATE,
    Architecture,
    Network,
    Target,
    Training,
    pseudo_motion,
    train_filter,
)
from harness.identify.tremor_nn.fit import FilterScore, score
from harness.identify.tremor_nn.read import StillTrial, at_rate
from harness.recordings.motion import read_recording, recordings

SECONDS = 16.0
"""Of a trial (A04 5.3.3) [s]."""
GRID = (25, 50, 75)
"""Inputs of the architectures that are tried, each with all numbers of hidden units."""
HIDDEN = 6
"""As many as the best of the thesis have (A04 table 5.1)."""
ONE_FOR_ALL = Architecture(50, HIDDEN)
AS_PRINTED = Architecture(75, HIDDEN, 1)
"""Inputs at the rate of the recordings, as in the thesis's table 5.1."""
PRINTED_TRAINING = Training(epochs=1, spread=0.0, turned=False, every=4)
"""One motion, the error as it was recorded."""
CEILING_MOTIONS = 10
RIDGE = 1e-2
"""Of a linear filter's inputs, over the power of the motion."""
_NAME = re.compile(r"^(?P<group>[A-Z])_pointing.*_(?P<hand>[a-z]+)(?P<trial>\d+)$")
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Hand:
    """Trials of one person.

    Attributes:
        name: as the recordings have it, `S de`: surgeon or novice, and who.
        trials: all of them.
    """

    name: str
    trials: tuple[StillTrial, ...]

    @property
    def chosen(self) -> int:
        """Trial that is trained on: the rms nearest to the mean of them."""
        levels = np.array([trial.rms for trial in self.trials])
        return int(np.argmin(np.abs(levels - levels.mean())))

    @property
    def trained(self) -> StillTrial:
        """Trial that is trained on."""
        return self.trials[self.chosen]

    @property
    def tests(self) -> tuple[StillTrial, ...]:
        """Motions to test on: all others."""
        return self.trials[: self.chosen] + self.trials[self.chosen + 1 :]


@dataclass(frozen=True)
class BestNetwork:
    """The best network of a hand.

    Attributes:
        network: which.
        score: on the hand's tests.
    """

    network: Network
    score: FilterScore


@dataclass(frozen=True)
class Protocol:
    """All hands, and what has been trained for them.

    Attributes:
        hands: two at least.
    """

    hands: tuple[Hand, ...]
    _trained: dict[tuple[str, Architecture, Training, Target], Network] = field(
        default_factory=dict, repr=False
    )

    @cached_property
    def rms(self) -> float:
        """Rms of the motions that are made up: the mean of all trials' [m]."""
        return float(np.mean([trial.rms for hand in self.hands for trial in hand.trials]))

    def network(
        self,
        hand: Hand,
        architecture: Architecture = ONE_FOR_ALL,
        training: Training | None = None,
        target: Target = "motion",
    ) -> Network:
        """Train the network of a hand on its one trial, unless that has been done."""
        how = training or Training()
        key = (hand.name, architecture, how, target)
        if key not in self._trained:
            self._trained[key] = train_filter(
                [hand.trained.error], self.rms, architecture, how, target
            )
        return self._trained[key]

    def score(self, network: Network, trials: Sequence[StillTrial]) -> FilterScore:
        """Score a network on some trials."""
        return score(network, [trial.error for trial in trials], self.rms)

    def best(self, hand: Hand) -> BestNetwork:
        """Return the best architecture of a hand by its tests, as the thesis chooses."""
        found = []
        for inputs in GRID:
            network = self.network(hand, Architecture(inputs, HIDDEN))
            for hidden in range(HIDDEN + 1):
                cut = network.cut(hidden)
                found.append(BestNetwork(cut, self.score(cut, hand.tests)))
        return max(found, key=lambda best: best.score.reduction)

    def ceiling(self, hand: Hand, architecture: Architecture = ONE_FOR_ALL) -> float:
        """Fit a linear filter to the very tests that it is scored on; return its reduction [%]."""
        zeta, wanted = [], []
        for k, trial in enumerate(hand.tests):
            for draw in range(CEILING_MOTIONS):
                motion = pseudo_motion(len(trial.error), self.rms, np.random.default_rng((k, draw)))
                zeta.append(architecture.windows(motion + trial.error, 10) / self.rms)
                wanted.append(motion[architecture.lead :: 10] / self.rms)
        u, t = np.concatenate(zeta), np.concatenate(wanted)
        gram = u.T @ u / len(t) + RIDGE * np.eye(architecture.inputs)
        weights = np.append(np.linalg.solve(gram, u.T @ t / len(t)), 0.0)
        linear = Network(architecture, self.rms, (), (weights,), (0.0,))
        return self.score(linear, hand.tests).reduction


@cache
def protocol(folder: Path) -> Protocol:
    """Read the hands of the recordings in a folder that are of holding on a point.

    Raises:
        SteadytipError: fewer than two hands, or a recording that is too short.
    """
    count = round(SECONDS * RATE)
    found: dict[str, list[StillTrial]] = {}
    for path in recordings([folder]):
        name = _NAME.match(path.stem)
        if name is None:
            continue
        position = at_rate(read_recording(path))
        if len(position) < count:
            raise SteadytipError(
                f"recording {path} lasts {len(position) / RATE:.3g} s, and a trial is {SECONDS:g} s"
            )
        for axis, values in zip("xyz", position[-count:].T, strict=True):
            trial = StillTrial(f"{name['hand']}{name['trial']} {axis}", values - values.mean())
            found.setdefault(f"{name['group']} {name['hand']}", []).append(trial)
    if len(found) < 2:
        raise SteadytipError(
            f"{folder} holds recordings of {len(found)} hands on a point "
            "(S_pointing..._de02.csv), and two are needed"
        )
    return Protocol(tuple(Hand(name, tuple(trials)) for name, trials in found.items()))
