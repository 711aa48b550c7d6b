"""Recordings of hand motion: position in time, as a text table or Parquet.

Three layouts are read:

- a text table (comma, semicolon or blanks) whose first line names columns with their units,
  `time [s], x [mm], y [mm], z [mm]`, in any order, other columns ignored;
- a Parquet file with columns of such names, or with the unit in the field's metadata;
- the M2S2 layout without a header: sample index, x, y, z [mm], grip force, at 250 Hz, where the
  first row with x = y = z = 0 ends the recording.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from harness.common.errors import SteadytipError, nearest
from harness.common.types import FloatArray

__all__ = ["Recording", "read_recording", "recordings"]

M2S2_RATE = 250.0
"""Sample rate of the M2S2 system [Hz] (README of the recordings)."""
_M2S2_COLUMNS = 5
_SUFFIXES = (".csv", ".txt", ".dat", ".parquet")  # of recordings in a folder
_MIN_SAMPLES = 6  # a quintic spline has no fewer
_MIN_SECONDS = 1.0
_MAX_GAP = 10.0  # sample periods; beyond that the spline would invent the motion
_MAX_SPEED = 1.0  # m/s, guess: a hundred times what a hand does under the microscope

_TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_LENGTH_UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
_COLUMNS = {"time": _TIME_UNITS, "x": _LENGTH_UNITS, "y": _LENGTH_UNITS, "z": _LENGTH_UNITS}
_HEADING = re.compile(r"^\s*(?P<name>\w+)\s*(?:\[(?P<unit>[^\]]*)\])?\s*$")


@dataclass(frozen=True)
class Recording:
    """Position of a hand-held tip.

    Attributes:
        path: file that it comes from.
        time: (n,) [s], from 0 on, rising.
        position: (n, 3) [m] in W, from 0 on.
    """

    path: Path
    time: FloatArray
    position: FloatArray

    @property
    def seconds(self) -> float:
        """From the first to the last sample [s]."""
        return float(self.time[-1])


def recordings(paths: Iterable[Path]) -> list[Path]:
    """Files as they are, folders as the recordings in them, in the order of their names.

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


def read_recording(path: Path) -> Recording:
    """Read and check a recording; nothing is smoothed, resampled or repaired.

    Raises:
        SteadytipError: no such file, empty, too short, ragged, not numbers, not finite, time not
            rising, units missing or unknown, gaps or jumps; with the line and a cure.
    """
    if not path.is_file():
        raise SteadytipError(f"recording {path} does not exist")
    if path.suffix == ".parquet":
        lines, time, position = _read_parquet(path)
    else:
        lines, time, position = _read_text(path)
    _check(path, lines, time, position)
    return Recording(path, time - time[0], position - position[0])


_Columns = tuple[Sequence[str], FloatArray, FloatArray]
"""Places for messages, (n,) time [s], (n, 3) position [m]."""


def _read_parquet(path: Path) -> _Columns:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        table = parquet.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise SteadytipError(f"recording {path} is not Parquet: {error}") from None
    headings = [
        f"{field.name} [{unit.decode()}]"
        if (unit := (field.metadata or {}).get(b"unit")) and "[" not in field.name
        else field.name
        for field in table.schema
    ]
    order, factors = _choose(path, headings)
    try:
        columns = [
            table.column(i).to_numpy().astype(float) * f
            for i, f in zip(order, factors, strict=True)
        ]
    except (TypeError, ValueError, pa.ArrowException) as error:
        raise SteadytipError(f"recording {path}: a column does not hold numbers: {error}") from None
    places = [f"row {i}" for i in range(1, len(table) + 1)]
    return places, columns[0], np.column_stack(columns[1:])


def _read_text(path: Path) -> _Columns:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (UnicodeDecodeError, OSError) as error:
        raise SteadytipError(f"recording {path} is not a text table: {error}") from None
    rows = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if not rows:
        raise SteadytipError(f"recording {path} is empty")
    delimiter = next((mark for mark in ",;" if mark in rows[0][1]), None)
    first = _fields(rows[0][1], delimiter)
    has_header = not any(_is_number(field) for field in first)
    if has_header:
        order, factors = _choose(path, _headings(rows[0][1], delimiter))
        rows = rows[1:]
    elif len(first) == _M2S2_COLUMNS:
        order, factors = [0, 1, 2, 3], [1 / M2S2_RATE, *[_LENGTH_UNITS["mm"]] * 3]
    else:
        raise SteadytipError(
            f"recording {path}, line {rows[0][0]}: {len(first)} columns without a header; "
            "put 'time [s], x [mm], y [mm], z [mm]' with the right units into the first line"
        )
    width = len(_headings(text.splitlines()[0], delimiter)) if has_header else len(first)
    values = np.array(
        [_numbers(path, number, line, delimiter, width, order) for number, line in rows]
    ).reshape(-1, len(order))
    if not has_header:
        ended = np.flatnonzero((values[:, 1:] == 0.0).all(axis=1))
        values = values[: ended[0]] if len(ended) else values
    values = values * factors
    return [f"line {number}" for number, _ in rows], values[:, 0], values[:, 1:]


def _fields(line: str, delimiter: str | None) -> list[str]:
    return [field.strip() for field in line.split(delimiter)]


def _headings(line: str, delimiter: str | None) -> list[str]:
    # Blanks stand inside `x [mm]` too, so headings between blanks are found by their shape.
    return (
        re.findall(r"\w+(?:\s*\[[^\]]*\])?", line) if delimiter is None else line.split(delimiter)
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers(
    path: Path, number: int, line: str, delimiter: str | None, width: int, order: Sequence[int]
) -> list[float]:
    fields = _fields(line, delimiter)
    if len(fields) != width:
        raise SteadytipError(
            f"recording {path}, line {number}: {len(fields)} columns instead of {width}; "
            "remove the line or complete it"
        )
    for index in order:
        if not _is_number(fields[index]):
            raise SteadytipError(
                f"recording {path}, line {number}: '{fields[index]}' is not a number"
            )
    return [float(fields[index]) for index in order]


def _choose(path: Path, headings: Sequence[str]) -> tuple[list[int], list[float]]:
    """Index and factor to SI of the columns time, x, y, z."""
    found: dict[str, tuple[int, str | None]] = {}
    for index, heading in enumerate(headings):
        match = _HEADING.match(heading.replace("µ", "u").replace("μ", "u"))
        if match:
            found.setdefault(match["name"].lower(), (index, match["unit"]))
    order, factors = [], []
    for name, units in _COLUMNS.items():
        if name not in found:
            raise SteadytipError(
                f"recording {path} has no column '{name}'; {nearest(name, found)} "
                "The first line should read as in 'time [s], x [mm], y [mm], z [mm]'."
            )
        index, unit = found[name]
        if (unit or "").strip() not in units:
            raise SteadytipError(
                f"recording {path}: column '{name}' "
                + (f"is in '{unit}'" if unit else "does not say its unit")
                + f"; write '{name} [{next(iter(units))}]', or one of {', '.join(units)}"
            )
        order.append(index)
        factors.append(units[(unit or "").strip()])
    return order, factors


def _check(path: Path, places: Sequence[str], time: FloatArray, position: FloatArray) -> None:
    finite = np.isfinite(time) & np.isfinite(position).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        shown = ", ".join(f"{value:g}" for value in (time[row], *position[row]))
        raise SteadytipError(
            f"recording {path}, {places[row]}: not finite (time, x, y, z = {shown} in s, m); "
            "cut the recording there"
        )
    if len(time) < _MIN_SAMPLES:
        raise SteadytipError(
            f"recording {path} has {len(time)} samples; at least {_MIN_SAMPLES} are needed"
        )
    period = np.diff(time)
    if (period <= 0.0).any():
        row = int(np.argmax(period <= 0.0))
        raise SteadytipError(
            f"recording {path}, {places[row + 1]}: time goes from {time[row]:.9g} s to "
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
            f"recording {path}, {places[row + 1]}: a gap of {period[row]:.3g} s, more than "
            f"{_MAX_GAP:g} sample periods; cut the recording there"
        )
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / period
    if (speed > _MAX_SPEED).any():
        row = int(np.argmax(speed > _MAX_SPEED))
        jump = math.dist(position[row], position[row + 1])
        raise SteadytipError(
            f"recording {path}, {places[row + 1]}: a jump of {jump * 1e3:.3g} mm within "
            f"{period[row] * 1e3:.3g} ms ({speed[row]:.3g} m/s, no hand does more than "
            f"{_MAX_SPEED:g} m/s); check the units, or cut the recording there"
        )
