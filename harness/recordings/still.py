"""Recordings of sensors at rest: signals of one table, checked to hold nothing but noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fmu_src.errors import SteadytipError
from harness.common.errors import ProblemsError
from harness.common.types import FloatArray
from harness.recordings.quality import non_finite_problems, select_samples, time_problems
from harness.recordings.tables import (
    TIME,
    ColumnMapping,
    DataTable,
    Role,
    find_columns,
    find_time,
    read_table,
)
from harness.recordings.units import QUANTITIES, TIMES

__all__ = ["StillSignal", "read_still_signals"]

FEWEST = 1000
"""Fewest samples: an averaging time of ten samples then has a hundred averages."""
RATES, USUAL = (0.01, 200e3), (10.0, 50e3)
"""Sample rates that sensors at rest have, and those that most have [Hz]."""
KNOCK = 15.0
"""Standard deviations between two samples that noise does not reach."""


@dataclass(frozen=True)
class StillSignal:
    """A signal that was recorded at rest.

    Attributes:
        name: name of the column.
        unit: SI unit; empty if nobody says it.
        time: (n,) [s], from 0 on.
        values: (n,), in that unit.
        period: sample period [s].
        clock: column of the time and its unit, or the rate, for messages.
    """

    name: str
    unit: str
    time: FloatArray
    values: FloatArray
    period: float
    clock: str = ""


def read_still_signals(
    path: Path,
    columns: Sequence[str] = (),
    mapping: ColumnMapping | None = None,
    unit: str | None = None,
    fit: str = "100%",
) -> list[StillSignal]:
    """Read and check the signals of a table.

    Args:
        path: text table or Parquet.
        columns: names or numbers (from 1) of the signals; by default all columns of numbers except
            the time.
        mapping: column `time` or the rate, as far as the file does not say.
        unit: unit of columns that do not say theirs.
        fit: part that is used, as the option `--fit` writes it.

    Raises:
        ProblemsError: everything that is wrong with the data.
        SteadytipError: no such file, not a table, no such column, no time.
    """
    mapping = mapping or ColumnMapping()
    table = read_table(path, 1, "one is needed, with its time or with --rate HZ", FEWEST)
    where = f"recording {path}"
    time = find_time(table, find_columns(table, [TIME], mapping), mapping)
    n, t = len(table.values), time.values
    problems = non_finite_problems("time", t, table.place)
    if not problems and n >= 2:
        problems += time_problems(t, table.place)
    if n < FEWEST:
        problems.append(f"{n} samples; at least {FEWEST} are needed: record longer, or faster")
    if problems:
        raise ProblemsError(where, problems)
    period = float((t[-1] - t[0]) / (n - 1))
    _check_rate(where, time.text, period)
    selected = select_samples(fit, path, t - t[0])
    if selected.sum() < FEWEST:
        raise SteadytipError(
            f"--fit {fit}: holds {selected.sum()} of the {n} samples of {path}; at least {FEWEST} "
            "are needed"
        )
    table = replace(table, values=table.values[selected], lines=table.lines[selected])
    t = t[selected]
    signals = []
    for index in _indices(table, columns, time.index):
        values, si = _in_si(table, index, unit)
        name = table.headings[index] or f"column {index + 1}"
        problems += _noise_problems(table, index, values, period)
        signals.append(StillSignal(name, si, t - t[0], values, period, time.text))
    if problems:
        raise ProblemsError(where, problems)
    return signals


def _check_rate(where: str, clock: str, period: float) -> None:
    """Refuse a time in another unit than it is read in.

    Raises:
        SteadytipError: no inertial sensor has such a rate; with the likely unit.
    """
    low, high = RATES
    if low <= 1 / period <= high:
        return
    likely = [
        unit for unit, factor in TIMES.items() if USUAL[0] <= 1 / (period * factor) <= USUAL[1]
    ]
    cure = f"; give --time-unit {likely[0]} if it is in {likely[0]}" if likely else ""
    raise SteadytipError(
        f"{where}: time is {clock}, which makes {1 / period:.3g} samples a second; sensors have "
        f"{low:g} to {high:g} Hz{cure}"
    )


def _indices(table: DataTable, columns: Sequence[str], time: int) -> list[int]:
    """Return the indices of the chosen columns, or of all columns of numbers except the time."""
    if columns:
        roles = [Role(text, (), {"1": 1.0}, option="column") for text in columns]
        mapping = ColumnMapping({text: text for text in columns}, dict.fromkeys(columns, "1"))
        return [find_columns(table, [role], mapping)[role.name].index for role in roles]
    count = len(table.headings)
    found = [index for index in range(count) if index != time and not table.is_text(index)]
    if not found:
        raise SteadytipError(
            f"recording {table.path} has no column of numbers beside the time (there are: "
            f"{table.columns})"
        )
    return found


def _in_si(table: DataTable, index: int, unit: str | None) -> tuple[FloatArray, str]:
    """Return the values of a column in SI, and the SI unit."""
    said = table.units[index] or unit or ""
    for si, factors in QUANTITIES.items():
        if said in factors:
            return table.numbers(index) * factors[said], si
    if said:
        known = ", ".join(u for factors in QUANTITIES.values() for u in factors)
        raise SteadytipError(
            f"recording {table.path}: {table.describe(index)} is in '{said}'; known are {known}"
        )
    return table.numbers(index), ""


def _noise_problems(table: DataTable, index: int, values: FloatArray, period: float) -> list[str]:
    """Return sentences with a cure about what is not noise at rest in a column."""
    name = table.describe(index)
    problems = non_finite_problems(name, values, table.place)
    if problems:
        return problems
    steps = np.diff(values)
    if not steps.any():
        return [f"{name} is {values[0]:g} all the time: no noise, is it connected?"]
    spread = max(1.4826 * float(np.median(np.abs(steps))), 0.3 * float(np.std(steps)))
    jumps = np.flatnonzero(np.abs(steps) > KNOCK * spread)
    if jumps.size:
        k = int(jumps[0])
        return [
            f"{name} jumps by {abs(steps[k]):.3g} at {k * period:.6g} s, {table.place(k + 1)}, "
            f"where {spread:.2g} is usual from sample to sample: the sensor did not rest; leave "
            "that out with --fit START:END"
        ]
    return []
