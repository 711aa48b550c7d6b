"""Hand-eye rotation between an inertial unit and a tracker's sensor, from a recording (RK III.B).

    A_k X = X B_k                               RK's AX = XB, relative rotations of unit and coils
    z_k  = r* (x) q_0 (x) c(t_k + tau) (x) h    all of them at once, with the gyro's bias in c

| symbol | meaning |
| --- | --- |
| z_k, t_k | attitude of the coils C in the tracker's frame F, and when it was measured [s] |
| c(t) | turn of the body B since the start, by the gyro less its bias b [rad/s] |
| h | hand-eye rotation q_BC: X |
| r | registration q_WF |
| q_0 | attitude of B at the start |
| tau | by which the gyro is behind the tracker's clock [s] |

h starts from the rotation that fits the vectors of relative rotations best (Park and Martin 1994,
in Kabsch's form); h, b, tau and r* (x) q_0 are then fitted to all attitudes by least squares. What
the fit leaves is distortion by metal more than noise, and slow: covariances are those of sums over
blocks of the recording (the sandwich), which takes neighbouring residuals for one. Intervals of
95 % by Student's t of that number of blocks. What goes with the attitude, distortion or scale and
alignment of the gyro, is in none of them: h is the rotation to the gyro's axes as they are.

Where specific force and field were recorded, too, r follows: up and north in F, averaged over all
instants at which the force is as long as gravity (RK III.B: several pairs).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage, stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fmu_src.device import design
from fmu_src.estimation.em_ekf import MODEL
from harness.common.errors import SteadytipError
from harness.common.files import reason
from harness.common.types import FloatArray
from harness.identify.parameter_files import write_scalars
from harness.recordings.tables import Table, read_table
from harness.report.page import Plot, Section, made_with, write_sections
from harness.report.page import Table as Shown
from harness.report.plots import SERIES, layout, line

__all__ = ["HandEye", "Recorded", "identify", "read", "table_of", "write_page", "write_set"]

FEWEST = 100
"""Attitudes of the tracker that a recording has at least."""
SHORTEST = 5.0
"""Length of a recording at least [s]."""
APART = 0.5
"""Time between the attitudes of a pair [s]."""
SECOND_AXIS = np.radians(3.0)
"""Least rms turn of the pairs about a second axis, for all of h to be seen."""
BLOCKS, SHORTEST_BLOCK = 20, 1.0
"""Blocks of residuals, and their least length [s]."""
LARGEST_LAG = 0.15
"""Of either sign, that is looked for [s]."""
QUIET = 0.2
"""Departure of the specific force from gravity up to which it shows the vertical [m/s2]."""
AVERAGED = 0.05
"""Over which forces and fields are averaged [s]."""
ROUNDS = 3
_FACTORS: Mapping[str, Mapping[str, float]] = {
    "rate": {"rad/s": 1.0, "deg/s": np.pi / 180},
    "force": {"m/s2": 1.0, "m/s^2": 1.0, "g": design.STANDARD_GRAVITY},
    "field": {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "G": 1e-4},
}
"""Factors to SI by the unit's name; the first is assumed where a heading has none."""


@dataclass(frozen=True)
class Recorded:
    """A recording of both.

    Attributes:
        path: file that it comes from.
        time: of the inertial samples, (n,) [s].
        rate: body rate, (n, 3) [rad/s].
        force: specific force, (n, 3) [m/s2]; None if it was not recorded.
        field: magnetic field, (n, 3) [T]; None if it was not recorded.
        measured: when the tracker measured, (m,) [s].
        attitude: what it measured, m.
    """

    path: Path
    time: FloatArray
    rate: FloatArray
    force: FloatArray | None
    field: FloatArray | None
    measured: FloatArray
    attitude: Rotation


@dataclass(frozen=True)
class HandEye:
    """What was identified; intervals are half the width of those of 95 %.

    Attributes:
        mounting: h.
        mounting_sigma: standard deviation of its error, a rotation vector in C, (3,) [rad].
        bias: of the gyro, (3,) [rad/s].
        bias_sigma: (3,) [rad/s].
        lag: tau [s].
        lag_sigma: [s].
        registration: r; None without force and field.
        registration_sigma: of an error in F, (3,) [rad]; None without.
        factor: half width of an interval of 95 % over a standard deviation.
        time: of the residuals, (m,) [s].
        residual: rotation vectors that the fit leaves, in C, (m, 3) [rad].
    """

    mounting: Rotation
    mounting_sigma: FloatArray
    bias: FloatArray
    bias_sigma: FloatArray
    lag: float
    lag_sigma: float
    registration: Rotation | None
    registration_sigma: FloatArray | None
    factor: float
    time: FloatArray
    residual: FloatArray


def read(path: Path, unit: str | None = None, tracker: str | None = None) -> Recorded:
    """Read a recording, such as `steadytip run em_tracking --csv` writes.

    Args:
        path: text table or Parquet with columns `time`, `rate_x..z`, `em_attitude_w..z`, and if
            they are there `em_new`, `em_age`, `force_x..z`, `field_x..z`, with `PART.` or without.
        unit: part that the inertial columns belong to; None for the one that has rate and force.
        tracker: part that the tracker's columns belong to.

    Raises:
        SteadytipError: no such file, columns that are missing or ambiguous, or too little of it.
    """
    table = read_table(path)
    unit = unit or _part(table, "inertial unit", "--unit", "rate_x", "force_x")
    tracker = tracker or _part(table, "tracker", "--tracker", "em_attitude_w")
    time = _column(table, "", "time")
    if time is None:
        raise SteadytipError(f"recording {path} has no column 'time' (there are: {table.columns})")
    rate = _triad(table, unit, "rate", "xyz")
    quaternions = _triad(table, tracker, "em_attitude", "wxyz")
    if rate is None or quaternions is None:
        missing = "rate_x..z" if rate is None else "em_attitude_w..z"
        raise SteadytipError(
            f"recording {path} has no columns {missing} (there are: {table.columns})"
        )
    whole = np.isfinite(time) & np.isfinite(rate).all(axis=1)
    if not whole.all() or not np.all(np.diff(time) > 0):
        bad = int(np.argmin(whole)) if not whole.all() else int(np.argmin(np.diff(time) > 0)) + 1
        raise SteadytipError(
            f"recording {path}, {table.row} {int(table.lines[bad])}: time must rise and the rate be"
            " a number; cut the recording there"
        )
    new = _column(table, tracker, "em_new")
    changed = np.append(True, np.any(np.diff(quaternions, axis=0) != 0, axis=1))
    length = np.linalg.norm(quaternions, axis=1)
    arrived = changed if new is None else new > 0.5
    arrived &= np.isfinite(length) & (np.abs(length - 1) < 0.1)
    age = _column(table, tracker, "em_age")
    measured = time[arrived] - (0.0 if age is None else age[arrived])
    inside = (measured > time[0] + LARGEST_LAG) & (measured < time[-1] - LARGEST_LAG)
    if inside.sum() < FEWEST or time[-1] - time[0] < SHORTEST:
        raise SteadytipError(
            f"recording {path} holds {inside.sum()} attitudes in {time[-1] - time[0]:.3g} s; at "
            f"least {FEWEST} in {SHORTEST:g} s are needed"
        )
    return Recorded(
        path,
        time,
        rate,
        _triad(table, unit, "force", "xyz"),
        _triad(table, unit, "field", "xyz"),
        measured[inside],
        Rotation.from_quat(quaternions[arrived][inside], scalar_first=True),
    )


def _part(table: Table, what: str, option: str, *names: str) -> str:
    """The one part whose columns have these names; empty where they stand alone."""
    found = [
        heading[: -len(names[0])].rstrip(".")
        for heading in table.headings
        if heading == names[0] or heading.endswith(f".{names[0]}")
    ]
    if len(found) > 1:  # the others tell which is meant
        full = set(table.headings)
        found = [p for p in found if all(f"{p}.{n}".lstrip(".") in full for n in names)] or found
    if len(found) != 1:
        raise SteadytipError(
            f"recording {table.path}: columns '{names[0]}' of the {what} are in "
            f"{', '.join(found) or 'no part'}; say which with {option} PART (there are: "
            f"{table.columns})"
        )
    return found[0]


def _column(table: Table, part: str, name: str) -> FloatArray | None:
    heading = f"{part}.{name}".lstrip(".")
    if heading not in table.headings:
        return None
    values: FloatArray = table.values[:, table.headings.index(heading)]
    return values


def _triad(table: Table, part: str, name: str, axes: str) -> FloatArray | None:
    """Columns of a vector in SI, (n, axes)."""
    columns = [_column(table, part, f"{name}_{axis}") for axis in axes]
    if any(column is None for column in columns):
        return None
    unit = table.units[table.headings.index(f"{part}.{name}_{axes[0]}".lstrip("."))]
    known = _FACTORS.get(name, {"": 1.0})
    if unit and name in _FACTORS and unit not in known:
        raise SteadytipError(
            f"recording {table.path}: {name} in '{unit}'; known are {', '.join(known)}"
        )
    factor = known.get(unit, 1.0)
    return factor * np.column_stack([c for c in columns if c is not None])


class _Turns:
    """Turn of the body since the start by the gyro less a bias, and what a change of it does."""

    def __init__(self, recorded: Recorded, bias: FloatArray) -> None:
        self.time, self.rate = recorded.time, recorded.rate - bias
        step = np.diff(self.time)
        mean = (self.rate[1:] + self.rate[:-1]) / 2
        quaternions = Rotation.from_rotvec(mean * step[:, None]).as_quat()
        quaternions = np.vstack(([0.0, 0.0, 0.0, 1.0], quaternions))
        shift = 1
        while shift < len(quaternions):  # all products of the first k in log2(n) rounds
            joined = Rotation.from_quat(quaternions[:-shift]) * Rotation.from_quat(
                quaternions[shift:]
            )
            quaternions[shift:] = joined.as_quat()
            shift *= 2
        self.turn = Rotation.from_quat(quaternions)
        matrices = self.turn.as_matrix()
        area = np.zeros_like(matrices)
        area[1:] = np.cumsum((matrices[1:] + matrices[:-1]) / 2 * step[:, None, None], axis=0)
        # R(t)^T times the integral of R: turn back in B by a change of the bias.
        self.slope = matrices.swapaxes(1, 2) @ area

    def at(self, time: FloatArray, change: FloatArray) -> Rotation:
        """Turn until some instants, with the bias changed by a little, (3,)."""
        place = np.clip(np.searchsorted(self.time, time) - 1, 0, len(self.time) - 2)
        after = time - self.time[place]
        step = (self.time[place + 1] - self.time[place])[:, None]
        half = self.rate[place] + (self.rate[place + 1] - self.rate[place]) / step * (
            after[:, None] / 2
        )
        missed = -self.slope[place] @ change
        return (
            self.turn[place]
            * Rotation.from_rotvec(missed)
            * Rotation.from_rotvec(half * after[:, None])
        )


def identify(recorded: Recorded) -> HandEye:
    """Fit the hand-eye rotation and what else is unknown.

    Raises:
        SteadytipError: a recording that turns about one axis only.
    """
    z, at = recorded.attitude, recorded.measured
    bias, lag = np.zeros(3), 0.0
    turns = _Turns(recorded, bias)
    start, hand = _first(turns.at(at, bias), z, at, recorded.path)
    limit = np.full(10, np.inf)
    limit[9] = LARGEST_LAG
    for _ in range(ROUNDS):

        def residual(
            x: FloatArray, known: tuple[_Turns, Rotation, Rotation] = (turns, start, hand)
        ) -> FloatArray:
            turns, start, hand = known
            body = start * Rotation.from_rotvec(x[:3]) * turns.at(at + x[9], x[6:9])
            predicted = body * hand * Rotation.from_rotvec(x[3:6])
            left: FloatArray = (predicted.inv() * z).as_rotvec().ravel()
            return left

        begin = np.append(np.zeros(9), lag)
        found = least_squares(residual, begin, bounds=(-limit, limit), x_scale="jac")
        start = start * Rotation.from_rotvec(found.x[:3])
        hand = hand * Rotation.from_rotvec(found.x[3:6])
        bias, lag = bias + found.x[6:9], float(found.x[9])
        turns = _Turns(recorded, bias)
    covariance, factor = _sandwich(found.jac, found.fun, at)
    sigma = np.sqrt(np.diag(covariance))
    registration = _registration(recorded, hand)
    return HandEye(
        mounting=hand,
        mounting_sigma=sigma[3:6],
        bias=bias,
        bias_sigma=sigma[6:9],
        lag=lag,
        lag_sigma=float(sigma[9]),
        registration=registration[0] if registration else None,
        registration_sigma=registration[1] if registration else None,
        factor=factor,
        time=at,
        residual=found.fun.reshape(-1, 3),
    )


def _first(turns: Rotation, z: Rotation, at: FloatArray, path: Path) -> tuple[Rotation, Rotation]:
    """r* (x) q_0 and h from relative rotations."""
    later = np.searchsorted(at, at + APART)
    first = np.flatnonzero(later < len(at))
    later = later[first]
    body = (turns[first].inv() * turns[later]).as_rotvec()
    coils = (z[first].inv() * z[later]).as_rotvec()
    spread = np.linalg.svd(body, compute_uv=False) / np.sqrt(len(body))
    if spread[1] < SECOND_AXIS:
        raise SteadytipError(
            f"recording {path}: pairs of attitudes {APART:g} s apart turn by "
            f"{np.degrees(spread[0]):.3g} deg rms about one axis and {np.degrees(spread[1]):.3g} "
            f"deg about the next, which must be {np.degrees(SECOND_AXIS):.2g} at least; turn the "
            "instrument about two axes, further or faster"
        )
    hand, _ = Rotation.align_vectors(body, coils)
    return (z * hand.inv() * turns.inv()).mean(), hand


def _sandwich(
    jacobian: FloatArray, residual: FloatArray, at: FloatArray
) -> tuple[FloatArray, float]:
    """Covariance of a fit whose residuals are alike within blocks, and Student's factor."""
    block = max((at[-1] - at[0]) / BLOCKS, SHORTEST_BLOCK)
    number = np.repeat(((at - at[0]) / block).astype(int), 3)
    blocks = np.unique(number)
    bread = np.linalg.inv(jacobian.T @ jacobian)
    weighted = jacobian * residual[:, None]
    sums = np.array([weighted[number == k].sum(axis=0) for k in blocks])
    count = len(blocks)
    covariance = bread @ (sums.T @ sums) @ bread * count / (count - 1)
    return covariance, float(stats.t.ppf(0.975, count - 1))


def _registration(recorded: Recorded, hand: Rotation) -> tuple[Rotation, FloatArray] | None:
    """r, and the standard deviation of its error in F; None without force and field."""
    if recorded.force is None or recorded.field is None:
        return None
    period = float(np.median(np.diff(recorded.time)))
    size = max(round(AVERAGED / period), 1)
    place = np.clip(np.searchsorted(recorded.time, recorded.measured), 0, len(recorded.time) - 1)
    force, field = (
        ndimage.uniform_filter1d(values, size, axis=0)[place]
        for values in (recorded.force, recorded.field)
    )
    length = np.linalg.norm(force, axis=1)
    quiet = np.abs(length - design.SITE_GRAVITY) < QUIET
    if quiet.sum() < FEWEST:
        return None
    body = recorded.attitude[quiet] * hand.inv()
    up = body.apply(force[quiet] / length[quiet, None])
    north = body.apply(field[quiet])

    def frame(up: FloatArray, north: FloatArray) -> Rotation:
        z = up / np.linalg.norm(up)
        y = np.cross(z, north)
        y /= np.linalg.norm(y)
        return Rotation.from_matrix(np.array([np.cross(y, z), y, z]))

    whole = frame(up.mean(axis=0), north.mean(axis=0))
    parts = np.array_split(np.arange(len(up)), BLOCKS)
    apart = [
        (whole.inv() * frame(up[part].mean(axis=0), north[part].mean(axis=0))).as_rotvec()
        for part in parts
    ]
    return whole, np.std(apart, axis=0, ddof=1) / np.sqrt(BLOCKS)


def table_of(found: HandEye) -> Shown:
    """What was identified, for people."""
    degrees = np.degrees
    rows = []

    def add(name: str, values: FloatArray, sigma: FloatArray, unit: str) -> None:
        axes = ("",) if len(values) == 1 else (" x", " y", " z")
        for axis, value, half in zip(axes, values, found.factor * sigma, strict=True):
            rows.append((name + axis, f"{value:.4f}", f"{half:.4f}", unit))

    add("hand-eye rotation h", degrees(found.mounting.as_rotvec()),
        degrees(found.mounting_sigma), "deg")  # fmt: skip
    if found.registration is not None and found.registration_sigma is not None:
        add("registration r", degrees(found.registration.as_rotvec()),
            degrees(found.registration_sigma), "deg")  # fmt: skip
    add("bias of the gyro", degrees(found.bias), degrees(found.bias_sigma), "deg/s")
    add("lag of the gyro", np.array([1e3 * found.lag]), np.array([1e3 * found.lag_sigma]), "ms")
    left = degrees(np.sqrt(np.mean(found.residual**2, axis=0)))
    rows += [
        (f"left of the fit {a}", f"{v:.4f}", "", "deg") for a, v in zip("xyz", left, strict=True)
    ]
    return Shown(("quantity", "value", "± (95 %)", "unit"), tuple(rows), frozenset({1, 2}))


def write_set(path: Path, found: HandEye) -> Path:
    """Write hand-eye rotation, registration and lag as a parameter set for `EmInertialEkf`.

    Raises:
        ProblemsError: values that the model would refuse.
        SteadytipError: the file cannot be written.
    """
    rms = {
        "tracker.mounting_sigma": float(np.sqrt(np.mean(found.mounting_sigma**2))),
        "tracker.lag": found.lag,
    }
    vectors = {"tracker.mounting": found.mounting.as_rotvec()}
    if found.registration is not None and found.registration_sigma is not None:
        vectors["tracker.registration"] = found.registration.as_rotvec()
        rms["tracker.registration_sigma"] = float(np.sqrt(np.mean(found.registration_sigma**2)))
    values = rms | {
        f"{name}[{i + 1}]": float(v)
        for name, vector in vectors.items()
        for i, v in enumerate(vector)
    }
    scalars = [(s, values[s.name]) for s in MODEL.parameters.scalars() if s.name in values]
    assert len(scalars) == len(values)
    return write_scalars(path, scalars, "the recording does not suit the model")


def write_page(path: Path, recorded: Recorded, found: HandEye) -> Path:
    """Write the page beside the parameter set.

    Raises:
        SteadytipError: the file cannot be written.
    """
    import plotly.graph_objects as go

    plot = go.Figure()
    for axis, colour, values in zip("xyz", SERIES, found.residual.T, strict=False):
        plot.add_trace(line(found.time, np.degrees(values), colour, axis))
    plot.update_xaxes(title_text="time, s")
    plot.update_yaxes(title_text="deg")
    residual = Plot(
        "What the fit leaves",
        "Rotation vectors from the predicted to the measured attitude of the coils, in their "
        "frame. What is slow in them is distortion, or scale of the gyro.",
        layout(plot, 380),
    )
    text = f"{len(found.time)} attitudes in {recorded.time[-1] - recorded.time[0]:.4g} s."
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_sections(
            path,
            "Hand-eye rotation",
            recorded.path.name,
            ("Rotation from the inertial unit to the tracker's coils, RK III.B.",),
            [Section("Fit", (text,), (table_of(found),), (residual,))],
            made_with("numpy", "scipy", "plotly"),
        )
    except OSError as error:
        raise SteadytipError(f"{path} cannot be written: {reason(error)}") from None
