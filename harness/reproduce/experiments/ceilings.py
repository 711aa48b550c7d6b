"""Linear filters that know the recordings: upper limits to rank tremor filters against.

    y[k] = sum_i w_i (x[k - d - i s] - x[k - d - (i + 1) s]),  i = 0..n-1

A finite impulse response of n taps, s samples apart, on the differences of the position of one
axis, d samples ago: nothing of a resting position passes. Its weights are those of least squares
against the target t (see `tremor`): a Wiener filter. There are three of them, by what they have
been trained on; no filter that has to learn while it runs gets to see as much:

- the very data that are scored: what no linear filter with these lags and fixed weights exceeds,
  a-posteriori;
- the first TRAINED of the same recording, scored on the rest, so that it has not seen those;
- all other recordings, each axis of each by its own size of tremor.

Taps are a sample of the recordings apart. A filter with taps of 1 ms, which has nothing else to
gain, solves for the next sample of the recording in the spline that goes through it, and scores as
if it looked ahead by those 4 ms: what it has more than the others is an artefact of interpolation.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.signal import oaconvolve

from harness.reproduce.experiments.tremor import RATE, FilterScores, TipMotion, score

SAME_DATA = "linear, fitted to the data themselves"
SAME_RECORDING = "linear, trained on the first 60 %"
OTHERS = "linear, trained on other recordings"
EAGER = "linear, lags of 1 ms, reading ahead"
TRAINED = 0.6
"""Share of a recording."""
RIDGE = 1e-6
"""Of the mean eigenvalue. A hundred times more or less changes nothing: recordings have noise."""


@dataclass(frozen=True)
class Lags:
    """Places of a filter's taps.

    Attributes:
        taps: n.
        stride: s, samples from one to the next.
        rows: samples from one equation to the next.
    """

    taps: int
    stride: int
    rows: int

    def differences(self, motion: TipMotion) -> np.ndarray:
        """Return differences of the position, none before there are two, (n, 3) [m]."""
        x = motion.position
        change = np.zeros_like(x)
        change[self.stride :] = x[self.stride :] - x[: -self.stride]
        return change

    @property
    def span(self) -> int:
        """Samples that the taps reach back."""
        return self.taps * self.stride


COARSE = Lags(125, 4, 4)
"""0.5 s, as far apart as the samples of the recordings, as are the equations."""
FINE = Lags(500, 1, 3)
"""The same, as far apart as the samples of the bench; equations at all places between recorded."""


@dataclass(frozen=True)
class Moments:
    """Normal equations of each axis, in units of the target's power.

    Attributes:
        gram: (3, n, n).
        cross: (3, n).
    """

    gram: np.ndarray
    cross: np.ndarray

    def __add__(self, other: "Moments") -> "Moments":
        return Moments(self.gram + other.gram, self.cross + other.cross)

    def weights(self) -> np.ndarray:
        """Return the weights of least squares, (3, n)."""
        taps = self.gram.shape[-1]
        return np.array(
            [
                cho_solve(cho_factor(gram + RIDGE * np.trace(gram) / taps * np.eye(taps)), cross)
                for gram, cross in zip(self.gram, self.cross, strict=True)
            ]
        )


def moments(motion: TipMotion, part: slice, delay: float = 0.0, lags: Lags = COARSE) -> Moments:
    """Return normal equations of some samples.

    Args:
        motion: recorded.
        part: samples whose targets count, where all taps are filled.
        delay: of the output [s].
        lags: where the taps are.
    """
    late = round(delay * RATE)
    rows = np.arange(max(part.start, lags.span + late), part.stop, lags.rows)
    places = rows[:, None] - late - lags.stride * np.arange(lags.taps)
    change, target = lags.differences(motion), motion.target[rows]
    gram, cross = [], []
    for axis in range(3):
        taps, wanted = change[places, axis], target[:, axis]
        power = wanted @ wanted
        gram.append(taps.T @ taps / power)
        cross.append(wanted @ taps / power)
    return Moments(np.array(gram), np.array(cross))


def filtered(
    motion: TipMotion, weights: np.ndarray, delay: float = 0.0, lags: Lags = COARSE
) -> np.ndarray:
    """Return y, what a linear filter takes for tremor, (n, 3) [m].

    Args:
        motion: recorded.
        weights: (3, n).
        delay: of the output [s].
        lags: where the taps are.
    """
    late = round(delay * RATE)
    change = lags.differences(motion)
    columns = []
    for axis in range(3):
        response = np.zeros(late + lags.span)
        response[late :: lags.stride] = weights[axis]
        columns.append(oaconvolve(change[:, axis], response)[: len(change)])
    return np.column_stack(columns)


def same_data(motions: Iterable[TipMotion], delay: float = 0.0) -> FilterScores:
    """Score filters that are fitted to each recording as it is scored."""
    return FilterScores(
        [
            score(motion, filtered(motion, moments(motion, motion.counted, delay).weights(), delay))
            for motion in motions
        ]
    )


def same_recording(
    motions: Iterable[TipMotion], delay: float = 0.0, lags: Lags = COARSE
) -> FilterScores:
    """Train on the first part of each recording, and score on the rest of it."""
    scores = []
    for motion in motions:
        cut = round(TRAINED * len(motion.time))
        weights = moments(motion, slice(0, cut), delay, lags).weights()
        rest = slice(cut, motion.counted.stop)
        scores.append(score(motion, filtered(motion, weights, delay, lags), rest))
    return FilterScores(scores)


def others(motions: Sequence[TipMotion], delay: float = 0.0) -> FilterScores:
    """Train on all recordings but the one that is scored; needs two at least."""
    each = [moments(motion, motion.counted, delay) for motion in motions]
    scores = []
    for k, motion in enumerate(motions):
        rest = reduce(Moments.__add__, each[:k] + each[k + 1 :])
        scores.append(score(motion, filtered(motion, rest.weights(), delay)))
    return FilterScores(scores)


def eager(motions: Iterable[TipMotion], delay: float = 0.0) -> FilterScores:
    """Train as in `same_recording`, with lags shorter than the recordings' samples."""
    return same_recording(motions, delay, FINE)
