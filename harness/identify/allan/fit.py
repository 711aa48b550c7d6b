"""Noise terms from the Allan deviation of a sensor at rest (A04 3.3, IEEE 1293 annex I).

The deviation itself is allantools' (overlapping). Terms are the parts of its square:

    s^2(T) = 3 Q^2 / T^2 + N^2 / (2 T) + (2 ln 2 / pi) B^2 + K^2 T / 3 + R^2 T^2 / 2

| symbol | meaning | slope of s |
| --- | --- | --- |
| T | averaging time [s] | |
| Q | quantisation: white noise of the integral | -1 |
| N | white noise, as one-sided density: velocity or angle random walk is N / sqrt(2) | -1/2 |
| B | bias instability (flicker) | 0 |
| K | random walk of the signal: acceleration or rate random walk | 1/2 |
| R | trend | 1 |

A term is accepted if the likelihood of the curve says so; each point of it is a chi-squared
variable with allantools' degrees of freedom. Points are an octave apart. No point counts as known
to better than some per cent, because the terms are an idealisation.

White noise behind an output filter of time constant tau is a Gauss-Markov process: its samples obey
x[k+1] = a x[k] + w with a = exp(-T_s / tau). What remains, a, shows in the differences over one
sample and over two, 1 + a = E d2^2 / E d1^2, and its exact Allan variance stands in N's place.
Samples that are much farther apart than tau hold all of the noise folded below half their rate: N
is then that of the samples, unless tau is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.stats import chi2, norm

from fmu_src.errors import SteadytipError
from harness.common.types import FloatArray

__all__ = ["TERMS", "Curve", "Noise", "Term", "analyse", "deviation"]

CONFIDENCE = 0.95
"""Confidence of all intervals."""
PARTS = 5
"""Number of averages at the longest averaging time."""
BEST = 2000.0
"""Largest degrees of freedom of a point: its deviation is known to 3 %."""
CLEAR = 12.0
"""Least rise of twice the log likelihood for a term to be accepted."""
TOGETHER = 1.3
"""Factor on intervals because points an octave apart are correlated (simulated walks)."""
LAGS = 16.0
"""Shortest averaging time that is fitted, in time constants of the output filter."""
TERMS: Mapping[str, tuple[str, str]] = {
    "quantisation": ("Q", ".s"),
    "white": ("N", "/Hz0.5"),
    "bias": ("B", ""),
    "walk": ("K", "/s0.5"),
    "trend": ("R", "/s"),
    "sample": ("sigma", ""),
}
"""Symbol and factor on the unit of the signal, by name of the term. `sample` is the rms of the
white noise in one sample."""


@dataclass(frozen=True)
class Curve:
    """An Allan deviation.

    Attributes:
        tau: averaging times, an octave apart, (n,) [s].
        deviation: (n,).
        low, high: bounds of the interval of `CONFIDENCE`, (n,).
        freedom: degrees of freedom of each point.
    """

    tau: FloatArray
    deviation: FloatArray
    low: FloatArray
    high: FloatArray
    freedom: FloatArray


@dataclass(frozen=True)
class Term:
    """A noise term with the half width of its interval."""

    value: float
    half: float


@dataclass(frozen=True)
class Noise:
    """Noise of a signal, from its Allan deviation.

    Attributes:
        curve: the deviation.
        terms: accepted terms, by the names of `TERMS`.
        lag: time constant of the output filter, given or found; 0 if none shows [s].
        least: the smallest deviation, and its averaging time [s].
        parts: share of each term in the square of the deviation, (n,).
        notes: sentences about what is unusual but may be right.
    """

    curve: Curve
    terms: Mapping[str, Term]
    lag: float
    least: tuple[float, float]
    parts: Mapping[str, FloatArray]
    notes: tuple[str, ...] = ()


def deviation(values: FloatArray, period: float) -> Curve:
    """Compute the overlapping Allan deviation at averaging times an octave apart.

    Args:
        values: samples, (n,).
        period: period of the samples [s].

    Raises:
        SteadytipError: allantools is not installed.
    """
    try:
        import allantools
    except ImportError:
        raise SteadytipError(
            "the Allan deviation needs allantools, which is not installed: "
            "pip install 'steadytip[identify]'"
        ) from None
    n = len(values)
    counts = 2 ** np.arange(int(np.log2(n / PARTS)) + 1)
    tau, found, _, _ = allantools.oadev(
        values - values.mean(), 1 / period, "freq", list(counts * period)
    )
    # The smaller one of white noise and of a random walk, which dominates long averages.
    freedom = np.array(
        [min(allantools.edf_simple(n + 1, m, alpha) for alpha in (0, -2)) for m in counts]
    )
    tail = (1 - CONFIDENCE) / 2
    low = found * np.sqrt(freedom / chi2.ppf(1 - tail, freedom))
    high = found * np.sqrt(freedom / chi2.ppf(tail, freedom))
    return Curve(np.asarray(tau), np.asarray(found), low, high, freedom)


def analyse(values: FloatArray, period: float, lag: float | None = None) -> Noise:
    """Read the noise terms off the Allan deviation of a signal.

    Args:
        values: samples, (n,).
        period: period of the samples [s].
        lag: time constant of the filter ahead of the samples [s]; None to find it.

    Raises:
        SteadytipError: allantools is not installed.
    """
    curve = deviation(values, period)
    correlation = _correlation(values) if lag is None else np.exp(-period / max(lag, 1e-12))
    found_lag = (
        lag if lag is not None else (-period / np.log(correlation) if correlation > 0 else 0.0)
    )
    counts = np.round(curve.tau / period)
    shapes = {
        "quantisation": 3 / curve.tau**2,
        "white": _white(counts, correlation) / (2 * period),
        "bias": np.full(len(curve.tau), 2 * np.log(2) / np.pi),
        "walk": curve.tau / 3,
        "trend": curve.tau**2 / 2,
    }
    if correlation:
        del shapes["quantisation"]  # hidden by the filter
    fitted = curve.tau >= LAGS * found_lag
    sizes, errors = _fit(curve, shapes, fitted)
    terms = {}
    z = TOGETHER * float(norm.ppf((1 + CONFIDENCE) / 2))
    for name, size in sizes.items():
        root = float(np.sqrt(size))
        terms[name] = Term(root, z * errors[name] / (2 * root))
    notes = []
    if "white" in terms:
        white = terms["white"]
        share = np.sqrt((1 - correlation) / (1 + correlation) / (2 * period))
        terms["sample"] = Term(float(white.value * share), float(white.half * share))
        if lag is not None and lag > 0:
            # What is folded below half the rate belongs above it.
            folded = np.sqrt(2 * lag / period * np.tanh(period / (2 * lag)))
            terms["white"] = Term(float(white.value * folded), float(white.half * folded))
    else:
        notes.append("no white noise shows; was the signal averaged or filtered?")
    at = int(curve.deviation.argmin())
    least = (float(curve.deviation[at]), float(curve.tau[at]))
    if at == len(curve.tau) - 1:
        notes.append(
            f"the deviation still falls at {curve.tau[-1]:.4g} s: a bias instability or a random "
            "walk would show in a longer record"
        )
    return Noise(
        curve,
        terms,
        float(found_lag),
        least,
        {name: size * shapes[name] for name, size in sizes.items()},
        tuple(notes),
    )


def _correlation(values: FloatArray) -> float:
    """Return a of a Gauss-Markov process, without drift; 0 if it does not show."""
    one, two = np.diff(values), values[2:] - values[:-2]
    mean = float(np.mean(one**2))
    correlation = float(np.mean(two**2)) / mean - 1 if mean else 0.0
    return correlation if 5 / np.sqrt(len(values)) < correlation < 1 else 0.0


def _white(counts: FloatArray, correlation: float) -> FloatArray:
    """Return the Allan variance of means of m samples of a Gauss-Markov process.

    It is scaled to 1 / m at large m.
    """
    a = correlation
    faded = 1 - a**counts
    variance = counts * (1 + a) / (1 - a) - 2 * a * faded / (1 - a) ** 2
    together = a * faded**2 / (1 - a) ** 2
    return (variance - together) / counts**2 * (1 - a) / (1 + a)


def _fit(
    curve: Curve, shapes: Mapping[str, FloatArray], fitted: np.ndarray
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the squares of the accepted terms, and their standard errors."""
    y = curve.deviation[fitted] ** 2
    freedom = np.minimum(curve.freedom[fitted], BEST)
    columns = {name: shape[fitted] for name, shape in shapes.items()}

    def fit(names: Sequence[str]) -> tuple[FloatArray, float]:
        A = np.column_stack([columns[name] for name in names])
        s = y
        for _ in range(50):
            weight = np.sqrt(freedom / 2) / s
            size, _ = nnls(A * weight[:, None], y * weight)
            s = np.maximum(A @ size, 1e-3 * y)
        return size, float(np.sum(freedom * (np.log(s) + y / s)))

    chosen: list[str] = []
    worst = np.inf
    while len(chosen) < len(columns):
        tried = {name: fit([*chosen, name])[1] for name in columns if name not in chosen}
        best = min(tried, key=lambda name: tried[name])
        if chosen and worst - tried[best] < CLEAR:
            break
        chosen.append(best)
        worst = tried[best]
    size, _ = fit(chosen)
    present = [name for name, value in zip(chosen, size, strict=True) if value > 0]
    size, _ = fit(present)
    A = np.column_stack([columns[name] for name in present])
    weight = np.sqrt(freedom / 2) / (A @ size)
    scaled = A * weight[:, None] * size
    covariance = np.linalg.pinv(scaled.T @ scaled)
    errors = np.sqrt(np.diag(covariance)) * size
    found = dict(zip(present, size.tolist(), strict=True))
    return found, dict(zip(present, errors.tolist(), strict=True))
