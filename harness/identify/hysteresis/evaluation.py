"""Comparison of a fitted operator with a recording.

The residual is the recording less the prediction, without an offset and a straight drift of the
sensor. Offset and drift are fitted on the same part as the parameters and extended to the rest,
which validates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fmu_src.errors import SteadytipError
from harness.common.types import FloatArray
from harness.identify.hysteresis.operators import Operator, OperatorFit
from harness.identify.options import Progress
from harness.recordings.quality import BoolArray
from harness.recordings.stack import StackResponse

__all__ = ["HysteresisEvaluation", "evaluate"]


@dataclass(frozen=True)
class HysteresisEvaluation:
    """A fit of a part of a recording, compared with all of it.

    Attributes:
        response: the recording.
        operator: operator that was fitted.
        fit: the fit.
        fitted: True for samples that were fitted, (n,).
        counted: True for samples that count, (n,); those before the fit's first one do not.
        predicted: stroke with the sensor's offset and drift, (n,) [m].
        drift: drift of the sensor [m/s].
    """

    response: StackResponse
    operator: Operator
    fit: OperatorFit
    fitted: BoolArray
    counted: BoolArray
    predicted: FloatArray
    drift: float

    @property
    def residual(self) -> FloatArray:
        """Measured less predicted, (n,) [m]."""
        return self.response.stroke - self.predicted

    @property
    def parts(self) -> dict[str, BoolArray]:
        """Samples that were fitted and those that validate, by name, without empty parts."""
        both = {
            "fit": self.fitted & self.counted,
            "validation": ~self.fitted & self.counted,
        }
        return {name: part for name, part in both.items() if part.any()}


def evaluate(
    response: StackResponse, operator: Operator, fitted: BoolArray, progress: Progress
) -> HysteresisEvaluation:
    """Fit an operator to a part of a recording and predict all of it.

    Args:
        response: the recording.
        operator: operator to fit.
        fitted: True for samples to fit, (n,); one piece.
        progress: takes the steps done.

    Raises:
        SteadytipError: the part holds too little to fit.
    """
    begin = int(np.argmax(fitted))
    try:
        fit = operator.fit(
            response.volts[fitted], response.stroke[fitted], response.period, progress
        )
    except SteadytipError as error:
        part = f"{response.time[fitted][0]:.4g} to {response.time[fitted][-1]:.4g} s"
        raise SteadytipError(f"recording {response.path}, {part}: {error}") from None
    # Samples before a part in the middle validate, except the beginning of the recording.
    counted = np.ones(len(fitted), dtype=bool)
    counted[: fit.first] = False
    counted[begin : begin + fit.first] = False
    raw = response.stroke - fit.predict(response.volts)
    used = fitted & counted
    middle = response.time[used].mean()
    drift, offset = np.polyfit(response.time[used] - middle, raw[used], 1)
    sensor = offset + drift * (response.time - middle)
    return HysteresisEvaluation(
        response,
        operator,
        fit,
        fitted,
        counted,
        response.stroke - raw + sensor,
        float(drift),
    )
