"""Find what a fitted operator cannot explain: a lag between the columns, and too large a residual.

A displacement that is tau behind the voltage leaves

    r(t) = -tau y'(t)

of a stroke y, of which the operator's own width explains about a half. Where such a part is seen,
the operator is fitted again with the displacement moved by some rows, and the number of rows that
leaves least is named.

| symbol | meaning |
| --- | --- |
| r | residual of the fit [m] |
| y | predicted stroke [m] |
| tau | lag [s] |
"""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np

from harness.identify.hysteresis.evaluation import HysteresisEvaluation, evaluate
from harness.recordings.findings import Finding, refuse
from harness.recordings.stack import moved_by

__all__ = ["check_fit"]

LAG, LAG_SHARE = 0.08, 0.03
"""Least lag in rows that is looked into, and the least share of the residual that it explains."""
GAIN = 0.5
"""What the fit with a moved displacement may leave above the noise, for the lag to be named."""
MOST_ROWS = 64
"""Largest lag that is looked for, in rows."""
UNEXPLAINED, NOISES = 0.03, 5.0
"""Residual that stops: share of the stroke's range, and multiple of the sensor's noise."""

_Refit = Callable[[int], HysteresisEvaluation]


def check_fit(one: HysteresisEvaluation, accept: Collection[str]) -> None:
    """Refuse a fit that leaves what it should not.

    Args:
        one: the fit.
        accept: names of findings to go on with.

    Raises:
        FindingsError: the displacement lags, or the residual is too large.
    """

    def refit(rows: int) -> HysteresisEvaluation:
        moved = moved_by(one.response, rows)
        return evaluate(moved, one.operator, one.fitted[rows:], lambda _done, _all: None)

    findings = []
    rows = _lag(one, refit) if _lag_suspected(one) else 0
    share, noise = _residual(one), _noise(one)
    if rows:
        seconds = rows * one.response.period
        text = (
            f"the displacement is {rows} row{'s' * (rows > 1)} ({1e3 * seconds:.3g} ms) behind the "
            f"voltage: moved by that, the fit leaves {100 * _residual(refit(rows)):.2g} % of the "
            f"stroke instead of {100 * share:.2g} %"
        )
        cure = (
            f"Give --late {rows} if rows hold the voltage that is set at their time; a stack or "
            "sensor with such a dead time is not described by the operator"
        )
        findings.append(Finding("lag", "stop", "all samples", text, cure))
    elif share > UNEXPLAINED and share > NOISES * noise:
        text = (
            f"the fit leaves {100 * share:.2g} % of the stroke's range, and the sensor's noise is "
            f"{100 * noise:.2g} %: the operator does not describe this recording"
        )
        cure = (
            "Look at the page's plot of the residual: an offset of the sensor, a resonance or a "
            "drift; fit a part with --fit, or another --operator"
        )
        findings.append(Finding("unexplained-residual", "stop", "all samples", text, cure))
    refuse(one.response.path, findings, accept)


def _residual(one: HysteresisEvaluation) -> float:
    """Return the rms residual as a share of the stroke's range."""
    return float(np.std(one.residual[one.counted]) / np.ptp(one.response.stroke))


def _noise(one: HysteresisEvaluation) -> float:
    """Return the sensor's white noise as a share of the stroke's range."""
    third = np.diff(one.response.stroke, 3)
    return float(1.4826 * np.median(np.abs(third)) / np.sqrt(20) / np.ptp(one.response.stroke))


def _lag_suspected(one: HysteresisEvaluation) -> bool:
    speed = np.gradient(one.predicted, one.response.time)[one.counted]
    left = one.residual[one.counted]
    lag = -float(speed @ left) / float(speed @ speed)
    explained = 1 - float(np.var(left + lag * speed) / np.var(left))
    return lag > LAG * one.response.period and explained > LAG_SHARE


def _lag(one: HysteresisEvaluation, refit: _Refit) -> int:
    """Return the rows that leave least; 0 if moving does not help."""
    found: dict[int, float] = {}

    def left(rows: int) -> float:
        if rows not in found:
            share = _residual(refit(rows) if rows else one)
            found[rows] = np.sqrt(max(share**2 - _noise(one) ** 2, 0.0))
        return found[rows]

    rows = 1
    while rows <= MOST_ROWS and left(rows) < left(rows // 2):
        rows *= 2
    low, high = rows // 4, min(rows, MOST_ROWS)
    while high - low > 2:  # the residual has one minimum
        middle = (low + high) // 2
        if left(middle) < left(middle + 1):
            high = middle + 1
        else:
            low = middle
    best = min(range(low, high + 1), key=left)
    return best if left(best) < GAIN * left(0) else 0
