"""Whether an estimator's errors are as large as it says: NIS and NEES of a run.

    y, S   innovation of a correction and the covariance that the filter expects of it
    e, s   error of an estimate, and the standard deviation that the filter states, by component
    NIS    y' S^-1 y, normalised innovation squared, of each correction
    NEES   sum (e_i / s_i)^2, normalised estimation error squared, of each sample

Of a filter that is consistent and of Gaussian errors, both are chi-squared with as many degrees of
freedom as y or e has components (Bar-Shalom, Li, Kirubarajan: Estimation with Applications to
Tracking and Navigation, 2001, 5.4), so that their mean per degree of freedom is 1. More tells that
the filter believes itself too much, less that it could believe itself more.

What a part has is found by the names of its outputs: `innovation_squared`, with `innovation_size`
(degrees of freedom at this sample, 0 without a correction; or the part's setting of that name, for
an estimator whose corrections are all of one size), and `<quantity>_sigma_*` beside a quantity that
the scenario's `signals` name together with the truth. Samples that count are those after `settle`
at which the part's output `valid`, if it has one, is true.

A consistent filter's innovations are independent, so that all degrees of freedom of a run count in
the interval of the mean. Estimation errors are not: they are counted as one independent sample for
each time over which they are correlated, and the correlation is estimated from the run itself. Of a
covariance only the diagonal is known. That leaves the mean of the NEES as it is, while its spread
grows with the correlation between components, for which the count is reduced, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal, stats

from harness.common.endpoint import Endpoint
from harness.common.types import FloatArray
from harness.results.metrics import Metric, rotation_between
from harness.scenario.schema import NIS_OUTPUT, SHORTEST_EVALUATION

if TYPE_CHECKING:
    from harness.results.signals import RecordedSignals

__all__ = ["LEVEL", "Consistency", "consistency_of", "mean_interval"]

LEVEL = 0.95
"""Of all intervals and bounds."""
_SIZE, _VALID = "innovation_size", "valid"
BoolArray = np.ndarray
_UNCORRELATED = 0.05
"""Correlation below which errors count as independent."""


@dataclass(frozen=True)
class Consistency:
    """Normalised squares of one estimator.

    Attributes:
        part: the estimator.
        quantity: whose error it is; None for the innovations.
        time: of each value, (k,) [s].
        squared: NIS or NEES, (k,).
        size: degrees of freedom of each, (k,).
        independent: degrees of freedom of all of them together that are independent.
    """

    part: str
    quantity: str | None
    time: FloatArray
    squared: FloatArray
    size: FloatArray
    independent: float

    @property
    def name(self) -> str:
        """Name of the metric, `part.nis` or `part.<quantity>_nees`."""
        return f"{self.part}.nis" if self.quantity is None else f"{self.part}.{self.quantity}_nees"

    @property
    def title(self) -> str:
        """For people."""
        return "NIS" if self.quantity is None else f"NEES of the {self.quantity.replace('_', ' ')}"

    @property
    def mean(self) -> float:
        """Per degree of freedom."""
        return float(self.squared.sum() / self.size.sum())

    @property
    def interval(self) -> tuple[float, float]:
        """In which the mean of a consistent filter lies, `LEVEL` of the time."""
        return mean_interval(self.independent)

    @property
    def bound(self) -> FloatArray:
        """Below which single values of a consistent filter stay, `LEVEL` of the time, (k,)."""
        sizes, which = np.unique(self.size, return_inverse=True)
        return np.asarray(stats.chi2.ppf(LEVEL, sizes)[which])

    @property
    def inside(self) -> float:
        """Share of single values within their bound [%]."""
        return 100.0 * float(np.mean(self.squared <= self.bound))

    @property
    def verdict(self) -> str:
        """Place of the mean, in its interval or on which side of it, in words."""
        low, high = self.interval
        within = f"its {100 * LEVEL:g} % interval, {low:.3g} to {high:.3g}"
        if self.mean > high:
            return f"above {within}: the filter is overconfident"
        if self.mean < low:
            return f"below {within}: the filter is too cautious"
        return f"inside {within}: the filter is consistent"

    @property
    def sentence(self) -> str:
        """Mean and verdict, for people."""
        return f"{self.part}: {self.title} {self.mean:.3g} per degree of freedom, {self.verdict}"

    def metrics(self) -> dict[str, Metric]:
        """Figures by name."""
        low, high = self.interval
        if self.quantity is None:
            what = (
                f"normalised innovation squared of the corrections of '{self.part}', the sum of "
                "all over the sum of their degrees of freedom"
            )
            count = f"{len(self.squared)} corrections, which a consistent filter makes independent"
        else:
            what = (
                f"squared error of the {self.quantity.replace('_', ' ')} of '{self.part}', each "
                "component over its stated standard deviation, mean over samples and components"
            )
            if self.quantity == "attitude":
                what += "; the error of an attitude is a rotation vector in the body"
            count = (
                f"{len(self.squared)} samples, of which correlation in time and between components "
                f"leaves {self.independent:.3g} degrees of freedom independent"
            )
        law = f"the {100 * LEVEL:g} % interval of {self.name} by the chi-squared law, from {count}"
        return {
            self.name: Metric(self.mean, "1", f"{what}; 1 is consistent. It is {self.verdict}"),
            f"{self.name}_low": Metric(low, "1", f"lower end of {law}"),
            f"{self.name}_high": Metric(high, "1", f"upper end of {law}"),
            f"{self.name}_inside": Metric(
                self.inside,
                "%",
                f"share of the single values below the {100 * LEVEL:g} % quantile of chi-squared "
                f"with their degrees of freedom; {100 * LEVEL:g} % is consistent",
            ),
        }


def consistency_of(result: RecordedSignals) -> list[Consistency]:
    """Compare the errors of a run's estimators with those they state; leave silent ones out."""
    metadata = result.metadata
    columns = set(result.columns)
    counted = result.time >= metadata.warm_up - 1e-9
    if np.count_nonzero(counted) * metadata.step_size < SHORTEST_EVALUATION:
        return []

    def samples(part: str) -> BoolArray:
        valid = f"{part}.{_VALID}"
        return np.asarray(counted & (result.signals(valid) != 0.0)) if valid in columns else counted

    found: list[Consistency] = []
    for part in metadata.parts:
        if f"{part}.{NIS_OUTPUT}" in columns:
            squared = result.signals(f"{part}.{NIS_OUTPUT}")
            if f"{part}.{_SIZE}" in columns:
                size = result.signals(f"{part}.{_SIZE}")
            elif part in (sizes := metadata.innovation_sizes):
                size = np.where(squared > 0.0, float(sizes[part]), 0.0)
            else:
                continue
            found += _nis(part, result.time, squared, size, samples(part))
    for part, quantity, error, sigma in _errors(result, columns):
        found += _nees(part, quantity, result.time, error, sigma, samples(part))
    return found


def mean_interval(degrees: float) -> tuple[float, float]:
    """Interval of a chi-squared variable's mean per degree of freedom, `LEVEL` of the time."""
    low, high = stats.chi2.ppf([(1 - LEVEL) / 2, (1 + LEVEL) / 2], degrees) / degrees
    return float(low), float(high)


def _nis(
    part: str, time: FloatArray, squared: FloatArray, size: FloatArray, counted: BoolArray
) -> Iterator[Consistency]:
    # An estimator that is slower than the loop shows each correction for several ticks.
    fresh = np.append(True, (np.diff(squared) != 0.0) | (np.diff(size) != 0.0))
    taken = counted & fresh & (size > 0.0)
    if taken.any():
        total = float(size[taken].sum())
        yield Consistency(part, None, time[taken], squared[taken], size[taken], total)


def _errors(
    result: RecordedSignals, columns: set[str]
) -> Iterator[tuple[str, str, FloatArray, FloatArray]]:
    """Part, quantity, error (n, 3) and stated deviation (n, 3) where the truth is known."""
    roles: Mapping[str, list[str]] = result.metadata.roles
    for what in ("attitude", "position"):
        true, estimated = result.role(f"{what}_true"), result.role(f"{what}_estimated")
        if true is None or estimated is None:
            continue
        # `estimator.attitude_w` is a component of the quantity `attitude` of `estimator`.
        name = roles[f"{what}_estimated"][0]
        part, port = Endpoint.find(name, result.metadata.parts) or Endpoint(*name.split(".", 1))
        quantity = port.rpartition("_")[0] or port
        sigmas = [f"{part}.{quantity}_sigma_{axis}" for axis in "xyz"]
        if not columns.issuperset(sigmas):
            continue
        sigma = np.column_stack([result.signals(name) for name in sigmas])
        error = rotation_between(estimated, true) if what == "attitude" else true - estimated
        yield part, quantity, error, sigma


def _nees(
    part: str,
    quantity: str,
    time: FloatArray,
    error: FloatArray,
    sigma: FloatArray,
    counted: BoolArray,
) -> Iterator[Consistency]:
    taken = counted & (sigma > 0.0).all(axis=1)
    if taken.any():
        ratio = error[taken] / sigma[taken]
        squared = np.sum(ratio**2, axis=1)
        size = np.full(len(ratio), float(ratio.shape[1]))
        yield Consistency(part, quantity, time[taken], squared, size, _independent(ratio))


def _independent(ratio: FloatArray) -> float:
    """Degrees of freedom of the sum of squares of correlated normal variables (n, k).

    Var(sum) is 2 n^2 k^2 / independent (Satterthwaite). The correlation in time is that of the
    component for which it lasts longest; that of an error that does not change is 1 forever.
    """
    n, k = ratio.shape
    power = np.sqrt(np.mean(ratio**2, axis=0))
    scaled = ratio / np.where(power > 0.0, power, 1.0)
    components = np.sum(np.square(scaled.T @ scaled / n))
    lasting = max(_lasting(column) for column in scaled.T)
    return float(max(n / lasting, 1.0) * k**2 / max(components, 1.0))


def _lasting(x: FloatArray) -> float:
    """Return the samples that count as one: sum of the squared correlation over all lags."""
    n = len(x)
    correlation = signal.correlate(x, x, method="fft")[n - 1 :] / n
    small = np.flatnonzero(correlation < _UNCORRELATED)
    end = small[0] if small.size else n
    return float(max(1.0 + 2.0 * np.sum(correlation[1:end] ** 2), 1.0))
