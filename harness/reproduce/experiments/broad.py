"""The BROAD recordings: an inertial unit beside optical motion capture, as inputs of estimators.

Laidig, Caruso, Cereatti, Seel: BROAD - A Benchmark for Robust Inertial Orientation Estimation,
2021, doi 10.3390/data6070072. A trial is a MATLAB v5 file:

| variable | unit | here |
| --- | --- | --- |
| imu_gyr (n, 3) | rad/s | rate, body rate in B |
| imu_acc (n, 3) | m/s2 | force, specific force in B |
| imu_mag (n, 3) | uT | field in B [T] |
| opt_quat (n, 4) | 1 | attitude q_WB; in the file the world is east, north, up |
| opt_pos (n, 3) | m | position in W; likewise |
| movement (n,) | bool | movement, what counts |
| sampling_rate | Hz | period [s] |

W has x north, y west, z up, so that a tracker's pose and a compass agree on it. Nothing is smoothed
or interpolated: a value that is not finite is a lost sample, which keeps the value before it (zero,
or no rotation, at the start) and is told by `inertial_valid` or by the absence of `optical_new`.
The optical samples between those an estimator gets are held back as truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmu_src.errors import SteadytipError
from harness.common.errors import ProblemsError
from harness.common.files import reason
from harness.common.types import FloatArray

__all__ = [
    "FOLDER",
    "LIMITS",
    "SETTLING",
    "THINNED",
    "TRIALS",
    "BroadTrial",
    "northward",
    "occluded",
    "read_trial",
    "since",
]

FOLDER = "broad"
"""Of the trials, below the data folder."""
TRIALS = (
    "02_undisturbed_slow_rotation_B",
    "06_undisturbed_fast_rotation_A",
    "10_undisturbed_slow_translation_A",
    "25_disturbed_tapping_B",
    "33_disturbed_attached_magnet_2cm",
)
THINNED = 10
"""Inertial samples to an optical one, where optical samples are the rarer ones."""
LIMITS: Mapping[str, float] = {"limits.rate_range": 34.9, "limits.force_range": 157.0}
"""Of the unit, 2000 deg/s and 16 g: parameters of estimators."""
SETTLING = 10.0
"""Left out at the beginning of a trial [s]."""
_COLUMNS = {"imu_gyr": 3, "imu_acc": 3, "imu_mag": 3, "opt_quat": 4, "opt_pos": 3, "movement": 1}
_TESLA = 1e-6
_UNIT = 0.01
"""By which the length of a recorded quaternion may be off 1."""
_NORTH_FROM_EAST = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_HALF = np.sqrt(0.5)  # a quarter turn about z: quaternion (_HALF, 0, 0, -_HALF)

BoolArray = np.ndarray
IntArray = np.ndarray


@dataclass(frozen=True)
class BroadTrial:
    """One recording; every array has one row for each inertial sample.

    Attributes:
        name: the file's.
        period: of the samples [s].
        rate: body rate in B, (n, 3) [rad/s].
        force: specific force in B, (n, 3) [m/s2].
        field: magnetic field in B, (n, 3) [T].
        inertial_valid: none of these was lost, (n,).
        attitude: q_WB, (n, 4), scalar first; held where it was lost.
        position: in W, (n, 3) [m]; likewise.
        attitude_seen: the attitude was not lost, (n,).
        position_seen: the position was not lost, (n,).
        movement: what the data set's makers count, (n,).
    """

    name: str
    period: float
    rate: FloatArray
    force: FloatArray
    field: FloatArray
    inertial_valid: BoolArray
    attitude: FloatArray
    position: FloatArray
    attitude_seen: BoolArray
    position_seen: BoolArray
    movement: BoolArray

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.rate)

    @property
    def time(self) -> FloatArray:
        """Times of the samples, (n,) [s]."""
        return np.asarray(self.period * np.arange(len(self)))

    @property
    def optical_seen(self) -> BoolArray:
        """Attitude and position are known, (n,)."""
        return np.asarray(self.attitude_seen & self.position_seen)

    def scored(self, after: float = SETTLING) -> BoolArray:
        """Return samples that count, (n,): in movement, with a true pose, from some time on [s]."""
        return np.asarray(self.movement & self.optical_seen & (self.time >= after))

    def thinned(self, every: int = THINNED, first: int = 0) -> BoolArray:
        """Return optical samples that an estimator gets: each so many, if it was seen; (n,)."""
        kept = np.zeros(len(self), dtype=bool)
        kept[first::every] = True
        return np.asarray(kept & self.optical_seen)

    def inertial(self) -> dict[str, FloatArray]:
        """Return inputs of an estimator by field, as `Runner.run` takes them."""
        return {
            "rate": self.rate,
            "force": self.force,
            "field": self.field,
            "inertial_valid": self.inertial_valid.astype(float),
        }

    def optical(
        self, new: BoolArray, late: int = 0, name: str = "optical"
    ) -> dict[str, FloatArray]:
        """Return inputs of an estimator from the samples of the tracker that are `new`.

        Args:
            new: (n,) at which instants a pose is taken, as from `thinned` or `occluded`; where it
                was lost, none is.
            late: samples after which it arrives.
            name: of the tracker, before the names of its ports.

        Returns:
            `<name>_position` (n, 3) [m], `<name>_attitude` (n, 4), both held from one arrival to
            the next, `<name>_new` (n,) and `<name>_age` (n,) [s].
        """
        arrives = np.zeros(len(self), dtype=bool)
        arrives[late:] = (np.asarray(new, dtype=bool) & self.optical_seen)[: len(self) - late]
        taken = np.maximum.accumulate(np.where(arrives, np.arange(len(self)) - late, -1))
        pending = (taken < 0)[:, np.newaxis]
        return {
            f"{name}_position": np.where(pending, 0.0, self.position[taken]),
            f"{name}_attitude": np.where(pending, [1.0, 0.0, 0.0, 0.0], self.attitude[taken]),
            f"{name}_new": arrives.astype(float),
            f"{name}_age": np.full(len(self), late * self.period),
        }


def read_trial(path: Path) -> BroadTrial:
    """Read and check a trial.

    Raises:
        SteadytipError: no such file, or not a MATLAB v5 file.
        ProblemsError: variables that are missing or of another shape, or make no sense.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        with path.open("rb") as file:
            content: Mapping[str, np.ndarray] = loadmat(file)
    except OSError as error:
        raise SteadytipError(f"{path} cannot be read: {reason(error)}") from None
    except (MatReadError, NotImplementedError, ValueError, TypeError, IndexError) as error:
        raise SteadytipError(
            f"{path} is not a MATLAB v5 file ({error}); save it with `-v7` or older"
        ) from None

    rate, arrays = _checked(path, content)
    gyr, acc, mag = (arrays[name] for name in ("imu_gyr", "imu_acc", "imu_mag"))
    sensed = np.hstack([gyr, acc, mag])
    inertial_valid = _finite(sensed)
    sensed = _held(sensed, inertial_valid, np.zeros(9))
    quaternion, place = arrays["opt_quat"], arrays["opt_pos"] @ _NORTH_FROM_EAST.T
    attitude_seen, position_seen = _finite(quaternion), _finite(place)
    turned = northward(quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True))
    return BroadTrial(
        name=path.stem,
        period=1.0 / rate,
        rate=sensed[:, :3],
        force=sensed[:, 3:6],
        field=_TESLA * sensed[:, 6:],
        inertial_valid=inertial_valid,
        attitude=_held(turned, attitude_seen, np.array([1.0, 0.0, 0.0, 0.0])),
        position=_held(place, position_seen, np.zeros(3)),
        attitude_seen=attitude_seen,
        position_seen=position_seen,
        movement=arrays["movement"][:, 0] != 0.0,
    )


def northward(attitude: FloatArray) -> FloatArray:
    """Return q_WB (n, 4) for attitudes (n, 4) in a world of east, north and up."""
    w, x, y, z = attitude.T
    return np.asarray(_HALF * np.column_stack([w + z, x + y, y - x, z - w]))


def occluded(new: BoolArray, intervals: Sequence[tuple[int, int]]) -> BoolArray:
    """Return the optical samples `new` (n,) without those in some intervals [first, end); (n,)."""
    left = np.array(new, dtype=bool)
    for first, end in intervals:
        left[max(first, 0) : max(end, 0)] = False
    return left


def since(new: BoolArray) -> IntArray:
    """Return samples since the last one that is `new`, 0 at it, -1 before the first; (n,)."""
    index = np.arange(len(new))
    last = np.maximum.accumulate(np.where(new, index, -1))
    return np.where(last < 0, -1, index - last)


def _finite(values: FloatArray) -> BoolArray:
    return np.asarray(np.isfinite(values).all(axis=1))


def _held(values: FloatArray, seen: BoolArray, start: FloatArray) -> FloatArray:
    """Return `values` with each lost row replaced by the last one seen, or by `start`."""
    last = np.maximum.accumulate(np.where(seen, np.arange(len(values)), -1))
    return np.where((last < 0)[:, np.newaxis], start, values[last])


def _checked(path: Path, content: Mapping[str, np.ndarray]) -> tuple[float, dict[str, FloatArray]]:
    """Return the sampling rate [Hz] and the arrays, (n, columns), once all are checked."""
    absent = [name for name in ("sampling_rate", *_COLUMNS) if name not in content]
    if absent:
        raise ProblemsError(str(path), [f"there is no variable '{name}'" for name in absent])
    problems: list[str] = []
    arrays: dict[str, FloatArray] = {}
    for name, columns in _COLUMNS.items():
        array = content[name]
        if array.dtype.kind not in "fiub" or array.ndim != 2 or array.shape[1] != columns:
            problems.append(
                f"'{name}' is {array.dtype} of shape {array.shape}; numbers (n, {columns}) wanted"
            )
            continue
        arrays[name] = array.astype(float)
    rate = content["sampling_rate"]
    hertz = float(rate.flat[0]) if rate.dtype.kind in "fiu" and rate.size == 1 else np.nan
    if not (np.isfinite(hertz) and hertz > 0.0):
        problems.append(f"'sampling_rate' = {rate.ravel()[:3]} must be one number above 0 [Hz]")
    lengths = {name: len(array) for name, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} {count}" for name, count in lengths.items())
        problems.append(f"variables differ in length: {counts}")
    elif 0 in lengths.values():
        problems.append("there are no samples")
    if "opt_quat" in arrays:
        length = np.linalg.norm(arrays["opt_quat"], axis=1)
        odd = np.flatnonzero(np.abs(length - 1.0) > _UNIT)
        if odd.size:
            problems.append(
                f"'opt_quat' row {odd[0] + 1} has the length {length[odd[0]]:.4g}; it must be 1 "
                f"within {_UNIT:g}"
            )
    if problems:
        raise ProblemsError(str(path), problems)
    return hertz, arrays
