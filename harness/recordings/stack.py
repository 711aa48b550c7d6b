"""Recordings of an actuator: voltage and displacement, read and checked.

Nothing is smoothed, resampled or repaired: what would spoil an identification is refused, with the
place, the value and a cure, all of it at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from harness.common.errors import ProblemsError, SteadytipError
from harness.common.types import FloatArray
from harness.recordings.tables import (
    LENGTHS,
    TIMES,
    VOLTAGES,
    Role,
    Table,
    find_columns,
    read_table,
)

__all__ = [
    "TIME_WORDS",
    "Choice",
    "Response",
    "check",
    "read_response",
    "runs",
    "time_problems",
    "turning_points",
]

FEWEST_SAMPLES = 500
"""Less than that holds no loops of every size."""
DISPLACEMENTS = (20e-9, 2e-3)
"""Range of a piezo actuator's stroke from end to end, with or without levers [m]."""
DRIVES = (0.05, 2000.0)
"""The same of a voltage, ahead of an amplifier or behind it [V]."""
GAP = 1.5
"""Sample periods from which on one is missing."""
JITTER = 0.5
"""Sample periods by which a time may be off an even row of samples."""
DEAD_BAND = 0.01
"""Share of the voltage's range that a reversal has to exceed; noise is less."""
FLAT = 1e-4
"""Share of a signal's range within which it counts as not moving."""
WIDER, LONGER = 16.0, 2.0
"""How many times wider a band about a flat top may be and make it how many times longer."""
FLAT_SAMPLES = 5
"""Samples that a flat top has at least."""
MOVED = 0.02
"""Share of the other signal's range that shows that this one should have moved."""
SETTLING = 10e-3
"""Time that a stroke takes to follow a voltage that has come to rest [s]."""
TOGETHER = 0.5
"""Least correlation of voltage and displacement; loops of 30 % have 0.97."""

_VOLTS = ("volts", "voltage", "volt", "v", "u", "drive", "command", "input")
_DISPLACEMENT = (
    *("displacement", "stroke", "disp", "position", "pos", "measured", "output"),
    *("z", "y", "x", "d"),
)
TIME_WORDS = ("time", "t", "timestamp", "seconds")
"""Headings of a column of times."""


@dataclass(frozen=True)
class Choice:
    """Which columns of a table are what, as far as the headings do not say.

    Attributes:
        volts: name or number (from 1) of the voltage's column; None to find it.
        displacement: of the displacement's.
        time: of the time's.
        rate: samples in a second, for a table without time [Hz].
        volts_unit: one of `tables.VOLTAGES`; None for what the heading says, else V.
        displacement_unit: one of `tables.LENGTHS`; None for what the heading says.
        time_unit: one of `tables.TIMES`; None for what the heading says, else s.
        gain: of the amplifier, where the recorded voltage is ahead of it.
        flip: whether the displacement falls while the stack grows, as with some sensors.
        late: rows by which the displacement is behind the voltage: 1 where a row holds the voltage
            that is set at its time, and the displacement at that time, which it cannot move yet.
    """

    volts: str | None = None
    displacement: str | None = None
    time: str | None = None
    rate: float | None = None
    volts_unit: str | None = None
    displacement_unit: str | None = None
    time_unit: str | None = None
    gain: float = 1.0
    flip: bool = False
    late: int = 0


@dataclass(frozen=True)
class Response:
    """How an actuator answered a voltage.

    Attributes:
        path: file that it comes from.
        columns: what was read as time, volts and displacement, in words.
        time: (n,) [s], from 0 on, even.
        volts: (n,) [V]; volts[k] acts until the time at which stroke[k] is read.
        stroke: (n,) [m].
        period: of the samples [s].
        notes: what is odd without being wrong; sentences.
    """

    path: Path
    columns: Mapping[str, str]
    time: FloatArray
    volts: FloatArray
    stroke: FloatArray
    period: float
    notes: tuple[str, ...] = ()


def read_response(path: Path, choice: Choice, fewest_reversals: int) -> Response:
    """Read and check a recording.

    Args:
        path: text table or Parquet.
        choice: columns and units as far as the file does not say.
        fewest_reversals: of the voltage, for what is to be identified.

    Raises:
        ProblemsError: everything that is wrong with the data.
        SteadytipError: no such file, not a table, no such column, or no unit.
    """
    if choice.time is not None and choice.rate is not None:
        raise SteadytipError("--time and --rate exclude each other; keep the one that is right")
    table = read_table(path)
    roles = [
        Role("volts", _VOLTS, VOLTAGES, "V", choice.volts, choice.volts_unit),
        Role("displacement", _DISPLACEMENT, LENGTHS, "", choice.displacement,
             choice.displacement_unit),
    ]  # fmt: skip
    if choice.rate is None:
        roles.insert(0, Role("time", TIME_WORDS, TIMES, "s", choice.time, choice.time_unit, True))
    found = find_columns(table, roles)
    signals = {role: values for role, (values, _) in found.items()}
    words = {role: text for role, (_, text) in found.items()}
    if choice.volts is None:
        _no_time(table, signals["volts"], words["volts"])
    if choice.rate is not None:
        if not (np.isfinite(choice.rate) and choice.rate > 0):
            raise SteadytipError(f"--rate {choice.rate:g}: must be above 0 Hz")
        signals["time"] = np.arange(len(table.values)) / choice.rate
        words["time"] = f"rows at {choice.rate:g} Hz"
    elif "time" not in signals:
        raise SteadytipError(
            f"recording {path} has no column that is called time; give --rate HZ, or --time NAME "
            f"(there are: {table.columns})"
        )
    volts, stroke = signals["volts"] * choice.gain, signals["displacement"]
    stroke = -stroke if choice.flip else stroke
    time, lines = signals["time"], table.lines
    if not 0 <= choice.late < len(time):
        raise SteadytipError(
            f"--late {choice.late}: must be 0 rows or more, and less than the {len(time)} there are"
        )
    if choice.late:
        volts, stroke = volts[: -choice.late], stroke[choice.late :]
        time, lines = time[choice.late :], lines[choice.late :]
    notes = check(
        f"recording {path}",
        time,
        volts,
        stroke,
        fewest_reversals,
        lambda k: f"{table.row} {int(lines[k])}",
    )
    period = float((time[-1] - time[0]) / (len(time) - 1))
    return Response(path, words, time - time[0], volts, stroke, period, notes)


def _no_time(table: Table, volts: FloatArray, words: str) -> None:
    """Refuse a column that was taken for the voltage but rises as a time does."""
    steps = np.diff(volts)
    if len(steps) and steps[0] > 0 and np.allclose(steps, steps[0], rtol=1e-3):
        raise SteadytipError(
            f"recording {table.path}: {words}, read as volts, rises evenly from row to row, as a "
            "time does; say which is which with --time, --volts and --displacement (there are: "
            f"{table.columns})"
        )


def check(
    where: str,
    time: FloatArray,
    volts: FloatArray,
    stroke: FloatArray,
    fewest_reversals: int,
    place: Callable[[int], str] = lambda k: f"sample {k + 1}",
) -> tuple[str, ...]:
    """Refuse what nothing can be identified from.

    Args:
        where: the recording's name, for messages.
        time: (n,) [s].
        volts: (n,) [V].
        stroke: (n,) [m].
        fewest_reversals: of the voltage.
        place: name of a sample.

    Returns:
        What is odd without being wrong, in sentences.

    Raises:
        ProblemsError: everything that is wrong.
    """
    signals = {"time": time, "voltage": volts, "displacement": stroke}
    units = {"time": "s", "voltage": "V", "displacement": "m"}
    problems = [
        f"{name} is {values[bad[0]]} {units[name]} in {place(bad[0])}"
        f"{f' and {len(bad) - 1} more' if len(bad) > 1 else ''}; cut the recording there, or record"
        " again"
        for name, values in signals.items()
        if (bad := np.flatnonzero(~np.isfinite(values))).size
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
    return tuple(_oddities(time, volts, stroke, place))


def turning_points(values: FloatArray, dead_band: float) -> FloatArray:
    """Samples at which a signal turns, the first and the last one included.

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


def time_problems(time: FloatArray, place: Callable[[int], str]) -> Iterator[str]:
    """What is wrong with the times of samples [s], (n,), in sentences with a cure."""
    steps = np.diff(time)
    back, twice = np.flatnonzero(steps < 0), np.flatnonzero(steps == 0)
    if back.size:
        k = int(back[0])
        yield (
            f"time goes back from {time[k]:.9g} s to {time[k + 1]:.9g} s in {place(k + 1)}"
            f"{_more(back)}; sort the rows, or cut the recording there"
        )
    if twice.size:
        k = int(twice[0])
        yield (
            f"the time {time[k]:.9g} s stands twice, again in {place(k + 1)}{_more(twice)}; remove "
            "the repeated rows, write the time with more digits, or give --rate HZ"
        )
    if back.size or twice.size:
        return
    period = float(np.median(steps))
    wide = np.flatnonzero(steps > GAP * period)
    if wide.size:
        k = int(wide[0])
        yield (
            f"samples are missing at {time[k]:.6g} s, {place(k + 1)}: a gap of {steps[k]:.3g} s "
            f"where the period is {period:.3g} s{_more(wide)}, the longest {steps.max():.3g} s; "
            "cut the recording there, or resample it"
        )
        return
    even = time[0] + np.arange(len(time)) * (time[-1] - time[0]) / (len(time) - 1)
    off = np.abs(time - even)
    if off.max() > JITTER * period:
        k = int(off.argmax())
        yield (
            f"samples are not evenly spaced: at {time[k]:.6g} s, {place(k)}, one is {off[k]:.3g} s "
            f"off its place, {off[k] / period:.2g} periods; resample the recording"
        )


def _more(places: np.ndarray) -> str:
    if len(places) < 3:
        return ", and once more" if len(places) == 2 else ""
    return f", and {len(places) - 1} times more"


def _range_problems(volts: FloatArray, stroke: FloatArray) -> Iterator[str]:
    low, high = DRIVES
    span = float(np.ptp(volts))
    if span == 0.0:
        yield f"the voltage is {volts[0]:g} V all the time; choose its column with --volts"
    elif not low <= span <= high:
        cure = _cure(span, VOLTAGES, DRIVES, "--volts-unit")
        yield f"the voltage covers {span:.3g} V, which should be {low:g} to {high:g} V; {cure}"
    low, high = DISPLACEMENTS
    span = float(np.ptp(stroke))
    if span == 0.0:
        yield (
            f"the displacement is {stroke[0]:g} m all the time; choose its column with "
            "--displacement"
        )
    elif not low <= span <= high:
        cure = _cure(span, LENGTHS, DISPLACEMENTS, "--displacement-unit")
        yield (
            f"the displacement covers {span:.3g} m, which should be {low:g} to {high:g} m; {cure}"
        )


def _cure(span: float, units: Mapping[str, float], good: tuple[float, float], option: str) -> str:
    """The unit that a span was wrongly read in, if another one makes sense of it."""
    ratios = {new / old for new in units.values() for old in units.values()}
    if any(good[0] <= ratio * span <= good[1] for ratio in ratios):
        return f"is it in another unit? Give {option} {'|'.join(units)}"
    return "check which columns were read"


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
    """Signals that stay at an extreme while the other one shows that they should not."""
    wait = round(SETTLING / period)
    for name, other, signal, moves, shown in (
        ("displacement", "voltage", stroke, lambda side, a, b: _out(side * volts[a:b]), 1e6),
        ("voltage", "displacement", volts, lambda side, a, b: _there_and_back(
            side * stroke[a + wait : b]), 1.0),
    ):  # fmt: skip
        span = np.ptp(volts if signal is stroke else stroke)
        for word, side in (("largest", 1.0), ("smallest", -1.0)):
            tops = list(_flat_tops(side * signal))
            if any(moves(side, begin, end) > MOVED * span for begin, end in tops):
                # One top gives the limit away; all of them are at it.
                first, flat = tops[0][0], sum(end - begin for begin, end in tops)
                value = f"{signal[first] * shown:.6g} {'um' if signal is stroke else 'V'}"
                yield (
                    f"the {name} is clipped: it stays at its {word} value, {value}, while the "
                    f"{other} moves on; first at {time[first]:.6g} s, {place(first)}, "
                    f"{100 * flat / len(signal):.2g} % of the samples. Widen the range of the "
                    "measurement, or make the voltage smaller"
                )


def _out(values: FloatArray) -> float:
    """How far a signal rises from its beginning."""
    return float(values.max() - values[0])


def _there_and_back(values: FloatArray) -> float:
    """How far a signal rises and falls again; creep under a voltage that is held does not.

    Means of some samples, since a sensor's noise goes there and back, too.
    """
    count = max(len(values) // FLAT_SAMPLES, FLAT_SAMPLES)
    if len(values) < count + 2:
        return 0.0
    smooth = np.convolve(values, np.full(count, 1 / count), "valid")
    return float(smooth.max() - max(smooth[0], smooth[-1]))


def _flat_tops(signal: FloatArray) -> Iterator[tuple[int, int]]:
    """Runs of samples, (first, past the last), in which a signal stays at its maximum.

    The top of a slow sine is no such run: a wider band about the maximum makes it longer, a flat
    top's length it hardly changes.
    """
    wide = runs(signal >= signal.max() - WIDER * FLAT * np.ptp(signal))
    for begin, end in runs(signal >= signal.max() - FLAT * np.ptp(signal)):
        around = next(b - a for a, b in wide if a <= begin < b)
        if end - begin >= FLAT_SAMPLES and around < LONGER * (end - begin):
            yield begin, end


def runs(held: np.ndarray) -> list[tuple[int, int]]:
    """Runs of True, (first, past the last)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], held, [False])).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _oddities(
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
