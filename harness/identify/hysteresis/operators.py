"""Operators of hysteresis that can be fitted to a recording, by name.

The rest of identification sees a fit through `OperatorFit` alone: the parameters of a record, and
the stroke that they predict for a voltage.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fmu_src.errors import SteadytipError
from fmu_src.kit import Parameters
from fmu_src.kit.model import Model
from fmu_src.kit.runner import Runner
from fmu_src.piezo import creeping, prandtl_ishlinskii, rate_dependent
from fmu_src.piezo import modulated_stops as stops
from harness.common.errors import nearest
from harness.common.types import FloatArray
from harness.identify.hysteresis import modulated_stops, plays
from harness.identify.options import Progress

__all__ = ["OPERATORS", "Operator", "OperatorFit", "find_operator"]

Excitation = Callable[[float, float], FloatArray]
"""Makes a voltage to record with, (n,) [V], from sample rate [Hz] and largest voltage [V]."""


@dataclass(frozen=True)
class OperatorFit:
    """A fit of an operator.

    Attributes:
        parameters: values of the operator's record by field, in SI.
        predict: stroke for a voltage that begins at rest, (n,) [V] to (n,) [m], from any zero.
        order: size of the operator, for people.
        tried: other orders: name, rms fitted [m], rms validated [m].
        first: samples at the beginning that the fit leaves out.
    """

    parameters: Mapping[str, Any]
    predict: Callable[[FloatArray], FloatArray]
    order: str
    tried: tuple[tuple[str, float, float], ...] = ()
    first: int = 0


@dataclass(frozen=True)
class Operator:
    """An operator that can be fitted.

    Attributes:
        title: description for people.
        model: model of the operator; the parameters are for it unless another one is named.
        excitation: voltage to record with.
        fit: makes a fit from voltage (n,) [V], stroke (n,) [m] and sample period [s].
    """

    title: str
    model: Model
    excitation: Excitation
    fit: Callable[[FloatArray, FloatArray, float, Progress], OperatorFit]

    @property
    def record(self) -> type[Parameters]:
        """Record class of its parameters, with units and ranges."""
        return self.model.parameters


def find_operator(name: str) -> Operator:
    """Return the operator of a name on the command line.

    Raises:
        SteadytipError: there is no such operator.
    """
    if name not in OPERATORS:
        hint = nearest(name, OPERATORS)
        raise SteadytipError(f"--operator {name}: there is none of that name; {hint}")
    return OPERATORS[name]


def _operator_of_plays(
    title: str,
    model: Model,
    excitation: Excitation,
    identify: Callable[[FloatArray, FloatArray, float], plays.HysteresisFit],
    order: str,
    **inputs: Callable[[Mapping[str, Any], FloatArray, float], FloatArray],
) -> Operator:
    """Make an operator of plays; its model predicts.

    Args:
        title: description for people.
        model: model of the operator.
        excitation: voltage to record with.
        identify: makes the fit.
        order: size of the operator, for people.
        inputs: inputs of the model beside the voltage, from parameters, voltage and period.
    """

    def fit(
        volts: FloatArray, stroke: FloatArray, period: float, progress: Progress
    ) -> OperatorFit:
        progress(0, 1)
        found = identify(volts, stroke, period)
        progress(1, 1)

        def predict(volts: FloatArray) -> FloatArray:
            more = {name: of(found.parameters, volts, period) for name, of in inputs.items()}
            runner = Runner(replace(model, sample_period=period), found.parameters)
            return runner.run(len(volts), {"volts": volts, **more})["stroke"] + found.offset

        return OperatorFit(found.parameters, predict, order, first=found.first)

    return Operator(title, model, excitation, fit)


def _fit_stops(
    volts: FloatArray, stroke: FloatArray, period: float, progress: Progress
) -> OperatorFit:
    fit = modulated_stops.identify_stops(volts, stroke, period, progress=progress)
    tried = tuple(
        (f"{one.order} stops, power {one.power:g}", one.fitted, one.validated)
        for one in fit.candidates
    )
    return OperatorFit(fit.parameters, fit.predict, f"{fit.order} stops", tried, fit.first)


_PLAYS = f"{prandtl_ishlinskii.PLAYS} plays, {prandtl_ishlinskii.DEAD_ZONES} dead zones"

OPERATORS = {
    "modulated-stops": Operator(
        "stop operators modulated by the voltage, with creep and lead",
        stops.MODEL,
        modulated_stops.excitation,
        _fit_stops,
    ),
    "prandtl-ishlinskii": _operator_of_plays(
        "modified Prandtl-Ishlinskii operator (A04 7.2)",
        prandtl_ishlinskii.MODEL,
        plays.excitation,
        lambda volts, stroke, period: plays.identify_hysteresis(volts, stroke),
        _PLAYS,
    ),
    "rate-dependent": _operator_of_plays(
        "rate-dependent Prandtl-Ishlinskii operator (A04 7.3)",
        rate_dependent.MODEL,
        lambda rate, top: np.concatenate(plays.sweep(rate, top=top)),
        plays.identify_rate_dependence,
        _PLAYS,
        rate=plays.stroke_rate,
    ),
    "creeping": _operator_of_plays(
        "Prandtl-Ishlinskii operator with creep (Krejci and Kuhnen 2001)",
        creeping.MODEL,
        modulated_stops.excitation,
        plays.identify_creeping,
        f"{_PLAYS}, {creeping.WIDTHS * stops.LAGS} creep operators",
    ),
}
"""Operators by their name on the command line."""
