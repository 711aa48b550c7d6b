"""Recordings of a unit on a turntable: rows of angles and volts, grouped into rests and checked.

A rest is a run of rows with the same two angles, of raw samples or of means: one row will do, but
shows nothing of whether it was one. Runs much shorter than the longest are the way from one rest to
the next, and are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from harness.common.errors import ProblemsError, SteadytipError
from harness.common.types import FloatArray
from harness.identify.imu.turntable import ACCELEROMETERS, CHANNELS, Rests
from harness.recordings.tables import ANGLES, TEMPERATURES, VOLTAGES, Role, find_columns, read_table

__all__ = ["Choice", "read_rests"]

SAME = np.radians(0.02)
"""Angles that differ by less are one: what an encoder of a stage good to 0.1 deg flickers by."""
SHORT = 0.25
"""Share of the longest rest's rows below which a run of rows is none."""
STILL = 10e-3
"""Standard deviation within a rest that noise does not have: 10 mg at 1 V/g [V]."""
CREEP = 2e-3
"""The same of the difference of its halves, noise left out [V]."""
TURNED = np.radians(30.0)
"""Angles that cover less are no procedure, or in another unit."""
SPAN = (0.5, 4.0)
"""Of the accelerometers' volts over all rests: 2 V at 1 V/g [V]."""
_QUOTED = 3


@dataclass(frozen=True)
class Choice:
    """Which columns of a table are what, as far as the headings do not say.

    Attributes:
        alpha: name or number (from 1) of the column; None to find it.
        beta: see `alpha`.
        temperature: see `alpha`.
        channels: columns of the volts by channel.
        angle_unit: one of `tables.ANGLES`; None for what the heading says, else deg.
        volts_unit: one of `tables.VOLTAGES`; None for what the heading says, else V.
    """

    alpha: str | None = None
    beta: str | None = None
    temperature: str | None = None
    channels: Mapping[str, str] = field(default_factory=dict)
    angle_unit: str | None = None
    volts_unit: str | None = None


def read_rests(path: Path, choice: Choice) -> Rests:
    """Read and check a recording.

    Args:
        path: text table or Parquet.
        choice: columns and units as far as the file does not say.

    Raises:
        ProblemsError: everything that is wrong with the data.
        SteadytipError: no such file, not a table, no such column.
    """
    table = read_table(path, 8, "eight are needed, two angles and six channels")
    roles = [
        Role("alpha", ("alpha", "tilt"), ANGLES, "deg", choice.alpha, choice.angle_unit,
             unit_option="angle-unit"),
        Role("beta", ("beta", "turn"), ANGLES, "deg", choice.beta, choice.angle_unit,
             unit_option="angle-unit"),
    ]  # fmt: skip
    roles += [
        Role(
            name,
            (name,),
            VOLTAGES,
            "V",
            choice.channels.get(name),
            choice.volts_unit,
            optional=name not in ACCELEROMETERS,
            option=f"channel {name}=NAME",
            unit_option="volts-unit",
        )
        for name in CHANNELS
    ]
    roles.append(
        Role("temperature", ("temperature", "temp"), TEMPERATURES, "degC", choice.temperature,
             optional=True)
    )  # fmt: skip
    found = find_columns(table, roles)
    signals = {name: values for name, (values, _) in found.items()}
    where = f"recording {path}"
    _finite(where, signals, table.row, table.lines)
    magnetic = [name for name in CHANNELS if name not in ACCELEROMETERS and name in signals]
    if magnetic and len(magnetic) < len(CHANNELS) - len(ACCELEROMETERS):
        raise SteadytipError(
            f"{where}: of the magnetometer it has {', '.join(magnetic)} only; all three are "
            "needed, or none"
        )
    channels = (*ACCELEROMETERS, *magnetic)
    volts = np.column_stack([signals[name] for name in channels])
    _sizes(where, {name: signals[name] for name in ("alpha", "beta")}, volts)
    return group(
        signals["alpha"],
        signals["beta"],
        volts,
        signals.get("temperature"),
        channels,
        where,
        lambda k: f"{table.row} {int(table.lines[k])}",
    )


def _finite(where: str, signals: Mapping[str, FloatArray], row: str, lines: FloatArray) -> None:
    problems = []
    for name, values in signals.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            more = f" and {len(bad) - 1} more" if len(bad) > 1 else ""
            problems.append(
                f"{name} is {values[bad[0]]} in {row} {int(lines[bad[0]])}{more}; remove the rows "
                "of that rest, or record it again"
            )
    if problems:
        raise ProblemsError(where, problems)


def group(
    alpha: FloatArray,
    beta: FloatArray,
    volts: FloatArray,
    temperature: FloatArray | None,
    channels: Sequence[str],
    where: str,
    place: Callable[[int], str] = lambda k: f"sample {k + 1}",
) -> Rests:
    """Means over runs of rows with the same angles.

    Args:
        alpha: (rows,) [rad].
        beta: (rows,) [rad].
        volts: (rows, channels) [V].
        temperature: (rows,) [degC] or None.
        channels: their names.
        where: the recording's name, for messages.
        place: name of a row.

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

    return Rests(
        mean(alpha),
        mean(beta),
        mean(volts),
        None if temperature is None else mean(temperature),
        counts[rested].astype(float),
        tuple(channels),
        tuple(notes),
    )


def _begins(alpha: FloatArray, beta: FloatArray) -> list[int]:
    """First rows of runs whose angles stay where they begin."""
    begins = [0]
    # A plain loop: each run is about its own first row, so that slow motion is no rest.
    a, b = alpha[0], beta[0]
    for k, (x, y) in enumerate(zip(alpha.tolist(), beta.tolist(), strict=True)):
        if abs(x - a) > SAME or abs(y - b) > SAME:
            begins.append(k)
            a, b = x, y
    return begins


def _sizes(where: str, angles: Mapping[str, FloatArray], volts: FloatArray) -> None:
    """Refuse what another unit or column shows itself by."""
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
    if problems:
        raise ProblemsError(where, problems)
