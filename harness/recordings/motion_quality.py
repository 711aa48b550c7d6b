"""Check a recorded motion before anything is computed from it.

Every check has a statistic with a threshold. The interpolation error of a sample is its distance
from the cubic through its four neighbours; at even times

    e_i = x_i - (-x_{i-2} + 4 x_{i-1} + 4 x_{i+1} - x_{i+2}) / 6.

A smooth motion leaves it small: 0.1 to 0.4 um of noise in recordings of hands at 250 Hz, and no
more than 7 times its scale.

| finding | statistic | threshold |
| --- | --- | --- |
| time-unit | sample rate | outside 10 Hz to 100 kHz, and another unit makes it plausible |
| length-unit | speed; extent | 95 % quantile above 0.3 m/s; below 2 um; another unit fits |
| no-motion | extent | below 10 nm |
| noisy-clock | share of the stamps' unevenness that e shows | below 1/2 by 3 deviations |
| uneven-clock | the same | above 1/2 by 3 deviations |
| held-samples | rows that repeat the one before | 40 %, in runs of even length |
| stuck-axis | an axis keeps its value while another one moves | 0.2 s |
| clipped | values at the end of the range, in runs of 3 entered by a step | 6 values |
| glitch | e over its scale within half a second | 15, and 3 um; from 20 um on it stops the run |
| lost-samples | numbers of the samples by their stamps | one |
| jump | the same, where two neighbours are off by as much to either side | the same |
| coarse | least difference of two values of an axis | 5 um |
| sampled-too-slowly | sample rate | 50 Hz; below 35 Hz it stops the run |

At 50, 40, 35 and 25 Hz a spline through the samples of ten recorded hands loses up to 4, 6, 11 and
43 % of the rms between 6 and 16 Hz.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass

import numpy as np

from harness.common.types import FloatArray
from harness.recordings.findings import Finding
from harness.recordings.quality import BoolArray, runs

__all__ = ["Assessment", "assess_motion"]

SLOW, TOO_SLOW = 50.0, 35.0
"""Sample rates below which tremor up to 16 Hz suffers, and is lost [Hz]."""
PLAUSIBLE_RATES = (10.0, 100e3)
"""Sample rates that loggers of motion have [Hz]."""
FASTEST = 0.3
"""What 95 % of the speeds of a hand stay below [m/s]."""
LEAST_EXTENT = 2e-6
"""What every hand moves within a second [m]."""
GLITCH, GLITCH_FLOOR, GLITCH_STOPS = 15.0, 3e-6, 20e-6
"""Least glitch in scales of the interpolation error, and [m]; the one that stops a run [m]."""

_MOTIONLESS = 1e-8  # m
_EVEN = 0.01  # rms distance of stamps from even times, in periods, that no figure depends on
_HELD_SHARE, _HELD_SPREAD = 0.4, 0.35
_STUCK = 0.2  # s
_CLIPPED_RUN, _CLIPPED_ROWS = 3, 6
_STEP = 0.83  # of its neighbour's error; 2/3 at a glitch, 1 at a step
_COARSE = 5e-6  # m
_WINDOW = 0.5  # s
_WANDER = 4.0  # s, over which the period of an even clock may change
_FACTORS = {
    1e-3: "a thousandth",
    1e-6: "a millionth",
    1e3: "a thousand times",
    1e6: "a million times",
}

Place = Callable[[int], str]


@dataclass(frozen=True)
class Assessment:
    """A motion as it will be used, and what was found.

    Attributes:
        time: (n,) [s].
        position: (n, 3) [m].
        findings: defects, in the order of the checks.
    """

    time: FloatArray
    position: FloatArray
    findings: tuple[Finding, ...] = ()


def assess_motion(
    time: FloatArray, position: FloatArray, place: Place, repair: Collection[str] = ()
) -> Assessment:
    """Check a motion, and put right what can be put right safely.

    Args:
        time: (n,) [s], as stamped.
        position: (n, 3) [m].
        place: returns the name of a row.
        repair: names of findings to repair that are not repaired unasked: `glitch`.

    Returns:
        The motion to use: even times where the stamps were noisy, the samples alone where a table
        holds each of them over several rows.
    """
    findings: list[Finding] = []
    unit = _units(time, position)
    if unit:
        return Assessment(time, position, (unit,))
    if np.ptp(position, axis=0).max() < _MOTIONLESS:
        extent = np.ptp(position, axis=0).max()
        found = _note(
            "no-motion",
            f"0 to {time[-1] - time[0]:.3g} s",
            f"the recording does not move: it stays within {extent * 1e9:.2g} nm",
            "It has no figures in per cent, and means leave it out",
        )
        return Assessment(time, position, (found,))
    kept, held = _held(time, position)
    findings += held
    rows = np.flatnonzero(kept)
    time, position = time[kept], position[kept]

    def kept_place(row: int) -> str:
        return place(int(rows[row]))

    time, clock = _clock(time, position)
    findings += clock
    if not (np.diff(time) > 0).all():
        return Assessment(time, position, tuple(findings))
    axes = [*_stuck(time, position, kept_place), *_clipped(position, kept_place)]
    findings += axes
    if not axes:  # the end of a stuck or clipped run looks like one
        position, glitches = _glitches(time, position, kept_place, "glitch" in repair)
        findings += glitches
    findings += _coarse(position)
    findings += _rate(time)
    return Assessment(time, position, tuple(findings))


def interpolation_error(time: FloatArray, values: FloatArray) -> FloatArray:
    """Return the distance of every sample from the cubic through its four neighbours.

    Args:
        time: (n,) rising.
        values: (n, k).

    Returns:
        (n, k); 0 for the two samples at either end.
    """
    nodes = np.stack([time[:-4], time[1:-3], time[3:-1], time[4:]])
    at = time[2:-2]
    error = np.zeros_like(values)
    error[2:-2] = values[2:-2]
    for j, samples in enumerate((values[:-4], values[1:-3], values[3:-1], values[4:])):
        others = np.delete(nodes, j, axis=0)
        weight = np.prod((at - others) / (nodes[j] - others), axis=0)
        error[2:-2] -= weight[:, None] * samples
    return error


def _note(name: str, where: str, text: str, cure: str) -> Finding:
    return Finding(name, "note", where, text, cure)


def _stop(name: str, where: str, text: str, cure: str) -> Finding:
    return Finding(name, "stop", where, text, cure)


def _speeds(time: FloatArray, position: FloatArray) -> FloatArray:
    steps = np.diff(time)
    moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
    speeds: FloatArray = moved[steps > 0] / steps[steps > 0]
    return speeds


def _units(time: FloatArray, position: FloatArray) -> Finding | None:
    """Find a time or a length in another unit than its label says."""
    period = float(np.median(np.diff(time)))
    extent = float(np.ptp(position, axis=0).max())
    if period <= 0 or extent < 0.0:
        return None
    low, high = PLAUSIBLE_RATES
    speed = float(np.percentile(_speeds(time, position), 95))
    where = f"all {len(time)} rows"
    if not low <= 1 / period <= high:
        for factor, name in _FACTORS.items():
            if SLOW <= 1 / (period * factor) <= high and 1e-5 < speed / factor < FASTEST:
                return _stop(
                    "time-unit",
                    where,
                    f"{1 / period:.3g} samples a second and {speed:.2g} m/s are no hand's; with "
                    f"{name} of the time it is {1 / (period * factor):.4g} Hz and "
                    f"{speed / factor:.2g} m/s",
                    "Give the unit of the time",
                )
    if speed > FASTEST:
        for factor, name in ((1e-3, "a thousandth"), (1e-6, "a millionth")):
            if 1e-5 < speed * factor < FASTEST:
                return _stop(
                    "length-unit",
                    where,
                    f"95 % of the speeds are up to {speed:.3g} m/s, and no hand's above "
                    f"{FASTEST:g} m/s; with {name} of the length it is {speed * factor:.2g} m/s",
                    "Give the unit of the length",
                )
    if _MOTIONLESS < extent < LEAST_EXTENT and time[-1] - time[0] >= 1.0:
        return _stop(
            "length-unit",
            where,
            f"the whole recording stays within {extent * 1e6:.2g} um, and every hand moves more; "
            f"with a thousand times the length it is {extent * 1e6:.2g} mm",
            "Give the unit of the length",
        )
    return None


def _held(time: FloatArray, position: FloatArray) -> tuple[BoolArray, list[Finding]]:
    """Find samples that the table holds over several rows; keep the first row of each."""
    new = np.ones(len(time), bool)
    new[1:] = (np.diff(position, axis=0) != 0).any(axis=1)
    changes = np.flatnonzero(new)
    lengths = np.diff(changes)
    everything = np.ones(len(time), bool)
    if 1 - new.mean() < _HELD_SHARE or len(lengths) < 10:
        return everything, []
    typical = float(np.median(lengths))
    if typical < 2 or np.median(np.abs(lengths - typical)) / typical > _HELD_SPREAD:
        return everything, []
    rate = 1 / float(np.median(np.diff(time)))
    own = (len(changes) - 1) / float(time[changes[-1]] - time[changes[0]])
    return new, [
        Finding(
            "held-samples",
            "repaired",
            f"{len(time) - len(changes)} of {len(time)} rows repeat the row before",
            f"the table has {rate:.4g} rows a second, the sensor {own:.4g} samples; each sample is "
            "used once, at its own rate",
            "Record the samples as they come",
        )
    ]


def _clock(time: FloatArray, position: FloatArray) -> tuple[FloatArray, list[Finding]]:
    """Decide between the stamps and even times; return the times to use."""
    from scipy import signal

    candidates = []
    for number in (np.arange(float(len(time))), _sample_numbers(time)):
        period, start = np.polyfit(number, time, 1)
        even = start + period * number
        window = min(int(_WANDER / period), len(time) - 1) | 1
        even += signal.savgol_filter(time - even, window, 1, mode="interp")
        off = float(np.sqrt(np.mean((time - even) ** 2)))
        if off < _EVEN * period:
            return time, _lost(number, time)
        if (np.diff(even) > 0).all():
            candidates.append((_size(interpolation_error(even, position)), number, even, off))
    if not candidates:
        return time, []
    _, number, even, off = min(candidates, key=lambda candidate: candidate[0])
    period = float(np.mean(np.diff(even)) * (len(time) - 1) / number[-1])
    share, deviation = _share_of_stamps(time, even, position)
    where = f"stamps {off * 1e3:.3g} ms rms off even times, {off / period:.2g} periods"
    shown = f"{100 * share:.0f} % of the motion that the stamps' unevenness would make is there"
    if share + 3 * deviation < 0.5:
        text = (
            f"the samples are even at {1 / period:.5g} Hz and their stamps are noisy: {shown}; "
            "even times are used"
        )
        cure = "Stamp the samples where they are taken"
        return even, [Finding("noisy-clock", "repaired", where, text, cure), *_lost(number, even)]
    if share - 3 * deviation > 0.5:
        text = f"the samples are as uneven as their stamps say: {shown}"
        return time, [_note("uneven-clock", where, text, "The stamps are used as they are")]
    return time, []


def _share_of_stamps(
    time: FloatArray, even: FloatArray, position: FloatArray
) -> tuple[float, float]:
    """Return how much of the stamps' unevenness the motion shows, and its standard deviation.

    If the samples were taken at their stamps, the motion at even times would be off by speed times
    the distance of the stamps from even times: the share is 1. If they were taken at even times it
    is 0.
    """
    speed = np.gradient(position, even, axis=0)
    expected = speed * interpolation_error(even, time[:, None])
    error = interpolation_error(even, position)
    quiet = np.abs(error) <= np.quantile(np.abs(error), 0.99, axis=0)
    expected, error = expected[quiet], error[quiet]
    power = float(expected @ expected)
    if power == 0.0:
        return 0.5, np.inf
    share = float(expected @ error) / power
    # Neighbours share their errors: a correlation over five samples widens the deviation.
    left = error - share * expected
    return share, float(np.sqrt(5 * np.mean(left**2) / power))


def _sample_numbers(time: FloatArray) -> FloatArray:
    """Return the number of every sample, where a lost one counts, too."""
    steps = np.diff(time)
    period = float(np.median(steps))
    quantum = np.diff(np.unique(np.round(steps / period, 6)))
    if len(quantum) and 0.1 < quantum.min() < 0.75:  # stamps of so coarse a clock tell no loss
        return np.arange(float(len(time)))
    number = np.zeros(len(time))
    phase = time[0]
    for i in range(1, len(time)):
        count = max(1.0, round((time[i] - phase) / period))
        phase += count * period
        error = time[i] - phase
        phase += 0.1 * error
        period += 0.001 * error / count
        number[i] = number[i - 1] + count
    return number


def _lost(number: FloatArray, time: FloatArray) -> list[Finding]:
    count = int(number[-1]) + 1 - len(time)
    if not count:
        return []
    jumps = np.diff(number)
    first, widest = int(np.argmax(jumps > 1)), int(jumps.max())
    return [
        _note(
            "lost-samples",
            f"the first at {time[first] - time[0]:.4f} s, at most {widest - 1} in a row",
            f"{count} of {len(time) + count} samples are missing; the motion between their "
            "neighbours is interpolated",
            "Record again without losses if there are many",
        )
    ]


def _size(errors: FloatArray) -> float:
    """Return the size of interpolation errors over all axes, glitches left out."""
    sizes = np.linalg.norm(errors, axis=1)
    return float(np.mean(sizes[sizes <= np.quantile(sizes, 0.99)]))


def _stuck(time: FloatArray, position: FloatArray, place: Place) -> Iterator[Finding]:
    same = np.diff(position, axis=0) == 0
    for axis, name in enumerate("xyz"):
        others = ~np.delete(same, axis, axis=1).all(axis=1)
        ends = (position[:, axis].min(), position[:, axis].max())
        for first, past in runs(same[:, axis]):
            seconds = float(time[past] - time[first])
            if seconds < _STUCK or others[first:past].mean() < 0.5 or same[:, axis].all():
                continue  # a planar recording is no defect
            if position[first, axis] in ends and np.ptp(position[:, axis]) > 0:
                continue  # that is a range that ended: see `_clipped`
            yield _stop(
                "stuck-axis",
                f"{place(first)} to {place(past)}, from {time[first] - time[0]:.3f} s on",
                f"{name} keeps the value {position[first, axis] * 1e3:.6g} mm for {seconds:.3g} s "
                "while another axis moves",
                "Cut the recording there, or repair the sensor and record again",
            )
            break


def _clipped(position: FloatArray, place: Place) -> Iterator[Finding]:
    for axis, name in enumerate("xyz"):
        values = position[:, axis]
        if not np.ptp(values):
            continue
        step, quantum = np.abs(np.diff(values)), _quantum(values)
        for end, level in (("largest", values.max()), ("least", values.min())):
            flat = [
                (first, past)
                for first, past in runs(values == level)
                if past - first >= _CLIPPED_RUN
                and min(
                    step[first - 1] if first else np.inf,
                    step[past - 1] if past < len(values) else np.inf,
                )
                > 2 * quantum
            ]
            rows = sum(past - first for first, past in flat)
            if rows >= _CLIPPED_ROWS:
                yield _stop(
                    "clipped",
                    f"{len(flat)} times, {rows} rows, the first at {place(flat[0][0])}",
                    f"{name} stays at its {end} value, {level * 1e3:.6g} mm: the sensor's range "
                    "ended there",
                    "Record again within the range",
                )


def _glitches(
    time: FloatArray, position: FloatArray, place: Place, repair: bool
) -> tuple[FloatArray, list[Finding]]:
    """Find samples that are off; return the motion, repaired if that is wanted."""
    from scipy import ndimage

    error = interpolation_error(time, position)
    half = max(4, int(_WINDOW / float(np.median(np.diff(time))) / 2))
    found: list[tuple[float, int, int]] = []
    for axis in range(3):
        e = np.abs(error[:, axis])
        scale = 1.4826 * ndimage.median_filter(e, 2 * half + 1, mode="reflect")
        # The error of a neighbour of a glitch is two thirds of it: only the largest counts.
        peak = e >= ndimage.maximum_filter1d(e, 5)
        floor = max(GLITCH_FLOOR, 3 * _quantum(position[:, axis]))
        rows = np.flatnonzero(peak & (e > GLITCH * scale) & (e > floor))
        found += [(float(e[row]), int(row), axis) for row in rows]
    if not found:
        return position, []
    size, row, axis = max(found)
    beside = max((error[row - 1, axis], error[row + 1, axis]), key=abs)
    if -beside * np.sign(error[row, axis]) > _STEP * size:
        first = row if abs(error[row - 1, axis]) > abs(error[row + 1, axis]) else row + 1
        return position, [
            _stop(
                "jump",
                f"{place(first)}, at {time[first] - time[0]:.4f} s",
                f"{'xyz'[axis]} jumps by {2e3 * size:.3g} mm and stays there",
                "Cut the recording there",
            )
        ]
    more = f", and {len(found) - 1} smaller ones" if len(found) > 1 else ""
    where = f"{place(row)}, at {time[row] - time[0]:.4f} s{more}"
    text = f"{'xyz'[axis]} is off by {size * 1e3:.3g} mm in one sample"
    cure = "Remove the row, or have it replaced by what its neighbours say: --repair glitch"
    if not repair:
        finding = _stop if size >= GLITCH_STOPS else _note
        return position, [finding("glitch", where, text, cure)]
    position = position.copy()
    for _, row, axis in found:
        position[row, axis] -= error[row, axis]
    text += "; its neighbours' cubic takes its place"
    return position, [Finding("glitch", "repaired", where, text, "Look for its cause")]


def _coarse(position: FloatArray) -> Iterator[Finding]:
    for axis, name in enumerate("xyz"):
        values = position[:, axis]
        least = _quantum(values)
        steps = (values - values.min()) / least if least else values
        if least > _COARSE and np.abs(steps - np.round(steps)).max() < 0.01:
            yield _note(
                "coarse",
                f"column {name}",
                f"values are multiples of {least * 1e6:.3g} um, and tremor is some ten",
                "Write the recording with more digits",
            )


def _quantum(values: FloatArray) -> float:
    """Return the least difference of values that are not equal; 0 if all are."""
    steps = np.diff(np.unique(values))
    steps = steps[steps > 1e-9 * np.ptp(values)]
    return float(steps.min()) if len(steps) else 0.0


def _rate(time: FloatArray) -> Iterator[Finding]:
    rate = (len(time) - 1) / float(time[-1] - time[0])
    if rate < SLOW:
        finding = _stop if rate < TOO_SLOW else _note
        yield finding(
            "sampled-too-slowly",
            f"{rate:.4g} samples a second",
            f"tremor up to 16 Hz needs {SLOW:g} Hz; below {TOO_SLOW:g} Hz more than a tenth of it "
            "is lost",
            "Record faster",
        )
