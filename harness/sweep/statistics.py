"""Statistics of a sweep: intervals of means and medians, and what a figure depends on.

    rho   Spearman's rank correlation of a variable and a figure
    S     share of the figure's variance between the levels of a variable: eta squared less what as
          many levels without any influence have on average (Kelley's epsilon squared)

In a full grid, where each level meets all others, chance is what no variable explains by itself.
Levels are the values of a grid, of a list, recordings or faults; of a continuous variable, classes
of equal numbers of runs. S of a variable of a full grid, or of independent variables, is its first
order index of sensitivity (Saltelli et al., Global Sensitivity Analysis, 2008): it sees influences
that are not monotonic, where rho sees weak ones that are. Intervals are of 95 %: those of means
Student's, those of rho by Bonett and Wright (2000), those of S by the bootstrap over runs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from harness.common.types import FloatArray

__all__ = ["LEVEL", "Influence", "Summary", "influences_of", "levels_of", "mean_of", "summary_of"]

LEVEL = 0.95
_RESAMPLES = 200
_FEW = 5
"""Runs of a class, and runs in all, below which nothing is said."""
_MOST_CLASSES = 24


@dataclass(frozen=True)
class Summary:
    """A figure over all runs that have it.

    Attributes:
        count: of runs.
        median: over them.
        mean: over them.
        low: end of the mean's interval; NaN of a single run.
        high: the other end.
        least: of all.
        most: of all.
    """

    count: int
    median: float
    mean: float
    low: float
    high: float
    least: float
    most: float


def mean_of(values: FloatArray) -> tuple[float, float, float]:
    """Mean and the ends of its interval, by Student's t; NaN for ends that there are not."""
    n = len(values)
    mean = float(values.mean()) if n else math.nan
    if n < 2:
        return mean, math.nan, math.nan
    half = float(stats.t.ppf((1 + LEVEL) / 2, n - 1) * values.std(ddof=1) / math.sqrt(n))
    return mean, mean - half, mean + half


def summary_of(values: FloatArray) -> Summary:
    """Summary of (n,) values; those that are not finite are left out."""
    found = values[np.isfinite(values)]
    mean, low, high = mean_of(found)
    if not len(found):
        return Summary(0, *[math.nan] * 6)
    median = float(np.median(found))
    return Summary(len(found), median, mean, low, high, float(found.min()), float(found.max()))


@dataclass(frozen=True)
class Influence:
    """What a variable has to do with a figure.

    Attributes:
        variable: its name.
        rho: rank correlation; None of a variable without order.
        rho_low: end of its interval.
        rho_high: the other end.
        share: S.
        share_low: end of its interval.
        share_high: the other end.
    """

    variable: str
    rho: float | None
    rho_low: float
    rho_high: float
    share: float
    share_low: float
    share_high: float

    @property
    def strength(self) -> float:
        """Measure that variables are ranked by: the larger of S and rho squared."""
        return max(self.share, 0.0 if self.rho is None else self.rho**2)


def influences_of(
    figure: FloatArray, variables: Mapping[str, np.ndarray], listed: bool = False
) -> list[Influence]:
    """Influence of each variable, the strongest first.

    Args:
        figure: (n,); runs without a finite one are left out.
        variables: (n,) numbers, or objects without order.
        listed: whether it is a full grid.
    """
    good = np.isfinite(figure)
    y = figure[good]
    if len(y) < _FEW or np.ptp(y) == 0.0:
        return []
    xs = {name: values[good] for name, values in variables.items()}
    xs = {name: x for name, x in xs.items() if len(set(x.tolist())) > 1}
    classes = {name: levels_of(x, listed) for name, x in xs.items()}
    # In a full grid every level meets all others: only what is left of them all is chance.
    chance = _left_over(list(classes.values()), y) if listed else None
    found = []
    for name, x in xs.items():
        rho, low, high = _rank_correlation(x, y) if x.dtype != object else (None, 0.0, 0.0)
        found.append(Influence(name, rho, low, high, *_share(classes[name], y, chance)))
    return sorted(found, key=lambda each: -each.strength)


def levels_of(x: np.ndarray, listed: bool) -> np.ndarray:
    """(n,) which level each value belongs to, from 0."""
    distinct, index = np.unique(x.astype(str) if x.dtype == object else x, return_inverse=True)
    if x.dtype == object or listed or len(distinct) <= _MOST_CLASSES:
        return np.asarray(index)
    classes = int(min(max(len(x) // _FEW, 2), round(math.sqrt(len(x))), _MOST_CLASSES))
    ranks = stats.rankdata(x, method="ordinal") - 1
    return np.asarray((ranks * classes // len(x)).astype(int))


def _rank_correlation(x: np.ndarray, y: FloatArray) -> tuple[float, float, float]:
    n = len(y)
    rho = float(stats.spearmanr(x.astype(float), y).statistic)
    if n <= 3 or not math.isfinite(rho):
        return rho, -1.0, 1.0
    half = stats.norm.ppf((1 + LEVEL) / 2) * math.sqrt((1 + rho**2 / 2) / (n - 3))
    middle = math.atanh(min(max(rho, -1 + 1e-12), 1 - 1e-12))
    return rho, math.tanh(middle - half), math.tanh(middle + half)


def _between(classes: np.ndarray, y: FloatArray, count: int) -> tuple[float, int]:
    """Sum of squares between classes, and how many have values."""
    n = np.bincount(classes, minlength=count)
    sums = np.bincount(classes, y, minlength=count)
    there = n > 0
    means = sums[there] / n[there]
    return float(np.sum(n[there] * (means - y.mean()) ** 2)), int(there.sum())


def _total(y: FloatArray) -> float:
    return float(np.sum((y - y.mean()) ** 2))


def _left_over(classes: Sequence[np.ndarray], y: FloatArray) -> float:
    """Mean square of what is neither of the variables of a full grid alone."""
    found = [_between(each, y, int(each.max()) + 1) for each in classes]
    degrees = len(y) - 1 - sum(count - 1 for _, count in found)
    left = _total(y) - sum(between for between, _ in found)
    return max(left, 0.0) / degrees if degrees > 0 else 0.0


def _epsilon_squared(classes: np.ndarray, y: FloatArray, count: int, chance: float | None) -> float:
    total, (between, k) = _total(y), _between(classes, y, count)
    if total <= 0.0 or len(y) <= k:
        return 0.0
    within = max(total - between, 0.0) / (len(y) - k) if chance is None else chance
    return (between - (k - 1) * within) / total


def _share(classes: np.ndarray, y: FloatArray, chance: float | None) -> tuple[float, float, float]:
    count = int(classes.max()) + 1
    share = _epsilon_squared(classes, y, count, chance)
    generator = np.random.default_rng(len(y))
    tries = []
    for _ in range(_RESAMPLES):
        chosen = generator.integers(0, len(y), len(y))
        tries.append(_epsilon_squared(classes[chosen], y[chosen], count, chance))
    # Runs that are drawn twice make classes look more alike within: that bias is taken off.
    bias = float(np.mean(tries)) - share
    low, high = np.quantile(tries, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]) - bias
    share = max(share, 0.0)
    return share, max(min(float(low), share), 0.0), min(max(float(high), share), 1.0)
