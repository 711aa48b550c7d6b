"""The board's clock as seen from here.

    t_n = t_0 + T n + jitter         arrival of sample n, here; late now and then, never early
    e   = t_n - p_n                  p_n: predicted
    p   <- p_n + a e,  T <- T + b e  a = max(2 (2 m - 1) / (m (m + 1)), a_s)
                                     b = max(6 / (m (m + 1)), b_s),  m samples seen

A straight line through the arrivals, fitted with growing memory up to that of the steady gains. An
arrival that is late by more than L tells of a stall and nothing of the clock, unless that goes on;
one that is early by more tells that the line was wrong.

Lateness comes and goes, so drift follows from the earliest arrival in each thousand: a straight
line through the last of these.
"""

from __future__ import annotations

from collections import deque
from statistics import linear_regression

__all__ = ["BoardClock"]

_STEADY = 0.002
"""a_s: memory of some 1000 samples (chosen)."""
_STEADY_RATE = _STEADY**2 / 4
"""b_s, critically damped."""
_BLOCK, _BLOCKS = 1000, 60
"""Samples of which the earliest is kept, and how many such."""
_CLIP = 0.5
"""L, as a share of the period."""
_STALL = 1000
"""Late arrivals in a row after which they are no stall any more."""


class BoardClock:
    """Predicts when a sample arrives.

    Attributes:
        period: of the samples in the time of this machine, T [us].
    """

    def __init__(self, period: float) -> None:
        """Start from the period that the board should have [us]."""
        self._nominal = period
        self.period = period
        self._seen = 0
        self._late = 0
        self._sample = 0
        self._time = 0.0
        self._origin = 0.0
        self._block = 0
        self._earliest: deque[tuple[int, float]] = deque(maxlen=_BLOCKS)

    @property
    def is_locked(self) -> bool:
        """True once there has been a sample."""
        return self._seen > 0

    @property
    def drift(self) -> float | None:
        """By how much the board's clock is slow, relative; None before it is known."""
        if len(self._earliest) < 2:
            return None
        samples, lateness = zip(*self._earliest, strict=True)
        return linear_regression(samples, lateness).slope / self._nominal

    def _note(self, sample: int, time: float) -> None:
        """Keep the earliest arrival of each thousand samples, less what it should be."""
        late = time - self._origin - sample * self._nominal
        if not self._earliest or sample - self._block >= _BLOCK:
            self._block = sample
            self._earliest.append((sample, late))
        elif late < self._earliest[-1][1]:
            self._earliest[-1] = (sample, late)

    def take(self, sample: int, time: float) -> None:
        """Learn from the arrival of a sample [us]."""
        if not self._seen:
            self.restart(sample, time)
            return
        self._note(sample, time)
        predicted = self.predict(sample)
        error, limit = time - predicted, _CLIP * self._nominal
        if error > limit:
            self._late += 1
            if self._late > _STALL:
                self.restart(sample, time)
            return
        self._late = 0
        if error < -limit:
            self.restart(sample, time)
            return
        self._seen += 1
        m = self._seen
        ahead = max(1, sample - self._sample)
        self._time = predicted + max(2 * (2 * m - 1) / (m * (m + 1)), _STEADY) * error
        self.period += max(6 / (m * (m + 1)), _STEADY_RATE) * error / ahead
        # No quartz is off by more than a thousandth.
        self.period = min(max(self.period, 0.999 * self._nominal), 1.001 * self._nominal)
        self._sample = sample

    def restart(self, sample: int, time: float) -> None:
        """Count anew from here, with the period as it is known."""
        self._sample, self._time = sample, time
        self._seen = max(self._seen, 1)
        self._late = 0
        self._origin = time - sample * self._nominal
        self._earliest.clear()
        self._note(sample, time)

    def predict(self, sample: int) -> float:
        """Predict when a sample arrives [us]."""
        return self._time + (sample - self._sample) * self.period

    def at(self, time: float) -> int:
        """Sample whose predicted arrival is closest to a time [us]."""
        return self._sample + round((time - self._time) / self.period)
