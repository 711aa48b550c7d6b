"""Recordings of a unit on a turntable: rows of angles and volts, grouped into static positions.

A static position is a run of rows with the same two angles. The rows are raw samples or means. One
row will do, but cannot show that the unit was at rest. Runs much shorter than the longest one are
the way from one position to the next and are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src.errors import SteadytipError
from harness.common.errors import ProblemsError
from harness.common.types import FloatArray
from harness.recordings.quality import non_finite_problems
from harness.recordings.tables import ColumnMapping, Role, find_columns, read_table
from harness.recordings.units import ANGLES, TEMPERATURES, VOLTAGES

__all__ = [
    "ACCELEROMETERS",
    "CHANNELS",
    "MAGNETOMETERS",
    "StaticPositions",
    "group_positions",
    "join_positions",
    "read_positions",
]

ACCELEROMETERS = ("a1x", "a1z", "a2y", "a2z", "a3x", "a3y")
MAGNETOMETERS = ("mx", "my", "mz")
CHANNELS = (*ACCELEROMETERS, *MAGNETOMETERS)
SAME = np.radians(0.02)
"""Angles that differ by less are equal: an encoder of a stage good to 0.1 deg flickers so much."""
SHORT = 0.25
"""Share of the longest position's rows; a run of fewer rows is no static position."""
STILL = 10e-3
"""Standard deviation within a position that noise does not reach: 10 mg at 1 V/g [V]."""
CREEP = 2e-3
"""Difference between the halves of a position that noise does not reach [V]."""
TURNED = np.radians(30.0)
"""Angles that cover less are no procedure, or have another unit."""
SPAN = (0.5, 4.0)
"""Range of the accelerometers' volts over all positions: 2 V at 1 V/g [V]."""
_QUOTED = 3
_ROWS = ("alpha", "beta", "volts", "counts")
ROLES = (
    Role("alpha", ("alpha", "tilt"), ANGLES, "deg", quantity="angle"),
    Role("beta", ("beta", "turn"), ANGLES, "deg", quantity="angle"),
    *(
        Role(name, (name,), VOLTAGES, "V", name in MAGNETOMETERS, "volts", f"channel {name}=NAME")
        for name in CHANNELS
    ),
    Role("temperature", ("temperature", "temp"), TEMPERATURES, "degC", optional=True),
)
"""Roles of the columns."""


@dataclass(frozen=True)
class StaticPositions:
    """Outputs of a unit at rest, one row for each position of the turntable.

    Attributes:
        alpha, beta: angles of the turntable, (n,) [rad].
        volts: means, (n, channels) [V].
        temperature: temperature of the thermometer, (n,) [degC]; None without one.
        counts: rows of each mean, (n,).
        channels: names of the columns of `volts`.
        notes: sentences about what is unusual but may be right.
    """

    alpha: FloatArray
    beta: FloatArray
    volts: FloatArray
    temperature: FloatArray | None
    counts: FloatArray
    channels: tuple[str, ...] = CHANNELS
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.alpha)

    def select(self, chosen: Any) -> StaticPositions:
        """Return some of the positions, by index or mask."""
        rows = {name: getattr(self, name)[chosen] for name in _ROWS}
        temperature = None if self.temperature is None else self.temperature[chosen]
        return replace(self, **rows, temperature=temperature)


def join_positions(parts: Sequence[StaticPositions]) -> StaticPositions:
    """Join several recordings of one unit.

    Raises:
        SteadytipError: they do not have the same channels.
    """
    first = parts[0]
    if any(one.channels != first.channels for one in parts):
        raise SteadytipError("the recordings do not have the same channels; give those that do")
    warm = [one.temperature for one in parts if one.temperature is not None]
    return StaticPositions(
        **{name: np.concatenate([getattr(one, name) for one in parts]) for name in _ROWS},
        temperature=np.concatenate(warm) if len(warm) == len(parts) else None,
        channels=first.channels,
        notes=tuple(dict.fromkeys(note for one in parts for note in one.notes)),
    )


def read_positions(path: Path, mapping: ColumnMapping | None = None) -> StaticPositions:
    """Read and check a recording.

    Args:
        path: text table or Parquet.
        mapping: columns `alpha`, `beta`, `temperature` and those of the channels, units of `angle`
            and `volts`, as far as the file does not say.

    Raises:
        ProblemsError: everything that is wrong with the data.
        SteadytipError: no such file, not a table, no such column.
    """
    table = read_table(path, 8, "eight are needed, two angles and six channels")
    found = find_columns(table, ROLES, mapping)
    signals = {name: column.values for name, column in found.items()}
    where = f"recording {path}"
    cure = "remove the rows of that rest, or record it again"
    problems = [
        problem
        for name, values in signals.items()
        for problem in non_finite_problems(name, values, table.place, cure=cure)
    ]
    if problems:
        raise ProblemsError(where, problems)
    magnetic = [name for name in MAGNETOMETERS if name in signals]
    if magnetic and len(magnetic) < len(MAGNETOMETERS):
        raise SteadytipError(
            f"{where}: of the magnetometer it has {', '.join(magnetic)} only; all three are "
            "needed, or none"
        )
    channels = (*ACCELEROMETERS, *magnetic)
    volts = np.column_stack([signals[name] for name in channels])
    angles = {name: signals[name] for name in ("alpha", "beta")}
    problems = _range_problems(angles, volts)
    if problems:
        raise ProblemsError(where, problems)
    temperature = signals.get("temperature")
    alpha, beta = angles.values()
    return group_positions(alpha, beta, volts, temperature, channels, where, table.place)


def group_positions(
    alpha: FloatArray,
    beta: FloatArray,
    volts: FloatArray,
    temperature: FloatArray | None,
    channels: Sequence[str],
    where: str,
    place: Callable[[int], str] = lambda k: f"sample {k + 1}",
) -> StaticPositions:
    """Average over runs of rows with the same angles.

    Args:
        alpha: (rows,) [rad].
        beta: (rows,) [rad].
        volts: (rows, channels) [V].
        temperature: (rows,) [degC] or None.
        channels: their names.
        where: name of the recording, for messages.
        place: returns the name of a row.

    Raises:
        ProblemsError: channels that move while the angles say that they rest.
    """
    begins = np.array(_begins(alpha, beta))
    ends = np.append(begins[1:], len(alpha))
    counts = ends - begins
    rested = counts >= SHORT * counts.max()
    restless = []
    for begin, end in zip(begins[rested], ends[rested], strict=True):
        if end - begin < 4:
            continue
        rows = volts[begin:end]
        spread = rows.std(axis=0)
        middle = (end - begin) // 2
        crept = np.abs(rows[:middle].mean(axis=0) - rows[middle:].mean(axis=0))
        noise = 4 * spread / np.sqrt(middle)
        moving = (spread > STILL) | (crept > CREEP + noise)
        if moving.any():
            worst = int(np.argmax(np.where(moving, spread, 0.0)))
            restless.append((begin, worst, float(spread[worst])))
    if restless:
        quoted = [
            f"{channels[worst]} moves by {1e3 * spread:.3g} mV rms in the rest that begins in "
            f"{place(begin)} (alpha {np.degrees(alpha[begin]):.4g}, beta "
            f"{np.degrees(beta[begin]):.4g} deg)"
            for begin, worst, spread in restless[:_QUOTED]
        ]
        if len(restless) > _QUOTED:
            quoted.append(f"{len(restless) - _QUOTED} more rests are like that")
        quoted[-1] += "; leave out the rows in which the turntable moves, or wait longer"
        raise ProblemsError(where, quoted)
    notes = []
    if not rested.all():
        ways = int(counts[~rested].sum())
        notes.append(f"{ways} rows on the way from one rest to the next are left out")
    if counts.max() < 4:
        notes.append("too few rows for each rest to tell whether it was one")

    def mean(values: FloatArray) -> FloatArray:
        sums = np.add.reduceat(values, begins, axis=0)[rested]
        return np.asarray(sums / counts[rested].reshape(-1, *[1] * (values.ndim - 1)))

    return StaticPositions(
        mean(alpha),
        mean(beta),
        mean(volts),
        None if temperature is None else mean(temperature),
        counts[rested].astype(float),
        tuple(channels),
        tuple(notes),
    )


def _begins(alpha: FloatArray, beta: FloatArray) -> list[int]:
    """Return the first rows of runs whose angles stay where they begin."""
    begins = [0]
    # A plain loop: each run is compared with its own first row, so slow motion is no rest.
    a, b = alpha[0], beta[0]
    for k, (x, y) in enumerate(zip(alpha.tolist(), beta.tolist(), strict=True)):
        if abs(x - a) > SAME or abs(y - b) > SAME:
            begins.append(k)
            a, b = x, y
    return begins


def _range_problems(angles: Mapping[str, FloatArray], volts: FloatArray) -> list[str]:
    """Return sentences about ranges that point to another unit or column."""
    problems = []
    for name, angle in angles.items():
        covered = float(np.ptp(angle))
        if covered < TURNED:
            text = f"{name} covers {np.degrees(covered):.3g} deg only"
            if covered == 0.0:
                cure = f"choose its column with --{name}"
            elif covered > np.radians(2.0):
                cure = "is it in radians? Give --angle-unit rad"
            else:
                cure = "run the whole procedure, `steadytip identify turntable` has its angles"
            problems.append(f"{text}; {cure}")
        elif covered > np.radians(3 * 360):
            problems.append(
                f"{name} covers {np.degrees(covered):.4g} deg; is it in degrees? Give --angle-unit "
                "deg"
            )
    low, high = SPAN
    for i, name in enumerate(ACCELEROMETERS):
        span = float(np.ptp(volts[:, i]))
        if span == 0.0:
            problems.append(f"{name} is {volts[0, i]:g} V at every angle; it is not connected")
        elif not low <= span <= high and not problems:
            problems.append(
                f"{name} covers {span:.3g} V, and an accelerometer turned over covers 2 V; is it "
                "in another unit? Give --volts-unit V|mV|kV"
            )
    return problems
