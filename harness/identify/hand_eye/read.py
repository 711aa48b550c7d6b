"""Recordings of an inertial unit and a tracker's sensor that move together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fmu_src.errors import SteadytipError
from harness.common.types import FloatArray
from harness.recordings.tables import DataTable, read_table
from harness.recordings.units import QUANTITIES

__all__ = ["FEWEST", "LARGEST_LAG", "TrackedMotion", "read_tracked_motion"]

FEWEST = 100
"""Fewest attitudes of the tracker in a recording."""
SHORTEST = 5.0
"""Shortest recording [s]."""
LARGEST_LAG = 0.15
"""Largest lag of the gyro of either sign [s]."""
_UNITS: Mapping[str, str] = {"rate": "rad/s", "force": "m/s2", "field": "T"}
"""SI unit of a vector by name; it is assumed if a heading has none."""


@dataclass(frozen=True)
class TrackedMotion:
    """A recording of an inertial unit and a tracker.

    Attributes:
        path: file that it comes from.
        time: time of the inertial samples, (n,) [s].
        rate: body rate, (n, 3) [rad/s].
        force: specific force, (n, 3) [m/s2]; None if it was not recorded.
        field: magnetic field, (n, 3) [T]; None if it was not recorded.
        measured: times at which the tracker measured, (m,) [s].
        attitude: attitudes that it measured, m.
    """

    path: Path
    time: FloatArray
    rate: FloatArray
    force: FloatArray | None
    field: FloatArray | None
    measured: FloatArray
    attitude: Rotation


def read_tracked_motion(
    path: Path, unit: str | None = None, tracker: str | None = None
) -> TrackedMotion:
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
    rate = _vector(table, unit, "rate", "xyz")
    quaternions = _vector(table, tracker, "em_attitude", "wxyz")
    if rate is None or quaternions is None:
        missing = "rate_x..z" if rate is None else "em_attitude_w..z"
        raise SteadytipError(
            f"recording {path} has no columns {missing} (there are: {table.columns})"
        )
    finite = np.isfinite(time) & np.isfinite(rate).all(axis=1)
    if not finite.all() or not np.all(np.diff(time) > 0):
        bad = int(np.argmin(finite)) if not finite.all() else int(np.argmin(np.diff(time) > 0)) + 1
        raise SteadytipError(
            f"recording {path}, {table.place(bad)}: time must rise and the rate be"
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
    return TrackedMotion(
        path,
        time,
        rate,
        _vector(table, unit, "force", "xyz"),
        _vector(table, unit, "field", "xyz"),
        measured[inside],
        Rotation.from_quat(quaternions[arrived][inside], scalar_first=True),
    )


def _part(table: DataTable, what: str, option: str, *names: str) -> str:
    """Return the part whose columns have these names; empty if the names have no part."""
    found = [
        heading[: -len(names[0])].rstrip(".")
        for heading in table.headings
        if heading == names[0] or heading.endswith(f".{names[0]}")
    ]
    if len(found) > 1:  # the other names select one
        full = set(table.headings)
        found = [p for p in found if all(f"{p}.{n}".lstrip(".") in full for n in names)] or found
    if len(found) != 1:
        raise SteadytipError(
            f"recording {table.path}: columns '{names[0]}' of the {what} are in "
            f"{', '.join(found) or 'no part'}; say which with {option} PART (there are: "
            f"{table.columns})"
        )
    return found[0]


def _column(table: DataTable, part: str, name: str) -> FloatArray | None:
    heading = f"{part}.{name}".lstrip(".")
    if heading not in table.headings:
        return None
    return table.numbers(table.headings.index(heading))


def _vector(table: DataTable, part: str, name: str, axes: str) -> FloatArray | None:
    """Return the columns of a vector in SI, (n, axes); None if one is missing."""
    columns = [_column(table, part, f"{name}_{axis}") for axis in axes]
    found = [column for column in columns if column is not None]
    if len(found) < len(columns):
        return None
    unit = table.units[table.headings.index(f"{part}.{name}_{axes[0]}".lstrip("."))]
    known = QUANTITIES[_UNITS[name]] if name in _UNITS else {unit: 1.0}
    if unit and unit not in known:
        raise SteadytipError(
            f"recording {table.path}: {name} in '{unit}'; known are {', '.join(known)}"
        )
    return known.get(unit, 1.0) * np.column_stack(found)
