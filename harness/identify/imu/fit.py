"""Coefficients of the measurement model from a unit at rest on a turntable (A04 3.2.1, 3.2.2).

Least squares over all static positions at once, with the compensation of `fmu_src.estimation`. Its
output is compared with gravity, or the field, along the sensing axes at the angles of the
turntable.

    accelerometers    a_i(V) - Theta_i . R_TB^T (0, 0, g)              six for each position [m/s2]
    magnetometer      s_d(V) - Theta_d . R_TB^T N                      three [T]

A04 finds the same coefficients one after the other: bias and scale factor from two rests, then the
shift by the in-plane axis, then that of the other axis from several planes, then the directions in
which each channel reads most. Fitted together, none has to be small for the others to be right.

Some parameters keep their start, because a turntable cannot determine them: p_1 and q_1, which have
the effect of Theta. The mounting of the unit on the turntable cannot be determined either; it
defines B. The turntable's own delta, lambda and nu (see `turntable`) affect the accelerometers and
are fitted, too. The field N is unknown except for its strength, on which nothing depends. Drifts
with temperature are fitted if it varies.

Intervals are those of least squares whose errors differ between positions and are correlated within
one (clustered sandwich, Student's t), as the turntable's angle errors are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
from fmu_src.errors import SteadytipError
from fmu_src.estimation.micron import compensation
from fmu_src.estimation.micron.model import MODEL
from fmu_src.kit import Parameters
from fmu_src.kit.records import Scalar
from fmu_src.math import rotations
from harness.common.errors import ProblemsError
from harness.common.types import FloatArray
from harness.identify.imu.turntable import attitude, up
from harness.identify.parameter_files import write_parameters
from harness.recordings.turntable import StaticPositions

__all__ = [
    "CONFIDENCE",
    "Calibration",
    "FittedParameter",
    "calibrate",
    "linear",
    "write_calibration",
]

CONFIDENCE = 0.95
"""Confidence of the intervals."""
FEWEST = 24
"""Fewest positions: fewer do not separate three unknowns of every eight."""
REACHED = 0.9
"""Share of gravity that every axis must see in both directions."""
MIXED = 0.3
"""Least product of two axes' shares, of both signs; on an even grid it is 0.5."""
VARIED = 3.0
"""Least range of temperature for drifts to be fitted [K]."""
NEAR = 0.9
"""Least cosine between an axis and the vertical for a position of the linear model."""
UNLIKE = 1.0
"""Largest rms at which angles and volts belong together [m/s2]."""
STRAY = 0.2
"""Largest error of an accelerometer's scale, as a share of its data sheet."""
_GRAVITY = ca.vertcat(0, 0, design.SITE_GRAVITY)
_NUISANCE = ("alpha's zero", "tilt of its axis", "lack of 90 deg between the axes")


@dataclass(frozen=True)
class FittedParameter:
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
    """Result of a calibration on a turntable.

    Attributes:
        found: parameters; others keep their start values.
        table: errors of the turntable, by name, with half widths [rad].
        residual: residual of the accelerometers, (positions, 6) [m/s2].
        field_residual: field residual of the magnetometer, (positions, 3) [T]; None without one.
        inclination: inclination of the field below the horizon [rad]; NaN without a magnetometer.
        positions: static positions that were used.
        notes: sentences about what is unusual but may be right.
    """

    found: tuple[FittedParameter, ...]
    table: Mapping[str, tuple[float, float]]
    residual: FloatArray
    field_residual: FloatArray | None
    inclination: float
    positions: StaticPositions
    notes: tuple[str, ...] = ()

    def parameters(self) -> dict[str, float]:
        """Return the values by name of the element."""
        return {one.scalar.name: one.value for one in self.found}


@dataclass(frozen=True)
class _Problem:
    """A least squares problem: residuals of one position as a function of unknowns and data.

    Attributes:
        residual: `(unknowns, data) -> (m,)` and its Jacobian by the unknowns.
        names: names of the scalars that are unknown; the unknowns after them are nuisance.
        sizes: typical size of each unknown.
    """

    residual: ca.Function
    names: tuple[str, ...]
    sizes: FloatArray


_THERMAL = ("zero_drift", "scale_drift")
_SIZES = {
    "zero": 0.1,
    "scale": 0.05,
    "scale_slope": 1e-3,
    "scale_curvature": 1e-4,
    "in_plane_squared": 1e-3,
    "out_of_plane_squared": 1e-3,
    "misalignment": 0.03,
    "zero_drift": 1e-3,
    "scale_drift": 1e-4,
}
"""Typical size of the fields that are unknown; that of `scale` is a share of its start."""


def _rotated(alpha: Any, beta: Any, errors: Any, v: Any) -> Any:
    """Return R_TB^T v of `turntable.attitude` as an expression; errors delta, lambda, nu."""
    zero, level, square = errors[0], errors[1], errors[2]

    def turn(axis: int, angle: Any, vector: Any) -> Any:
        theta = ca.SX.zeros(3)
        theta[axis] = -angle
        return rotations.matrix(rotations.from_rotation_vector(theta)) @ vector

    return turn(2, beta, turn(0, square, turn(1, -(alpha + zero), turn(0, level, v))))


def _field(scalar: Scalar) -> str:
    return scalar.name.split(".")[1].split("[")[0]


@cache
def _problem(
    record: type[Parameters],
    prefix: str,
    thermal: bool,
    nuisance: tuple[float, ...],
    build: Callable[[Any, Any, Any], Any],
) -> _Problem:
    """Build the problem of the unknown elements of a sensor's record.

    Args:
        record: the record; elements that are not unknown have their starts.
        prefix: prefix of its elements.
        thermal: True if drifts with temperature are unknown.
        nuisance: typical sizes of the unknowns that are no elements.
        build: makes the residual from the record, the nuisance and the data (9).
    """
    elements = list(record.scalars(prefix))
    scalars = [
        s for s in elements if (field := _field(s)) in _SIZES and (thermal or field not in _THERMAL)
    ]
    n = len(scalars)
    unknowns, data = ca.SX.sym("x", n + len(nuisance)), ca.SX.sym("d", 9)
    unknown = {scalar.name: unknowns[i] for i, scalar in enumerate(scalars)}
    p = record.unpack(ca.vertcat(*(unknown.get(s.name, s.start) for s in elements)))
    residual = build(p, unknowns[n:], data)
    jacobian = ca.densify(ca.jacobian(residual, unknowns))
    function = ca.Function("residual", [unknowns, data], [residual, jacobian], {"cse": True})
    sizes = [_SIZES[_field(s)] * (s.start if _field(s) == "scale" else 1) for s in scalars]
    return _Problem(function, tuple(unknown), np.array([*sizes, *nuisance]))


def _accelerometer_residual(p: Any, errors: Any, data: Any) -> Any:
    """Return the residual; errors of the turntable; data alpha, beta, dt, volts (6)."""
    gravity = _rotated(data[0], data[1], errors, _GRAVITY)
    a = compensation.uncross(p, compensation.linear(p, data[3:], data[2]))
    rows = [
        compensation.sensing_axis(axis, p.misalignment[i, :])
        for i, (_, axis) in enumerate(kinematics.PLACES)
    ]
    return a - ca.vertcat(*(row.T @ gravity for row in rows))


def _magnetometer_residual(p: Any, angles: Any, data: Any) -> Any:
    """Return the residual; two angles of N; data alpha, beta, dt, errors (3), volts (3)."""
    heading, dip = angles[0], angles[1]
    north = ca.vertcat(ca.cos(dip) * ca.cos(heading), ca.cos(dip) * ca.sin(heading), -ca.sin(dip))
    felt = _rotated(data[0], data[1], data[3:6], design.MAGNETIC_FIELD * north)
    rows = [compensation.sensing_axis(axis, p.misalignment[axis, :]) for axis in range(3)]
    residual = compensation.linear(p, data[6:], data[2]) - ca.vertcat(*(r.T @ felt for r in rows))
    return 1e6 * residual  # in microtesla: solvers stop by absolute sizes, too


def _solve(problem: _Problem, start: FloatArray, data: FloatArray) -> tuple[FloatArray, ...]:
    """Return the unknowns, half widths of their intervals, residuals (positions, m).

    Raises:
        SteadytipError: the positions do not separate the unknowns.
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
    # Each channel has its own unknowns: a position gives one equation of each.
    free = max(len(data) - n / m, 1.0)
    covariance = bread @ (scores.T @ scores) @ bread * len(data) / free
    half = student.ppf((1 + CONFIDENCE) / 2, free) * np.sqrt(np.diag(covariance)) * problem.sizes
    return found.x, half, residual.reshape(-1, m)


def linear(positions: StaticPositions) -> dict[str, float]:
    """Compute bias and scale factor of each channel as the maker does (A04 3.1, 3.2).

    An accelerometer needs the two positions at which its axis points up and down, by the angles of
    the turntable. The magnetometer needs its extremes (A04 3.21, 3.22).

    Returns:
        Values by name of the estimator's parameter.

    Raises:
        SteadytipError: a channel never pointed up, or never down.
    """
    vertical = up(positions.alpha, positions.beta)
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
            ends[word] = positions.volts[sign * along > best - 1e-4, i].mean()
        scale = (ends["up"] - ends["down"]) / 2 / design.SITE_GRAVITY
        found[f"accelerometer.zero[{i + 1}]"] = (ends["up"] + ends["down"]) / 2
        found[f"accelerometer.scale[{i + 1}]"] = scale
    for i in range(positions.volts.shape[1] - len(kinematics.CHANNELS)):
        volts = positions.volts[:, len(kinematics.CHANNELS) + i]
        found[f"magnetometer.zero[{i + 1}]"] = (volts.max() + volts.min()) / 2
        found[f"magnetometer.scale[{i + 1}]"] = np.ptp(volts) / 2 / design.MAGNETIC_FIELD
    return {name: float(value) for name, value in found.items()}


def check_cover(positions: StaticPositions) -> list[str]:
    """Return sentences with a cure about missing positions; empty if they suffice."""
    problems = []
    if len(positions) < FEWEST:
        problems.append(
            f"{len(positions)} rests; at least {FEWEST} are needed, in different planes: "
            "`steadytip identify turntable` writes the angles of the procedure"
        )
    vertical = up(positions.alpha, positions.beta)
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


def calibrate(positions: StaticPositions, where: str = "rests") -> Calibration:
    """Find the coefficients.

    Args:
        positions: positions of the turntable's procedure; six or nine columns of volts.
        where: their name, for messages.

    Raises:
        ProblemsError: the positions are too few or too much alike, or angles do not explain them.
        SteadytipError: they do not separate the parameters.
    """
    problems = check_cover(positions) or _fit_problems(positions)
    if problems:
        raise ProblemsError(where, problems)
    thermal = positions.temperature is not None and float(np.ptp(positions.temperature)) >= VARIED
    reference = compensation.REFERENCE_TEMPERATURE
    change = np.zeros(len(positions))
    if positions.temperature is not None:
        reference = float(positions.temperature.mean())
        change = positions.temperature - reference
    first = linear(positions)
    problem = _problem(
        compensation.Accelerometer, "accelerometer.", thermal, (1e-3,) * 3, _accelerometer_residual
    )
    starts = {s.name: s.start for s in MODEL.parameters.scalars()} | first
    count = len(kinematics.CHANNELS)
    data = np.column_stack((positions.alpha, positions.beta, change, positions.volts[:, :count]))
    begin = np.array([*(starts[name] for name in problem.names), 0.0, 0.0, 0.0])
    x, half, residual = _solve(problem, begin, data)
    table = x[len(problem.names) :]
    values = dict(zip(problem.names, zip(x, half, strict=True), strict=False))
    field_residual, inclination = None, np.nan
    if positions.volts.shape[1] > count:
        problem = _problem(
            compensation.Magnetometer, "magnetometer.", thermal, (0.1, 0.1), _magnetometer_residual
        )
        errors = np.tile(table, (len(positions), 1))
        data = np.column_stack(
            (positions.alpha, positions.beta, change, errors, positions.volts[:, count:])
        )
        begin = np.array(
            [*(starts[name] for name in problem.names), *_first_north(positions, starts, count)]
        )
        y, widths, left = _solve(problem, begin, data)
        values |= dict(zip(problem.names, zip(y, widths, strict=True), strict=False))
        field_residual, inclination = 1e-6 * left, float(y[-1])
    values["thermometer.reference"] = (reference, np.nan)
    tail = zip(table, half[-3:], strict=True)
    return Calibration(
        tuple(
            FittedParameter(s, *values[s.name])
            for s in MODEL.parameters.scalars()
            if s.name in values
        ),
        dict(zip(_NUISANCE, ((float(v), float(w)) for v, w in tail), strict=True)),
        residual,
        field_residual,
        inclination,
        positions,
        (_thermal_note(positions),) if not thermal else (),
    )


def _thermal_note(positions: StaticPositions) -> str:
    if positions.temperature is None:
        return "there is no temperature: the parameters are those of the unit as warm as it was"
    return (
        f"the temperature varies by {np.ptp(positions.temperature):.2g} K only, and {VARIED:g} K "
        "are needed to find drifts; they stay at zero"
    )


def _first_north(
    positions: StaticPositions, starts: Mapping[str, float], at: int
) -> tuple[float, float]:
    """Return heading and dip of the field on the turntable, by the linear model [rad]."""
    zero, scale = (
        np.array([starts[f"magnetometer.{what}[{i}]"] for i in (1, 2, 3)])
        for what in ("zero", "scale")
    )
    mean = (
        attitude(positions.alpha, positions.beta)
        .apply((positions.volts[:, at:] - zero) / scale)
        .mean(0)
    )
    x, y, z = mean / np.linalg.norm(mean)
    return float(np.arctan2(y, x)), float(np.arcsin(-z))


def _fit_problems(positions: StaticPositions) -> list[str]:
    """Return sentences about channels that a linear fit by the angles does not explain."""
    felt = design.SITE_GRAVITY * up(positions.alpha, positions.beta)
    columns = np.column_stack((felt, np.ones(len(positions))))
    volts = positions.volts[:, : len(kinematics.CHANNELS)]
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


def write_calibration(path: Path, values: Mapping[str, float]) -> Path:
    """Write a parameter file for MicronEstimator.

    Raises:
        ProblemsError: the estimator would refuse values.
        SteadytipError: the file cannot be written.
    """
    return write_parameters(
        path,
        MODEL.parameters.scalars(),
        values,
        "the unit is farther off its data sheet than the estimator takes (are angles and volts in "
        "the units that were read?)",
    )
