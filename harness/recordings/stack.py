"""Recordings of an actuator: voltage and displacement, read and checked.

Nothing is smoothed, resampled or repaired. What would spoil an identification is refused with the
place, the value and a cure, all problems at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fmu_src.errors import SteadytipError
from harness.common.errors import ProblemsError
from harness.common.types import FloatArray
from harness.recordings.quality import non_finite_problems, runs, time_problems
from harness.recordings.tables import (
    TIME,
    ColumnMapping,
    DataTable,
    FoundColumn,
    Role,
    find_columns,
    find_time,
    read_table,
)
from harness.recordings.units import LENGTHS, VOLTAGES

__all__ = ["StackResponse", "check", "moved_by", "read_response", "turning_points"]

FEWEST_SAMPLES = 500
"""Fewer samples cannot hold loops of every size."""
DISPLACEMENTS = (20e-9, 2e-3)
"""Range of a piezo actuator's stroke from end to end, with or without levers [m]."""
DRIVES = (0.05, 2000.0)
"""Range of a voltage from end to end, ahead of an amplifier or behind it [V]."""
DEAD_BAND = 0.01
"""Share of the voltage's range that a reversal has to exceed; noise is less."""
FLAT = 1e-4
"""Share of a signal's range within which it counts as not moving."""
WIDER, LONGER = 16.0, 2.0
"""A band about a flat top that is `WIDER` times wider makes it at most `LONGER` times longer."""
FLAT_SAMPLES = 5
"""Samples that a flat top has at least."""
MOVED = 0.02
"""Share of the other signal's range that shows that this one should have moved."""
SETTLING = 10e-3
"""Time that a stroke takes to follow a voltage that has come to rest [s]."""
ZERO, OFFSET = 1e-3, 0.02
"""Share of the voltage that counts as 0 V; least share of the stroke that is an offset."""
TOGETHER = 0.5
"""Least correlation of voltage and displacement; loops of 30 % have 0.97."""

_VOLTS = ("volts", "voltage", "volt", "v", "u", "drive", "command", "input")
_DISPLACEMENT = (
    *("displacement", "stroke", "disp", "position", "pos", "measured", "output"),
    *("z", "y", "x", "d"),
)
ROLES = (
    TIME,
    Role("volts", _VOLTS, VOLTAGES, "V"),
    Role("displacement", _DISPLACEMENT, LENGTHS),
)
"""Roles of the columns."""


@dataclass(frozen=True)
class StackResponse:
    """Stroke of an actuator under a voltage.

    Attributes:
        path: file that it comes from.
        columns: columns that were read as time, volts and displacement, for messages.
        time: (n,) [s], from 0 on, even.
        volts: (n,) [V]; volts[k] acts until the time at which stroke[k] is read.
        stroke: (n,) [m].
        period: period of the samples [s].
        notes: sentences about what is unusual but may be right.
    """

    path: Path
    columns: Mapping[str, str]
    time: FloatArray
    volts: FloatArray
    stroke: FloatArray
    period: float
    notes: tuple[str, ...] = ()


def read_response(
    path: Path,
    fewest_reversals: int,
    mapping: ColumnMapping | None = None,
    gain: float = 1.0,
    flip: bool = False,
    late: int = 0,
) -> StackResponse:
    """Read and check a recording.

    Args:
        path: text table or Parquet.
        fewest_reversals: least number of reversals of the voltage.
        mapping: columns `time`, `volts` and `displacement` and their units, as far as the file does
            not say.
        gain: gain of the amplifier, if the recorded voltage is ahead of it [V/V].
        flip: True if the displacement falls while the stack grows, as with some sensors.
        late: rows by which the displacement is behind the voltage: 1 if a row holds the voltage
            that is set at its time, and the displacement at that time, which it cannot move yet.

    Raises:
        ProblemsError: everything that is wrong with the data.
        SteadytipError: no such file, not a table, no such column, or no unit.
    """
    mapping = mapping or ColumnMapping()
    table = read_table(path)
    found = find_columns(table, ROLES, mapping)
    if mapping.columns.get("volts") is None:
        _refuse_time(table, found["volts"])
    found["time"] = find_time(table, found, mapping)
    time, lines = found["time"].values, table.lines
    volts, stroke = found["volts"].values * gain, found["displacement"].values
    stroke = -stroke if flip else stroke
    if not 0 <= late < len(time):
        raise SteadytipError(
            f"--late {late}: must be 0 rows or more, and less than the {len(time)} there are"
        )
    if late:
        volts, stroke = volts[:-late], stroke[late:]
        time, lines = time[late:], lines[late:]
    table = replace(table, lines=lines)
    notes = check(f"recording {path}", time, volts, stroke, fewest_reversals, table.place)
    offset = _offset_at_rest(volts, stroke)
    if offset:
        stroke = stroke - offset
        text = f"the displacement is {1e6 * offset:.4g} um at rest at 0 V: that is taken off"
        notes = (*notes, text)
    period = float((time[-1] - time[0]) / (len(time) - 1))
    columns = {role: column.text for role, column in found.items()}
    return StackResponse(path, columns, time - time[0], volts, stroke, period, notes)


def moved_by(response: StackResponse, rows: int) -> StackResponse:
    """Return a response whose displacement stands some rows earlier."""
    end = len(response.time) - rows
    return replace(
        response,
        time=response.time[rows:] - response.time[rows],
        volts=response.volts[:end],
        stroke=response.stroke[rows:],
    )


def _refuse_time(table: DataTable, volts: FoundColumn) -> None:
    """Refuse a column that was read as the voltage but rises as a time does."""
    steps = np.diff(volts.values)
    if len(steps) and steps[0] > 0 and np.allclose(steps, steps[0], rtol=1e-3):
        raise SteadytipError(
            f"recording {table.path}: {volts.text}, read as volts, rises evenly from row to row, "
            "as a time does; say which is which with --time, --volts and --displacement (there "
            f"are: {table.columns})"
        )


def check(
    where: str,
    time: FloatArray,
    volts: FloatArray,
    stroke: FloatArray,
    fewest_reversals: int,
    place: Callable[[int], str] = lambda k: f"sample {k + 1}",
) -> tuple[str, ...]:
    """Refuse signals from which nothing can be identified.

    Args:
        where: the recording's name, for messages.
        time: (n,) [s].
        volts: (n,) [V].
        stroke: (n,) [m].
        fewest_reversals: fewest reversals of the voltage.
        place: name of a sample.

    Returns:
        Sentences about what is unusual but may be right.

    Raises:
        ProblemsError: everything that is wrong.
    """
    signals = {"time": (time, "s"), "voltage": (volts, "V"), "displacement": (stroke, "m")}
    problems = [
        problem
        for name, (values, unit) in signals.items()
        for problem in non_finite_problems(name, values, place, unit)
    ]
    if len(time) < FEWEST_SAMPLES:
        problems.append(
            f"{len(time)} samples; at least {FEWEST_SAMPLES} are needed: record longer, or faster"
        )
    if problems:  # nothing else can be said about such columns
        raise ProblemsError(where, problems)
    problems += time_problems(time, place)
    moving = list(_range_problems(volts, stroke))
    problems += moving
    if not moving:
        period = float(np.median(np.diff(time)))
        problems += _sign_problems(volts, stroke)
        problems += _clipping_problems(time, volts, stroke, period, place)
        turns = max(len(turning_points(volts, DEAD_BAND * np.ptp(volts))) - 2, 0)
        if turns < fewest_reversals:
            problems.append(
                f"the voltage turns {turns} times (moves of less than {100 * DEAD_BAND:g} % of its "
                f"range do not count) and must {fewest_reversals} times at least; record loops of "
                "every size"
            )
    if problems:
        raise ProblemsError(where, problems)
    return tuple(_notes(time, volts, stroke, place))


def turning_points(values: FloatArray, dead_band: float) -> FloatArray:
    """Return the samples at which a signal turns, with the first and the last one.

    Args:
        values: (n,).
        dead_band: a move of less than that is no turn.
    """
    found, direction, low, high = [0], 0, 0, 0
    listed = values.tolist()
    for k, value in enumerate(listed):
        if direction >= 0:
            if value > listed[high]:
                high = k
            elif listed[high] - value > dead_band:
                found += [high] * direction
                direction, low = -1, k
                continue
        if direction <= 0:
            if value < listed[low]:
                low = k
            elif value - listed[low] > dead_band:
                found += [low] * -direction
                direction, high = 1, k
    return np.array([*found, len(listed) - 1])


def _offset_at_rest(volts: FloatArray, stroke: FloatArray) -> float:
    """Return the sensor's offset [m], if the recording begins at rest at 0 V; else 0.

    Operators begin unloaded: a stroke that does not would be taken for hysteresis.
    """
    span = float(np.ptp(volts))
    moved = np.flatnonzero(np.abs(volts) > ZERO * span)
    rest = stroke[: moved[0]] if len(moved) else stroke
    if len(rest) < FLAT_SAMPLES:
        return 0.0
    offset = float(np.median(rest))
    return offset if abs(offset) > OFFSET * float(np.ptp(stroke)) else 0.0


def _range_problems(volts: FloatArray, stroke: FloatArray) -> Iterator[str]:
    for name, option, unit, values, units, (low, high) in (
        ("voltage", "--volts", "V", volts, VOLTAGES, DRIVES),
        ("displacement", "--displacement", "m", stroke, LENGTHS, DISPLACEMENTS),
    ):
        span = float(np.ptp(values))
        ratios = {new / old for new in units.values() for old in units.values()}
        if span == 0.0:
            yield (
                f"the {name} is {values[0]:g} {unit} all the time; choose its column with {option}"
            )
        elif not low <= span <= high:
            cure = "check which columns were read"
            if any(low <= ratio * span <= high for ratio in ratios):
                cure = f"is it in another unit? Give {option}-unit {'|'.join(units)}"
            yield (
                f"the {name} covers {span:.3g} {unit}, which should be {low:g} to {high:g} {unit}; "
                f"{cure}"
            )


def _sign_problems(volts: FloatArray, stroke: FloatArray) -> Iterator[str]:
    together = float(np.corrcoef(volts, stroke)[0, 1])
    if together <= -TOGETHER:
        yield (
            f"the stroke falls while the voltage rises (correlation {together:.2f}); if that is "
            "the sensor's sign, give --flip"
        )
    elif together < TOGETHER:
        yield (
            f"voltage and displacement hardly move together (correlation {together:.2f}, should be "
            f"above {TOGETHER:g}); check which columns were read, and that --late is right"
        )


def _clipping_problems(
    time: FloatArray,
    volts: FloatArray,
    stroke: FloatArray,
    period: float,
    place: Callable[[int], str],
) -> Iterator[str]:
    """Yield signals that stay at an extreme although the other one shows that they should not."""
    wait = round(SETTLING / period)
    for name, other, signal, reference, factor, unit in (
        ("displacement", "voltage", stroke, volts, 1e6, "um"),
        ("voltage", "displacement", volts, stroke, 1.0, "V"),
    ):
        span = np.ptp(reference)
        for word, side in (("largest", 1.0), ("smallest", -1.0)):
            tops = list(_flat_tops(side * signal))
            moves = [
                _rise(side * volts[begin:end])
                if signal is stroke
                else _swing(side * stroke[begin + wait : end])
                for begin, end in tops
            ]
            if any(move > MOVED * span for move in moves):
                # One top gives the limit away; all of them are at it.
                first, flat = tops[0][0], sum(end - begin for begin, end in tops)
                yield (
                    f"the {name} is clipped: it stays at its {word} value, "
                    f"{signal[first] * factor:.6g} {unit}, while the "
                    f"{other} moves on; first at {time[first]:.6g} s, {place(first)}, "
                    f"{100 * flat / len(signal):.2g} % of the samples. Widen the range of the "
                    "measurement, or make the voltage smaller"
                )


def _rise(values: FloatArray) -> float:
    """Return how far a signal rises from its beginning."""
    return float(values.max() - values[0])


def _swing(values: FloatArray) -> float:
    """Return how far a signal rises and falls again; creep under a held voltage does not.

    Means of some samples are compared, because the noise of a sensor rises and falls, too.
    """
    count = max(len(values) // FLAT_SAMPLES, FLAT_SAMPLES)
    if len(values) < count + 2:
        return 0.0
    smooth = np.convolve(values, np.full(count, 1 / count), "valid")
    return float(smooth.max() - max(smooth[0], smooth[-1]))


def _flat_tops(signal: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield the runs of samples, (first, past the last), in which a signal stays at its maximum.

    The top of a slow sine is no such run. A wider band about the maximum makes it longer, but
    hardly changes the length of a flat top.
    """
    wide = runs(signal >= signal.max() - WIDER * FLAT * np.ptp(signal))
    for begin, end in runs(signal >= signal.max() - FLAT * np.ptp(signal)):
        around = next(b - a for a, b in wide if a <= begin < b)
        if end - begin >= FLAT_SAMPLES and around < LONGER * (end - begin):
            yield begin, end


def _notes(
    time: FloatArray, volts: FloatArray, stroke: FloatArray, place: Callable[[int], str]
) -> Iterator[str]:
    for side, sign in (("largest", 1.0), ("smallest", -1.0)):
        # Rest before the first and after the last move is how recordings begin and end.
        tops = [top for top in _flat_tops(sign * volts) if top[0] > 0 and top[1] < len(volts)]
        share = sum(end - begin for begin, end in tops) / len(volts)
        if tops:
            k = tops[0][0]
            yield (
                f"the voltage stays at its {side} value, {volts[k]:.6g} V, for {100 * share:.2g} % "
                f"of the recording, first at {time[k]:.6g} s ({place(k)}): well if it was held "
                "there, but an amplifier at its limit if it was not"
            )
