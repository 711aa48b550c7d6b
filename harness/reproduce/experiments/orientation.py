"""Attitudes of the BROAD trials by VQF and by this software, and their errors.

    e        q_true (x) q^-1 = (w, x, y, z), rotation of the error in W
    total         2 arctan2(|(x, y, z)|, |w|)             its angle
    heading       2 |arctan2(z, w)|, at most pi           of its turn about the vertical
    inclination   2 arccos((w^2 + z^2)^0.5)               of the rest, about a horizontal axis

(Laidig, Seel: VQF, Information Fusion 91, 2023; the BROAD benchmark scores so.) A trial's figure is
the rms over the samples of movement at which the true attitude is known; nothing is aligned
beforehand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fmu_src.errors import SteadytipError
from fmu_src.pack.compiled_runner import CompiledRunner
from fmu_src.pack.discovery import load_model
from harness.common.types import FloatArray
from harness.reproduce.experiments.broad import LIMITS, THINNED, BroadTrial, northward

__all__ = [
    "KINDS",
    "AttitudeErrors",
    "AttitudeEstimator",
    "errors",
    "estimators",
    "model_estimator",
    "vqf",
]

KINDS = ("total", "inclination", "heading")
GRAVITY = 9.813
"""Of Berlin [m/s2]."""
FIELD, DIP = 43.8e-6, np.radians(69.1)
"""Of the laboratory, as the unit has it at rest at the beginning of trial 02 [T, rad]."""
INTERVAL = 3.5e-3
"""Between samples of the unit [s]."""


@dataclass(frozen=True)
class AttitudeErrors:
    """Errors of an attitude over time, each (n,) [rad], at the samples that count."""

    time: FloatArray
    total: FloatArray
    inclination: FloatArray
    heading: FloatArray

    def rms(self, kind: str) -> float:
        """Return the rms of one of KINDS [rad]."""
        return float(np.sqrt(np.mean(getattr(self, kind) ** 2)))


@dataclass(frozen=True)
class AttitudeEstimator:
    """Estimator of the attitude, ours or another.

    Attributes:
        name: for people.
        sees: what it is given, in words.
        attitude: q_WB at each sample of a trial, (n, 4), causal.
    """

    name: str
    sees: str
    attitude: Callable[[BroadTrial], FloatArray]


def errors(trial: BroadTrial, attitude: FloatArray) -> AttitudeErrors:
    """Return errors of q_WB (n, 4) over the movement of a trial."""
    counted = trial.movement & trial.attitude_seen
    true, found = trial.attitude[counted], attitude[counted]
    w = np.sum(true * found, axis=1)
    vector = found[:, :1] * true[:, 1:] - true[:, :1] * found[:, 1:]
    vector = vector - np.cross(true[:, 1:], found[:, 1:])
    z = vector[:, 2]
    return AttitudeErrors(
        trial.time[counted],
        2 * np.arctan2(np.linalg.norm(vector, axis=1), np.abs(w)),
        2 * np.arctan2(np.hypot(vector[:, 0], vector[:, 1]), np.hypot(w, z)),
        2 * np.arctan2(np.abs(z), np.abs(w)),
    )


def estimators() -> list[AttitudeEstimator]:
    """Return all estimators that are compared.

    Raises:
        SteadytipError: VQF is not installed.
    """
    ours = {
        "EmInertialEkf": (
            "hybrid filter (RK) without EM",
            "rate, force, field",
            BroadTrial.inertial,
            {
                **LIMITS,
                "inertial.gravity": GRAVITY,
                "magnetic.strength": FIELD,
                "magnetic.inclination": DIP,
            },
        ),
        "OpticalGyroEkf": (
            "optical filter (C23)",
            f"rate, and an optical attitude at each {THINNED}th sample",
            lambda trial: {**trial.inertial(), **trial.optical(trial.thinned())},
            {**LIMITS, "rate_interval": INTERVAL, "lag_sigma": 0.01},
        ),
    }
    return [vqf(), *(model_estimator(model, *how) for model, how in ours.items())]


def vqf() -> AttitudeEstimator:
    """Return VQF with magnetometer, all parameters at their defaults.

    Raises:
        SteadytipError: the package is not installed.
    """
    try:
        from vqf import VQF
    except ImportError:
        raise SteadytipError("VQF is not installed: pip install 'steadytip[reproduce]'") from None

    def attitude(trial: BroadTrial) -> FloatArray:
        samples = (trial.rate, trial.force, trial.field)
        given = (np.ascontiguousarray(each, dtype=float) for each in samples)
        # Of the whole recording, but sample by sample: its filter of past and future is another.
        return northward(VQF(trial.period).updateBatch(*given)["quat9D"])

    return AttitudeEstimator("VQF 9D, defaults", "rate, force, field", attitude)


def model_estimator(
    model: str,
    name: str,
    sees: str,
    inputs: Callable[[BroadTrial], Mapping[str, FloatArray]],
    parameters: Mapping[str, Any] | None = None,
) -> AttitudeEstimator:
    """Return a model of this software as an estimator, at the sample period of the trial.

    Args:
        model: its name; it has the output field `attitude`.
        name: for people.
        sees: what it is given, in words.
        inputs: of a trial, as `Runner.run` takes them; those it has no field for are left out.
        parameters: other than the declared starts.
    """

    def attitude(trial: BroadTrial) -> FloatArray:
        runner = CompiledRunner(replace(load_model(model), sample_period=trial.period), parameters)
        known = runner.model.inputs.fields
        given = {field: values for field, values in inputs(trial).items() if field in known}
        return runner.run(len(trial), given)["attitude"]

    return AttitudeEstimator(name, sees, attitude)
