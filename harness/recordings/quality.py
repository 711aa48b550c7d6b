"""Checks of recordings that hold for signals of any kind."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from fmu_src.errors import SteadytipError
from harness.common.types import FloatArray

__all__ = [
    "RECORD_AGAIN",
    "BoolArray",
    "non_finite_problems",
    "runs",
    "select_samples",
    "time_problems",
]

BoolArray = NDArray[np.bool_]

GAP = 1.5
"""Step of time that counts as a gap, in sample periods."""
JITTER = 0.5
"""Largest distance of a time from an even row of samples, in sample periods."""
SHORTEST_SELECTION = 100
"""Fewest samples of a recording that can be fitted, or used to validate."""
RECORD_AGAIN = "cut the recording there, or record again"
"""Cure for a value that is not finite."""


def non_finite_problems(
    name: str,
    values: FloatArray,
    place: Callable[[int], str],
    unit: str = "",
    cure: str = RECORD_AGAIN,
) -> list[str]:
    """Return a sentence about values that are not finite; empty if all of them are.

    Args:
        name: name of the signal.
        values: (n,).
        place: returns the name of a sample.
        unit: unit of the values; may be empty.
        cure: clause that tells what to do.
    """
    bad = np.flatnonzero(~np.isfinite(values))
    if not bad.size:
        return []
    more = f" and {len(bad) - 1} more" if len(bad) > 1 else ""
    value = f"{values[bad[0]]} {unit}".rstrip()
    return [f"{name} is {value} in {place(bad[0])}{more}; {cure}"]


def time_problems(time: FloatArray, place: Callable[[int], str]) -> Iterator[str]:
    """Yield a sentence with a cure for each defect of the times of samples.

    Args:
        time: (n,) [s].
        place: returns the name of a sample.
    """
    steps = np.diff(time)
    back, twice = np.flatnonzero(steps < 0), np.flatnonzero(steps == 0)
    if back.size:
        k = int(back[0])
        yield (
            f"time goes back from {time[k]:.9g} s to {time[k + 1]:.9g} s in {place(k + 1)}"
            f"{_more(len(back))}; sort the rows, or cut the recording there"
        )
    if twice.size:
        k = int(twice[0])
        yield (
            f"the time {time[k]:.9g} s stands twice, again in {place(k + 1)}{_more(len(twice))}; "
            "remove the repeated rows, write the time with more digits, or give --rate HZ"
        )
    if back.size or twice.size:
        return
    period = float(np.median(steps))
    wide = np.flatnonzero(steps > GAP * period)
    if wide.size:
        k = int(wide[0])
        yield (
            f"samples are missing at {time[k]:.6g} s, {place(k + 1)}: a gap of {steps[k]:.3g} s "
            f"where the period is {period:.3g} s{_more(len(wide))}, the longest "
            f"{steps.max():.3g} s; cut the recording there, or resample it"
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


def _more(count: int) -> str:
    if count < 3:
        return ", and once more" if count == 2 else ""
    return f", and {count - 1} times more"


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return the runs of True as (first, past the last)."""
    edges = np.flatnonzero(np.diff(flags.astype(int), prepend=0, append=0))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def select_samples(text: str, path: object, time: FloatArray) -> BoolArray:
    """Return the samples that the option `--fit` selects, (n,).

    Args:
        text: `START:END` in seconds, either of which may be missing, or the share of the recording
            from its beginning, `0.75` or `75%`.
        path: name of the recording, for messages.
        time: (n,) [s], from 0 on, rising.

    Raises:
        SteadytipError: the text has another form, or it selects too few samples.
    """
    n, where = len(time), f"--fit {text}"
    try:
        if ":" in text:
            begin, end = (float(word) if word.strip() else None for word in text.split(":"))
            low, high = begin or 0.0, float(time[-1]) if end is None else end
            selected = (time >= low) & (time <= high)
        else:
            share = float(text[:-1]) / 100 if text.strip().endswith("%") else float(text)
            if not 0 < share <= 1:
                raise SteadytipError(f"{where}: a share must be in (0, 1], or up to 100 %")
            selected = np.arange(n) < round(share * n)
    except ValueError:
        raise SteadytipError(
            f"{where}: write START:END in seconds, as in 0:30, or a share, as in 0.75 or 75%"
        ) from None
    if selected.sum() < SHORTEST_SELECTION:
        raise SteadytipError(
            f"{where}: holds {selected.sum()} of the {n} samples of {path} (0 to "
            f"{time[-1]:.6g} s); at least {SHORTEST_SELECTION} are needed"
        )
    return selected
