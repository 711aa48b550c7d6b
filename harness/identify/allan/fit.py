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

A term counts where the likelihood of the curve says so; each point of it is a chi-squared variable
with allantools' degrees of freedom. Points are an octave apart, and none counts as known to better
than some per cent, for the terms are an idealisation.

White noise behind an output filter of time constant tau is a Gauss-Markov process: its samples obey
x[k+1] = a x[k] + w with a = exp(-T_s / tau). What remains, a, shows in the differences over one
sample and over two, 1 + a = E d2^2 / E d1^2, and its exact Allan variance stands in N's place.
Samples that are much farther apart than tau hold all of the noise folded below half their rate: N
is then that of the samples, unless tau is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import nnls
from scipy.stats import chi2, norm

from harness.common.errors import ProblemsError, SteadytipError
from harness.common.types import FloatArray
from harness.identify.hysteresis.evaluation import fit_part
from harness.recordings.stack import TIME_WORDS, time_problems
from harness.recordings.tables import QUANTITIES, TIMES, Role, Table, find_columns, read_table

__all__ = ["TERMS", "Curve", "Noise", "Record", "Term", "analyse", "deviation", "read_record"]

CONFIDENCE = 0.95
"""Of all intervals."""
FEWEST = 1000
"""Samples; fewer hold no averaging time of ten samples with ten of them."""
PARTS = 5
"""Averages that the longest averaging time leaves."""
BEST = 2000.0
"""Degrees of freedom that a point counts with at most: 3 % of its deviation."""
CLEAR = 12.0
"""By which twice the logarithm of the likelihood rises with a term that is there."""
KNOCK = 15.0
"""Standard deviations between two samples that noise does not have."""
TOGETHER = 1.3
"""By which intervals are wider because points an octave apart go together (simulated walks)."""
LAGS = 16.0
"""Time constants of the output filter below which no point is fitted."""
TERMS: Mapping[str, tuple[str, str]] = {
    "quantisation": ("Q", ".s"),
    "white": ("N", "/Hz0.5"),
    "bias": ("B", ""),
    "walk": ("K", "/s0.5"),
    "trend": ("R", "/s"),
    "sample": ("sigma", ""),
}
"""By name: symbol, and what it adds to the unit of the signal. `sample` is the rms of the white
noise in one sample."""


@dataclass(frozen=True)
class Record:
    """A signal that somebody recorded at rest.

    Attributes:
        path: file that it comes from.
        name: of the column.
        unit: SI unit; empty where nobody says.
        time: (n,) [s], from 0 on.
        values: (n,), in that unit.
        period: of the samples [s].
    """

    path: Path
    name: str
    unit: str
    time: FloatArray
    values: FloatArray
    period: float


@dataclass(frozen=True)
class Curve:
    """An Allan deviation.

    Attributes:
        tau: averaging times, an octave apart, (n,) [s].
        deviation: (n,).
        low, high: of the interval of `CONFIDENCE`.
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
    """What the Allan deviation of a signal shows.

    Attributes:
        curve: the deviation.
        terms: those that are there, by the names of `TERMS`.
        lag: of the output filter, as given or as found; 0 where none shows [s].
        least: the smallest deviation, and its averaging time [s].
        parts: square of the deviation that each term makes, (n,).
        notes: what is odd without being wrong; sentences.
    """

    curve: Curve
    terms: Mapping[str, Term]
    lag: float
    least: tuple[float, float]
    parts: Mapping[str, FloatArray]
    notes: tuple[str, ...] = ()


def deviation(values: FloatArray, period: float) -> Curve:
    """Overlapping Allan deviation at averaging times an octave apart.

    Args:
        values: samples, (n,).
        period: of the samples [s].

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
    # The fewer of those of white noise and of a random walk, which long averages are.
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
        period: of the samples [s].
        lag: time constant of the filter ahead of the samples [s]; found where None.

    Raises:
        SteadytipError: allantools is not installed.
    """
    curve = deviation(values, period)
    kept = _correlation(values) if lag is None else np.exp(-period / max(lag, 1e-12))
    found_lag = lag if lag is not None else (-period / np.log(kept) if kept > 0 else 0.0)
    counts = np.round(curve.tau / period)
    shapes = {
        "quantisation": 3 / curve.tau**2,
        "white": _white(counts, kept) / (2 * period),
        "bias": np.full(len(curve.tau), 2 * np.log(2) / np.pi),
        "walk": curve.tau / 3,
        "trend": curve.tau**2 / 2,
    }
    if kept:
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
        share = np.sqrt((1 - kept) / (1 + kept) / (2 * period))
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
    """The a of a Gauss-Markov process, drift left out; 0 where none shows."""
    one, two = np.diff(values), values[2:] - values[:-2]
    mean = float(np.mean(one**2))
    kept = float(np.mean(two**2)) / mean - 1 if mean else 0.0
    return kept if 5 / np.sqrt(len(values)) < kept < 1 else 0.0


def _white(counts: FloatArray, kept: float) -> FloatArray:
    """Allan variance of means of m samples, for a Gauss-Markov process that is 1 / m at large m."""
    a = kept
    faded = 1 - a**counts
    variance = counts * (1 + a) / (1 - a) - 2 * a * faded / (1 - a) ** 2
    together = a * faded**2 / (1 - a) ** 2
    return (variance - together) / counts**2 * (1 - a) / (1 + a)


def _fit(
    curve: Curve, shapes: Mapping[str, FloatArray], fitted: np.ndarray
) -> tuple[dict[str, float], dict[str, float]]:
    """Squares of the terms that are there, and their standard errors."""
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
    there = [name for name, value in zip(chosen, size, strict=True) if value > 0]
    size, _ = fit(there)
    A = np.column_stack([columns[name] for name in there])
    weight = np.sqrt(freedom / 2) / (A @ size)
    scaled = A * weight[:, None] * size
    covariance = np.linalg.pinv(scaled.T @ scaled)
    errors = np.sqrt(np.diag(covariance)) * size
    found = dict(zip(there, size.tolist(), strict=True))
    return found, dict(zip(there, errors.tolist(), strict=True))


# Reading -----------------------------------------------------------------------------------------


def read_record(
    path: Path,
    columns: Sequence[str] = (),
    rate: float | None = None,
    time: str | None = None,
    unit: str | None = None,
    fit: str = "100%",
) -> list[Record]:
    """Read signals at rest from a table and check them.

    Args:
        path: text table or Parquet.
        columns: names or numbers (from 1); all columns of numbers but the time without them.
        rate: samples in a second, for tables without time [Hz].
        time: name or number of the time's column.
        unit: of columns that do not say theirs.
        fit: part that is taken, as `outcome.fit_part` has it.

    Raises:
        ProblemsError: everything that is wrong with the data.
        SteadytipError: no such file, not a table, no such column, no time.
    """
    if time is not None and rate is not None:
        raise SteadytipError("--time and --rate exclude each other; keep the one that is right")
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise SteadytipError(f"--rate {rate:g}: must be above 0 Hz")
    table = read_table(path, 1, "one is needed, with its time or with --rate HZ")
    where = f"recording {path}"
    roles = [Role("time", TIME_WORDS, TIMES, "s", time, None, True)] if rate is None else []
    found = find_columns(table, roles) if roles else {}
    if rate is None and "time" not in found:
        raise SteadytipError(
            f"{where} has no column that is called time; give --rate HZ, or --time NAME (there "
            f"are: {table.columns})"
        )
    n = len(table.values)
    t = found["time"][0] if "time" in found else np.arange(n) / float(rate or 1.0)
    problems = []
    if not np.isfinite(t).all():
        k = int(np.flatnonzero(~np.isfinite(t))[0])
        problems.append(f"time is {t[k]} in {table.row} {int(table.lines[k])}; cut the recording")
    elif n >= 2:
        problems += time_problems(t, lambda k: f"{table.row} {int(table.lines[k])}")
    if n < FEWEST:
        problems.append(f"{n} samples; at least {FEWEST} are needed: record longer, or faster")
    if problems:
        raise ProblemsError(where, problems)
    period = float((t[-1] - t[0]) / (n - 1))
    part = fit_part(fit, Record(path, "", "", t - t[0], t, period))
    if part.sum() < FEWEST:
        raise SteadytipError(
            f"--fit {fit}: holds {part.sum()} of the {n} samples of {path}; at least {FEWEST} are "
            "needed"
        )
    table = replace(table, values=table.values[part], lines=table.lines[part])
    t = t[part]
    taken = found["time"][1] if "time" in found else ""
    records = []
    for index in _indices(table, columns, taken):
        values, name, si = _in_si(table, index, unit)
        problems += _trouble(table, index, values, period)
        records.append(Record(path, name, si, t - t[0], values, period))
    if problems:
        raise ProblemsError(where, problems)
    return records


def _indices(table: Table, columns: Sequence[str], time: str) -> list[int]:
    if columns:
        roles = [Role(text, (), {"1": 1.0}, "1", text, "1", option="column") for text in columns]
        for role in roles:
            find_columns(table, [role])  # refuses what is none
        headings = [name.lower() for name in table.headings]
        return [
            headings.index(text.lower()) if text.lower() in headings else int(text) - 1
            for text in columns
        ]
    indices = [
        i
        for i in range(len(table.headings))
        if not table.is_text(i) and not (time and time.startswith(table.column(i)))
    ]
    if not indices:
        raise SteadytipError(
            f"recording {table.path} has no column of numbers beside the time (there are: "
            f"{table.columns})"
        )
    return indices


def _in_si(table: Table, index: int, unit: str | None) -> tuple[FloatArray, str, str]:
    said = table.units[index] or unit or ""
    name = table.headings[index] or f"column {index + 1}"
    for si, factors in QUANTITIES.items():
        if said in factors:
            return table.values[:, index] * factors[said], name, si
    if said:
        known = ", ".join(u for factors in QUANTITIES.values() for u in factors)
        raise SteadytipError(
            f"recording {table.path}: {table.column(index)} is in '{said}'; known are {known}"
        )
    return table.values[:, index], name, ""


def _trouble(table: Table, index: int, values: FloatArray, period: float) -> list[str]:
    """What keeps a column from being noise at rest, in sentences with a cure."""
    name = table.column(index)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        more = f" and {len(bad) - 1} more" if len(bad) > 1 else ""
        return [
            f"{name} is {values[bad[0]]} in {table.row} {int(table.lines[bad[0]])}{more}; cut the "
            "recording there, or record again"
        ]
    steps = np.diff(values)
    if not steps.any():
        return [f"{name} is {values[0]:g} all the time: no noise, is it connected?"]
    spread = max(1.4826 * float(np.median(np.abs(steps))), 0.3 * float(np.std(steps)))
    jumps = np.flatnonzero(np.abs(steps) > KNOCK * spread)
    if jumps.size:
        k = int(jumps[0])
        return [
            f"{name} jumps by {abs(steps[k]):.3g} at {k * period:.6g} s, {table.row} "
            f"{int(table.lines[k + 1])}, where {spread:.2g} is usual from sample to sample: the "
            "sensor did not rest; leave that out with --fit START:END"
        ]
    return []
