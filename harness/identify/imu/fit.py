"""Coefficients of the measurement model from a unit at rest on a turntable (A04 3.2.1, 3.2.2).

Least squares over all rests at once, with the very compensation of `fmu_src.estimation`: what it
makes of the volts is set against what the sensing axes feel of gravity, or of the field, at the
angles of the turntable.

    accelerometers    a_i(V) - Theta_i . R_TB^T (0, 0, g)              six for each rest [m/s2]
    magnetometer      s_d(V) - Theta_d . R_TB^T N                      three [T]

A04 finds the same coefficients one after the other: bias and scale factor from two rests, then the
shift by the in-plane axis, then that of the other axis from several planes, then the directions in
which each channel reads most. Fitted together, none has to be small for the others to be right.

What a turntable cannot tell stays at its start: p_1 and q_1, which do what Theta does; and how the
unit sits on the turntable, which is what calibration then calls B. The turntable's own delta,
lambda and nu (see `turntable`) show in what the accelerometers read and are fitted along. The field
N is unknown but for its strength, which nothing depends on. Drifts with temperature are fitted
where it varies.

Intervals are those of least squares whose errors differ from rest to rest and go together within
one (clustered sandwich, Student's t), because the turntable's angle errors do.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from fmu_src.device import design
from fmu_src.device import sensing_kinematics as kinematics
from fmu_src.estimation.micron import compensation
from fmu_src.estimation.micron.model import MODEL
from fmu_src.kit import Parameters
from fmu_src.kit.records import Scalar
from fmu_src.math import rotations
from harness.common.errors import ProblemsError, SteadytipError
from harness.common.types import FloatArray
from harness.identify.imu.turntable import Rests, up
from harness.identify.parameter_files import write_scalars

__all__ = ["CONFIDENCE", "Calibration", "Found", "calibrate", "linear", "write_set"]

CONFIDENCE = 0.95
"""Of the intervals."""
FEWEST = 24
"""Rests: three unknowns of every eight are told apart by no fewer."""
REACHED = 0.9
"""Share of gravity that every axis has to have seen, both ways."""
MIXED = 0.3
"""Mean product of two axes' shares that rests must reach, in size; on an even grid it is 0.5."""
VARIED = 3.0
"""Temperatures have to differ by that for drifts to be fitted [K]."""
NEAR = 0.9
"""How near a rest has to be to an axis to stand for it in the linear model, as a cosine."""
UNLIKE = 1.0
"""Rms beyond which angles and volts do not belong together [m/s2]."""
STRAY = 0.2
"""Share by which no accelerometer's scale is off its data sheet."""
_GRAVITY = ca.vertcat(0, 0, design.SITE_GRAVITY)
_NUISANCE = ("alpha's zero", "tilt of its axis", "lack of 90 deg between the axes")


@dataclass(frozen=True)
class Found:
    """A parameter with its interval.

    Attributes:
        scalar: its name and declaration, under the name that the estimator has for it.
        value: in SI.
        half: half width of the interval of `CONFIDENCE`; NaN where none can be given.
    """

    scalar: Scalar
    value: float
    half: float


@dataclass(frozen=True)
class Calibration:
    """What a turntable tells.

    Attributes:
        found: parameters; those not named stay at their starts.
        table: errors of the turntable, by name, with half widths [rad].
        residual: of the accelerometers, (rests, 6) [m/s2].
        field_residual: of the magnetometer, (rests, 3) [T]; None without one.
        inclination: of the field below the horizon [rad]; NaN without a magnetometer.
        rests: that were used.
        notes: what is odd without being wrong; sentences.
    """

    found: tuple[Found, ...]
    table: Mapping[str, tuple[float, float]]
    residual: FloatArray
    field_residual: FloatArray | None
    inclination: float
    rests: Rests
    notes: tuple[str, ...] = ()

    def parameters(self) -> dict[str, float]:
        """By the name of the element."""
        return {one.scalar.name: one.value for one in self.found}


@dataclass(frozen=True)
class _Problem:
    """A least squares problem: residuals of one rest as a function of unknowns and data.

    Attributes:
        residual: `(unknowns, data) -> (m,)` and its Jacobian by the unknowns.
        names: of the scalars that are unknown; what follows them in the unknowns is nuisance.
        sizes: typical size of each unknown.
    """

    residual: ca.Function
    names: tuple[str, ...]
    sizes: FloatArray


_ACCELEROMETER = (
    "zero",
    "scale",
    "in_plane_squared",
    "out_of_plane_squared",
    "scale_slope",
    "scale_curvature",
    "misalignment",
)
_MAGNETOMETER = ("zero", "scale", "misalignment")
_THERMAL = ("zero_drift", "scale_drift")
_SIZES = {
    "zero": 0.1,
    "scale_slope": 1e-3,
    "scale_curvature": 1e-4,
    "in_plane_squared": 1e-3,
    "out_of_plane_squared": 1e-3,
    "misalignment": 0.03,
    "zero_drift": 1e-3,
    "scale_drift": 1e-4,
}


def _scalars(record: type[Parameters], prefix: str, fields: Iterable[str]) -> list[Scalar]:
    wanted = set(fields)
    return [s for s in record.scalars(prefix) if s.name[len(prefix) :].split("[")[0] in wanted]


def _sizes(scalars: Iterable[Scalar]) -> list[float]:
    sizes = []
    for scalar in scalars:
        field = scalar.name.split(".")[1].split("[")[0]
        sizes.append(0.05 * scalar.start if field == "scale" else _SIZES[field])
    return sizes


def _turned(alpha: Any, beta: Any, errors: Any, v: Any) -> Any:
    """R_TB^T v, of `turntable.attitude`, as an expression; errors delta, lambda, nu."""
    zero, level, square = errors[0], errors[1], errors[2]

    def turn(axis: int, angle: Any, vector: Any) -> Any:
        theta = ca.SX.zeros(3)
        theta[axis] = -angle
        return rotations.matrix(rotations.from_rotation_vector(theta)) @ vector

    return turn(2, beta, turn(0, square, turn(1, -(alpha + zero), turn(0, level, v))))


def _record(record: type[Parameters], prefix: str, scalars: list[Scalar], values: Any) -> Any:
    """A record whose named elements are unknown and the others at their starts."""
    unknown = {scalar.name: values[i] for i, scalar in enumerate(scalars)}
    column = [unknown.get(s.name, s.start) for s in record.scalars(prefix)]
    return record.unpack(ca.vertcat(*column))


def _function(unknowns: Any, data: Any, residual: Any) -> ca.Function:
    jacobian = ca.densify(ca.jacobian(residual, unknowns))
    return ca.Function("residual", [unknowns, data], [residual, jacobian], {"cse": True})


@cache
def _accelerometer_problem(thermal: bool) -> _Problem:
    """Unknown coefficients and the turntable's three errors; data alpha, beta, dt, volts (6)."""
    prefix, record = "accelerometer.", compensation.Accelerometer
    scalars = _scalars(record, prefix, (*_ACCELEROMETER, *(_THERMAL if thermal else ())))
    unknowns, data = ca.SX.sym("x", len(scalars) + 3), ca.SX.sym("d", 9)
    p = _record(record, prefix, scalars, unknowns)
    gravity = _turned(data[0], data[1], unknowns[len(scalars) :], _GRAVITY)
    a = compensation.uncross(p, compensation.linear(p, data[3:], data[2]))
    rows = [
        compensation.sensing_axis(axis, p.misalignment[i, :])
        for i, (_, axis) in enumerate(kinematics.PLACES)
    ]
    residual = a - ca.vertcat(*(row.T @ gravity for row in rows))
    sizes = [*_sizes(scalars), *[1e-3] * 3]
    names = tuple(scalar.name for scalar in scalars)
    return _Problem(_function(unknowns, data, residual), names, np.array(sizes))


@cache
def _magnetometer_problem(thermal: bool) -> _Problem:
    """Unknown coefficients and two angles of N; data alpha, beta, dt, table's errors, volts (3)."""
    prefix, record = "magnetometer.", compensation.Magnetometer
    scalars = _scalars(record, prefix, (*_MAGNETOMETER, *(_THERMAL if thermal else ())))
    unknowns, data = ca.SX.sym("x", len(scalars) + 2), ca.SX.sym("d", 9)
    p = _record(record, prefix, scalars, unknowns)
    heading, dip = unknowns[len(scalars)], unknowns[len(scalars) + 1]
    north = ca.vertcat(ca.cos(dip) * ca.cos(heading), ca.cos(dip) * ca.sin(heading), -ca.sin(dip))
    felt = _turned(data[0], data[1], data[3:6], design.MAGNETIC_FIELD * north)
    rows = [compensation.sensing_axis(axis, p.misalignment[axis, :]) for axis in range(3)]
    residual = compensation.linear(p, data[6:], data[2]) - ca.vertcat(*(r.T @ felt for r in rows))
    sizes = [*_sizes(scalars), 0.1, 0.1]
    names = tuple(scalar.name for scalar in scalars)
    # In microtesla: solvers stop by absolute sizes, too.
    return _Problem(_function(unknowns, data, 1e6 * residual), names, np.array(sizes))


def _solve(problem: _Problem, start: FloatArray, data: FloatArray) -> tuple[FloatArray, ...]:
    """Unknowns, half widths of their intervals, residuals (rests, m).

    Raises:
        SteadytipError: the rests do not tell the unknowns apart.
    """
    mapped = problem.residual.map(len(data))
    n = len(start)

    def evaluate(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        residual, jacobian = mapped(np.tile(x[:, None], len(data)), data.T)
        m = residual.shape[0]
        # Blocks of the Jacobian stand side by side, one for each rest.
        blocks = np.array(jacobian).reshape(m, len(data), n).transpose(1, 0, 2)
        return np.array(residual).T.ravel(), blocks.reshape(-1, n)

    found = least_squares(
        lambda x: evaluate(x)[0],
        start,
        lambda x: evaluate(x)[1],
        method="lm",
        x_scale=problem.sizes,
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
        max_nfev=200,
    )
    residual, J = evaluate(found.x)
    scaled = J * problem.sizes
    singular = np.linalg.svd(scaled, compute_uv=False)
    if not found.success or singular[-1] < 1e-6 * singular[0]:
        raise SteadytipError(
            "the rests do not tell the parameters apart; record all planes of the procedure, as "
            "`steadytip identify turntable` lists them"
        )
    m = len(residual) // len(data)
    bread = np.linalg.inv(scaled.T @ scaled)
    scores = np.einsum("rmi,rm->ri", scaled.reshape(len(data), m, n), residual.reshape(-1, m))
    # Each channel has its own unknowns, so that a rest stands for one equation of each.
    free = max(len(data) - n / m, 1.0)
    covariance = bread @ (scores.T @ scores) @ bread * len(data) / free
    half = student.ppf((1 + CONFIDENCE) / 2, free) * np.sqrt(np.diag(covariance)) * problem.sizes
    return found.x, half, residual.reshape(-1, m)


def linear(rests: Rests) -> dict[str, float]:
    """Bias and scale factor of each accelerometer channel as the maker has it (A04 3.1, 3.2).

    From the two rests at which its axis points up and down, as far as the turntable knows; the
    magnetometer from its extremes (A04 3.21, 3.22).

    Returns:
        Values by the name that the estimator has for them.

    Raises:
        SteadytipError: a channel never pointed up, or never down.
    """
    vertical = up(rests.alpha, rests.beta)
    found: dict[str, float] = {}
    for i, channel in enumerate(kinematics.CHANNELS):
        along = vertical[:, kinematics.PLACES[i][1]]
        ends = {}
        for word, sign in (("up", 1.0), ("down", -1.0)):
            best = float((sign * along).max())
            if best < NEAR:
                off = np.degrees(np.arccos(best))
                raise SteadytipError(
                    f"channel {channel} never points {word} (nearest: {off:.3g} deg off); the "
                    "linear model is made from those two rests"
                )
            ends[word] = rests.volts[sign * along > best - 1e-4, i].mean()
        scale = (ends["up"] - ends["down"]) / 2 / design.SITE_GRAVITY
        found[f"accelerometer.zero[{i + 1}]"] = (ends["up"] + ends["down"]) / 2
        found[f"accelerometer.scale[{i + 1}]"] = scale
    for i in range(rests.volts.shape[1] - len(kinematics.CHANNELS)):
        volts = rests.volts[:, len(kinematics.CHANNELS) + i]
        found[f"magnetometer.zero[{i + 1}]"] = (volts.max() + volts.min()) / 2
        found[f"magnetometer.scale[{i + 1}]"] = np.ptp(volts) / 2 / design.MAGNETIC_FIELD
    return {name: float(value) for name, value in found.items()}


def check_cover(rests: Rests) -> list[str]:
    """What rests lack, in sentences with a cure; none if they will do."""
    problems = []
    if len(rests) < FEWEST:
        problems.append(
            f"{len(rests)} rests; at least {FEWEST} are needed, in different planes: `steadytip "
            "identify turntable` writes the angles of the procedure"
        )
    vertical = up(rests.alpha, rests.beta)
    for axis, name in enumerate("xyz"):
        for word, sign in (("up", 1.0), ("down", -1.0)):
            best = float((sign * vertical[:, axis]).max())
            if best < REACHED:
                problems.append(
                    f"{name} never points {word}: of gravity it sees {best:.2g} at most, and "
                    f"{REACHED:g} is needed; add such a rest"
                )
    for i, j in ((0, 1), (0, 2), (1, 2)):
        product = vertical[:, i] * vertical[:, j]
        if max(product.max(), 0) < MIXED or max(-product.min(), 0) < MIXED:
            problems.append(
                f"{'xyz'[i]} and {'xyz'[j]} are never both far from the horizon, with equal and "
                "with opposite signs; add rests between the axes"
            )
    return problems


def calibrate(rests: Rests, where: str = "rests") -> Calibration:
    """Find the coefficients.

    Args:
        rests: of the turntable's procedure; six or nine columns of volts.
        where: their name, for messages.

    Raises:
        ProblemsError: rests that are too few or too much alike, or that angles do not explain.
        SteadytipError: they do not tell the parameters apart.
    """
    problems = check_cover(rests) or _unlike(rests)
    if problems:
        raise ProblemsError(where, problems)
    thermal = rests.temperature is not None and float(np.ptp(rests.temperature)) >= VARIED
    reference = compensation.REFERENCE_TEMPERATURE
    change = np.zeros(len(rests))
    if rests.temperature is not None:
        reference = float(rests.temperature.mean())
        change = rests.temperature - reference
    first = linear(rests)
    problem = _accelerometer_problem(thermal)
    starts = {s.name: s.start for s in MODEL.parameters.scalars()} | first
    count = len(kinematics.CHANNELS)
    data = np.column_stack((rests.alpha, rests.beta, change, rests.volts[:, :count]))
    begin = np.array([*(starts[name] for name in problem.names), 0.0, 0.0, 0.0])
    x, half, residual = _solve(problem, begin, data)
    table = x[len(problem.names) :]
    values = dict(zip(problem.names, zip(x, half, strict=True), strict=False))
    field_residual, inclination = None, np.nan
    if rests.volts.shape[1] > count:
        problem = _magnetometer_problem(thermal)
        errors = np.tile(table, (len(rests), 1))
        data = np.column_stack((rests.alpha, rests.beta, change, errors, rests.volts[:, count:]))
        begin = np.array(
            [*(starts[name] for name in problem.names), *_first_north(rests, starts, count)]
        )
        y, widths, left = _solve(problem, begin, data)
        values |= dict(zip(problem.names, zip(y, widths, strict=True), strict=False))
        field_residual, inclination = 1e-6 * left, float(y[-1])
    values["thermometer.reference"] = (reference, np.nan)
    tail = zip(table, half[-3:], strict=True)
    return Calibration(
        tuple(Found(s, *values[s.name]) for s in MODEL.parameters.scalars() if s.name in values),
        dict(zip(_NUISANCE, ((float(v), float(w)) for v, w in tail), strict=True)),
        residual,
        field_residual,
        inclination,
        rests,
        (_thermal_note(rests),) if not thermal else (),
    )


def _thermal_note(rests: Rests) -> str:
    if rests.temperature is None:
        return "there is no temperature: the parameters are those of the unit as warm as it was"
    return (
        f"the temperature varies by {np.ptp(rests.temperature):.2g} K only, and {VARIED:g} K are "
        "needed to find drifts; they stay at zero"
    )


def _first_north(rests: Rests, starts: Mapping[str, float], at: int) -> tuple[float, float]:
    """Heading and dip of the field on the turntable, by the linear model [rad]."""
    from harness.identify.imu.turntable import attitude

    zero, scale = (
        np.array([starts[f"magnetometer.{what}[{i}]"] for i in (1, 2, 3)])
        for what in ("zero", "scale")
    )
    mean = attitude(rests.alpha, rests.beta).apply((rests.volts[:, at:] - zero) / scale).mean(0)
    x, y, z = mean / np.linalg.norm(mean)
    return float(np.arctan2(y, x)), float(np.arcsin(-z))


def _unlike(rests: Rests) -> list[str]:
    """Whether angles and volts belong together, by a straight fit of each channel."""
    felt = design.SITE_GRAVITY * up(rests.alpha, rests.beta)
    columns = np.column_stack((felt, np.ones(len(rests))))
    volts = rests.volts[:, : len(kinematics.CHANNELS)]
    slopes = np.linalg.lstsq(columns, volts, rcond=None)[0]
    left = np.sqrt(np.mean((volts - columns @ slopes) ** 2, axis=0)) / design.ACCELEROMETER_SCALE
    problems = []
    for i, (channel, (_, axis)) in enumerate(
        zip(kinematics.CHANNELS, kinematics.PLACES, strict=True)
    ):
        slope, nominal = slopes[:3, i], design.ACCELEROMETER_SCALE
        if left[i] > UNLIKE:
            problems.append(
                f"the angles do not explain channel {channel}: {left[i]:.3g} m/s2 rms is left; "
                "check columns, units and signs of alpha and beta"
            )
        elif abs(slope[axis] / nominal - 1) > STRAY:
            most = int(np.abs(slope).argmax())
            sign = "-" if slope[most] < 0 else ""
            problems.append(
                f"channel {channel} has {slope[axis]:.3g} V.s2/m along {'xyz'[axis]}, where the "
                f"data sheet has {nominal:.3g}, and goes with {sign}{'xyz'[most]}; is it another "
                "channel, or does the unit sit on the turntable in another way?"
            )
    return problems


def write_set(path: Path, values: Mapping[str, float]) -> Path:
    """Write parameters of MicronEstimator as a set (`.ssv`) that any run of it accepts.

    Raises:
        ProblemsError: values that the estimator would refuse.
        SteadytipError: the file cannot be written.
    """
    found = [(s, values[s.name]) for s in MODEL.parameters.scalars() if s.name in values]
    return write_scalars(
        path,
        found,
        "the unit is farther off its data sheet than the estimator takes (are angles and volts in "
        "the units that were read?)",
    )
