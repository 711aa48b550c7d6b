"""Recordings of hand motion: position in time, as a text table or Parquet.

Two layouts are read:

- a table (see `tables`) whose headings name columns with their units, `time [s], x [mm], y [mm],
  z [mm]`, in any order; other columns are ignored. A `ColumnMapping` names columns, units and the
  rate that the file does not say;
- the M2S2 layout without a header: sample index, x, y, z [mm], grip force, at 250 Hz. The first
  row with x = y = z = 0 ends the recording.

What a recording is worth is checked by `motion_quality`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from fmu_src.errors import SteadytipError
from harness.common.errors import ProblemsError
from harness.common.strict_model import Positive, StrictModel
from harness.common.types import FloatArray
from harness.common.validation_errors import explain
from harness.recordings.findings import Finding, refuse
from harness.recordings.motion_quality import assess_motion
from harness.recordings.tables import (
    TIME,
    ColumnMapping,
    DataTable,
    Role,
    find_columns,
    find_time,
    read_table,
)
from harness.recordings.units import LENGTHS

__all__ = ["MotionColumns", "Recording", "motion_columns", "read_recording", "recordings"]

M2S2_RATE = 250.0
"""Sample rate of the M2S2 system [Hz] (README of the recordings)."""
_M2S2_COLUMNS = 5
_SUFFIXES = (".csv", ".txt", ".dat", ".parquet")  # of recordings in a folder
_MIN_SAMPLES = 6  # a quintic spline has no fewer
_MIN_SECONDS = 1.0
_MAX_GAP = 10.0  # sample periods; beyond that the spline would invent the motion
_MAX_SPEED = 1.0  # m/s, guess: a hundred times what a hand does under the microscope

_AXES = [
    Role(axis, (axis, f"pos_{axis}", f"position_{axis}"), LENGTHS, quantity="length")
    for axis in "xyz"
]


class MotionColumns(StrictModel):
    """Columns, units and rate of a recorded motion, as far as the file does not say.

    Attributes:
        time, x, y, z: name or number (from 1) of a column.
        time_unit, length_unit: unit of the time, and of x, y and z.
        rate: samples in a second, for a table without time [Hz].
    """

    time: str | None = None
    x: str | None = None
    y: str | None = None
    z: str | None = None
    time_unit: str | None = None
    length_unit: str | None = None
    rate: Positive | None = None

    @property
    def mapping(self) -> ColumnMapping:
        """Column mapping for a reader of tables."""
        columns = {"time": self.time, "x": self.x, "y": self.y, "z": self.z}
        units = {"time": self.time_unit, "length": self.length_unit}
        return ColumnMapping(columns, units, self.rate)


def motion_columns(given: Mapping[str, Any]) -> MotionColumns:
    """Return columns, units and rate from a mapping.

    Raises:
        ProblemsError: unknown keys, or values of another type.
    """
    try:
        return MotionColumns.model_validate(dict(given))
    except ValidationError as error:
        raise ProblemsError("columns of the recording", explain(error, MotionColumns)) from None


@dataclass(frozen=True)
class Recording:
    """Position of a hand-held tip, from 0 on.

    Attributes:
        path: file that it comes from.
        time: (n,) [s], from 0 on, rising.
        position: (n, 3) [m] in W, from 0 on.
        findings: what was found in it.
    """

    path: Path
    time: FloatArray
    position: FloatArray
    findings: tuple[Finding, ...] = ()

    @property
    def seconds(self) -> float:
        """Duration from the first to the last sample [s]."""
        return float(self.time[-1])


def recordings(paths: Iterable[Path]) -> list[Path]:
    """Replace folders by the recordings in them, in the order of their names; keep files.

    Raises:
        SteadytipError: a folder without recordings.
    """
    found: list[Path] = []
    for path in paths:
        inside = sorted(p for p in path.glob("*") if p.suffix in _SUFFIXES) if path.is_dir() else []
        if path.is_dir() and not inside:
            raise SteadytipError(f"{path}: no recordings ({', '.join(_SUFFIXES)}) in this folder")
        found += inside or [path]
    return found


def read_recording(
    path: Path,
    columns: MotionColumns | None = None,
    accept: Collection[str] = (),
    repair: Collection[str] = (),
) -> Recording:
    """Read and check a recording; nothing is smoothed.

    Even times take the place of noisy stamps, and samples that a table holds over several rows are
    taken once; the findings say so.

    Args:
        path: text table or Parquet.
        columns: columns, units and rate, as far as the file does not say.
        accept: names of findings to go on with.
        repair: names of findings to repair that are not repaired unasked.

    Raises:
        FindingsError: it has defects that make figures meaningless.
        SteadytipError: no such file, empty, too short, ragged, not numbers, not finite, time not
            rising, units missing or unknown, gaps; with the line and a cure.
    """
    mapping = (columns or MotionColumns()).mapping
    table = read_table(path, 4, "four are needed, time and x, y, z", _MIN_SAMPLES)
    if any(table.headings) or mapping.rate or any(mapping.columns.values()):
        found = find_columns(table, [TIME, *_AXES], mapping)
        time = find_time(table, found, mapping).values
        position = np.column_stack([found[axis.name].values for axis in _AXES])
    elif len(table.headings) == _M2S2_COLUMNS and not table.above:
        index, *axes = (table.numbers(column) for column in range(4))
        position = np.column_stack(axes) * LENGTHS["mm"]
        ended = np.flatnonzero((position == 0.0).all(axis=1))
        past = ended[0] if len(ended) else len(position)
        time, position = index[:past] * (1 / M2S2_RATE), position[:past]
    else:
        raise SteadytipError(
            f"recording {path}, {table.place(0)}: {len(table.headings)} columns without a header; "
            "put 'time [s], x [mm], y [mm], z [mm]' with the right units into the first line"
        )
    _check_values(path, table, time, position)
    used = assess_motion(time, position, table.place, repair)
    refuse(path, used.findings, accept)
    _check_times(path, table, used.time, used.position)
    return Recording(
        path, used.time - used.time[0], used.position - used.position[0], used.findings
    )


def _check_values(path: Path, table: DataTable, time: FloatArray, position: FloatArray) -> None:
    finite = np.isfinite(time) & np.isfinite(position).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        shown = ", ".join(f"{value:g}" for value in (time[row], *position[row]))
        raise SteadytipError(
            f"recording {path}, {table.place(row)}: not finite (time, x, y, z = {shown} in s, m); "
            "cut the recording there"
        )
    if len(time) < _MIN_SAMPLES:
        raise SteadytipError(
            f"recording {path} has {len(time)} samples; at least {_MIN_SAMPLES} are needed"
        )


def _check_times(path: Path, table: DataTable, time: FloatArray, position: FloatArray) -> None:
    period = np.diff(time)
    if (period <= 0.0).any():
        row = int(np.argmax(period <= 0.0))
        raise SteadytipError(
            f"recording {path}, {table.place(row + 1)}: time goes from {time[row]:.9g} s to "
            f"{time[row + 1]:.9g} s; it has to rise. Sort the rows, or remove the repeated ones."
        )
    if time[-1] - time[0] < _MIN_SECONDS:
        raise SteadytipError(
            f"recording {path} lasts {time[-1] - time[0]:.3g} s; at least {_MIN_SECONDS:g} s are "
            "needed"
        )
    gap = _MAX_GAP * float(np.median(period))
    if (period > gap).any():
        row = int(np.argmax(period > gap))
        raise SteadytipError(
            f"recording {path}, {table.place(row + 1)}: a gap of {period[row]:.3g} s, more than "
            f"{_MAX_GAP:g} sample periods; cut the recording there"
        )
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / period
    if (speed > _MAX_SPEED).any():
        row = int(np.argmax(speed > _MAX_SPEED))
        jump = math.dist(position[row], position[row + 1])
        raise SteadytipError(
            f"recording {path}, {table.place(row + 1)}: a jump of {jump * 1e3:.3g} mm within "
            f"{period[row] * 1e3:.3g} ms ({speed[row]:.3g} m/s, no hand does more than "
            f"{_MAX_SPEED:g} m/s); check the units, or cut the recording there"
        )
