"""What a running loop's rings say, as the monitor shows it: functions of the last seconds alone.

The first ring is the loop's. Its parts that hear a board have ports `sample`, `age`, `valid` and
counters; `*.command.latency`, `*.command.mode` and `*.volts_sent_*` tell what was sent. Other rings
are those of emulated boards, who know where the tip is: their rows are the samples, by number.

Rings meet by the number of the sample. A row counts for a sample if it is the first that has it;
what lies before the number last went back, as when a board was started anew, is left out.
"""

from __future__ import annotations

import enum
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from itertools import chain
from pathlib import Path

import numpy as np

from harness.can.reception import FAULTS
from harness.common.patterns import matching
from harness.common.types import FloatArray
from harness.hil.ring import IntArray, Ring
from harness.parts.ports import Column
from harness.report.figures import SPECTRUM_WINDOW, amplitude_density
from harness.results.metrics import Metric, MetricInputs, intent_of, metrics_of

__all__ = [
    "MODES",
    "SILENT",
    "WINDOW",
    "Count",
    "Feed",
    "MonitorState",
    "MonitoredRings",
    "Rows",
    "Tip",
    "View",
    "Watchdog",
    "fresh",
    "histogram",
    "joined",
    "tip_of",
    "view_of",
]

WINDOW = 8.0
"""What is shown [s]."""
SILENT = 1.0
"""A loop that writes nothing for so long is no longer running [s]."""
MODES = ("off", "hold", "run")
"""Of a command, by its number."""

_FEED = ("sample", "age", "valid")
_SENT, _LATENCY, _MODE = "*.volts_sent_*", "*.command.latency", "*.command.mode"
_BIN = 25e-6  # s
_LATENCIES = 1e-3  # s, shown at least


class MonitorState(enum.Enum):
    """Of the process that writes a ring."""

    WAITING = "waiting"
    RUNNING = "running"
    SILENT = "silent"
    STOPPED = "stopped"


class Watchdog:
    """Tells from a ring's count whether its writer lives: it does while the count rises."""

    def __init__(self) -> None:
        """Begin with nothing seen."""
        self._written: int | None = None
        self._since = 0.0
        self._risen = False

    def look(self, ring: Ring | None, now: float) -> tuple[MonitorState, float]:
        """Look once; more often than every `SILENT`.

        Args:
            ring: None while there is none.
            now: time that never goes back [s].

        Returns:
            The state, and how long nothing has been written [s].
        """
        if ring is None:
            return MonitorState.WAITING, 0.0
        written, closed = ring.written, ring.closed
        if written != self._written:
            self._risen = self._written is not None
            self._written, self._since = written, now
        quiet = now - self._since
        if closed:
            return MonitorState.STOPPED, quiet
        if written and quiet > SILENT:
            return MonitorState.SILENT, quiet
        return (MonitorState.RUNNING if self._risen and written else MonitorState.WAITING), quiet


@dataclass(frozen=True)
class Rows:
    """The last rows of a ring.

    Attributes:
        step: period [s].
        ticks: their numbers, (n,).
        columns: of those that are shown.
        values: (n, columns).
    """

    step: float
    ticks: IntArray
    columns: tuple[Column, ...]
    values: FloatArray

    def names(self, pattern: str) -> tuple[str, ...]:
        """Columns that fit a pattern."""
        return matching([column.name for column in self.columns], pattern)

    def of(self, names: Iterable[str]) -> FloatArray:
        """(n, names)."""
        places = {column.name: place for place, column in enumerate(self.columns)}
        return self.values[:, [places[name] for name in names]]

    @property
    def feeds(self) -> tuple[str, ...]:
        """Parts that hear a board."""
        known = {column.name for column in self.columns}
        parts = [name.rpartition(".")[0] for name in self.names("*.sample")]
        return tuple(p for p in parts if all(f"{p}.{port}" in known for port in _FEED))

    def samples(self) -> tuple[IntArray, IntArray]:
        """Numbers of the samples, rising, and the rows that have them first."""
        if self.feeds:
            return fresh(self.of([f"{self.feeds[0]}.sample"])[:, 0])
        return self.ticks, np.arange(len(self.ticks))


@dataclass(frozen=True)
class Tip:
    """The tip, about the means of what is shown.

    Attributes:
        samples: numbers, (n,), without a gap.
        step: period [s].
        without: from where the hand wants it to where it would be without compensation, (n, 3) [m].
        error: from there to where it is, (n, 3) [m].
        metrics: of these seconds; see `harness.results.metrics`.
        spectra: frequencies, (m,) [Hz], and root of the density of both, (m,) [m/sqrt(Hz)]; None
            before there are enough samples.
    """

    samples: IntArray
    step: float
    without: FloatArray
    error: FloatArray
    metrics: Mapping[str, Metric]
    spectra: tuple[FloatArray, FloatArray, FloatArray] | None


@dataclass(frozen=True)
class Count:
    """A counter of a feed: from the start, and within what is shown."""

    name: str
    description: str
    total: int
    recent: int


@dataclass(frozen=True)
class Feed:
    """What a part says of the board that it hears, by the rows of the loop.

    Attributes:
        name: of the part.
        sample: the newest number; None before the first.
        age: (n,) [s].
        valid: (n,).
        counts: of those counters that it has.
    """

    name: str
    sample: int | None
    age: FloatArray
    valid: FloatArray
    counts: tuple[Count, ...]


@dataclass(frozen=True)
class View:
    """All that the page shows.

    Attributes:
        seconds: time of the loop at its newest row [s].
        time: of the loop's rows, before the newest, (n,) [s].
        tip: None where no ring knows the tip, or no sample is there yet.
        tip_time: of its samples on the same axis, (m,) [s].
        volts: names and values, (n, k) [V].
        mode: of the command, (n,); None without one.
        latency: from sample to command, one each, (l,) [s]; None without that column.
        feeds: in their order.
    """

    seconds: float
    time: FloatArray
    tip: Tip | None
    tip_time: FloatArray
    volts: tuple[tuple[str, ...], FloatArray]
    mode: FloatArray | None
    latency: FloatArray | None
    feeds: tuple[Feed, ...]


def fresh(sample: FloatArray) -> tuple[IntArray, IntArray]:
    """Find new samples among a column of their numbers.

    Args:
        sample: (n,), the number held until the next; negative or not a number: none.

    Returns:
        Numbers since they last went back, each once, (m,); the first row of each, (m,).
    """
    rows = np.flatnonzero(sample >= 0.0)
    numbers = sample[rows].astype(np.int64)
    change = np.diff(numbers, prepend=-1)
    begin = np.flatnonzero(change < 0)[-1:].sum()
    first = change[begin:] != 0
    return numbers[begin:][first], rows[begin:][first]


def joined(numbers: Sequence[IntArray]) -> tuple[IntArray, list[IntArray]]:
    """Return the samples that all rings have.

    Args:
        numbers: of each, rising.

    Returns:
        The common numbers, (m,), and their places within each, (m,).
    """
    common = reduce(partial(np.intersect1d, assume_unique=True), numbers)
    return common, [np.searchsorted(each, common) for each in numbers]


def histogram(latency: FloatArray) -> tuple[FloatArray, IntArray]:
    """Count how many commands took how long; the last bin holds those beyond, too.

    Args:
        latency: (n,) [s].

    Returns:
        Edges of the bins, (m + 1,) [s]; counts, (m,).
    """
    usual = float(np.quantile(latency, 0.995)) if len(latency) else 0.0
    bins = int(np.ceil(max(_LATENCIES, 1.25 * usual) / _BIN))
    wide = -(-bins // 80)
    edges = np.asarray(np.arange(0, bins + wide, wide) * _BIN)
    return edges, np.histogram(np.clip(latency, edges[0], edges[-1]), edges)[0]


def tip_of(rings: Sequence[Rows], roles: Mapping[str, Sequence[str]]) -> Tip | None:
    """Tip before and after compensation, from whichever rings have the signals.

    A sample that one of several rings lacks lies on the line between its neighbours.

    Args:
        rings: the last rows of each.
        roles: columns by role; without `intent`, `metrics.intent_of` finds it.
    """
    sources: dict[str, Rows] = {}
    for role in ("tip_uncompensated", "tip", "intent"):
        names = roles.get(role, ())
        for rows in rings:
            if names and set(names) <= {column.name for column in rows.columns}:
                sources.setdefault(role, rows)
    if not {"tip_uncompensated", "tip"} <= set(sources):
        return None
    known = {role: rows.samples() for role, rows in sources.items()}
    common, places = joined([numbers for numbers, _ in known.values()])
    if len(common) < 2:
        return None
    grid = np.arange(common[0], common[-1] + 1)
    signals: dict[str, FloatArray] = {}
    for (role, rows), place in zip(sources.items(), places, strict=True):
        values = rows.of(roles[role])[known[role][1][place]]
        if len(grid) > len(common):
            values = np.column_stack([np.interp(grid, common, each) for each in values.T])
        signals[role] = values
    step = sources["tip"].step
    motion = MetricInputs(
        step,
        tip_uncompensated=signals["tip_uncompensated"],
        tip=signals["tip"],
        intent=signals.get("intent"),
    )
    intent = intent_of(motion)
    assert intent is not None  # it can be made from `tip_uncompensated`
    without, error = signals["tip_uncompensated"] - intent, signals["tip"] - intent
    without, error = without - without.mean(axis=0), error - error.mean(axis=0)
    spectra = None
    if len(grid) > SPECTRUM_WINDOW / step:
        frequency, before = amplitude_density(without, step)
        spectra = frequency, before, amplitude_density(error, step)[1]
    return Tip(grid, step, without, error, metrics_of(motion), spectra)


def _feed(rows: Rows, name: str) -> Feed:
    columns = {column.name: column for column in rows.columns}
    counts = []
    for counter in FAULTS:
        column = columns.get(f"{name}.{counter}")
        if column is not None and len(rows.ticks):
            values = rows.of([column.name])[:, 0]
            total = int(np.nan_to_num(values[-1]))
            recent = total - int(np.nan_to_num(values[0]))
            counts.append(Count(counter, column.description, total, recent))
    sample, age, valid = rows.of(f"{name}.{port}" for port in _FEED).T
    numbers = sample[sample >= 0.0]
    newest = int(numbers[-1]) if len(numbers) else None
    return Feed(name, newest, age, valid, tuple(counts))


def view_of(
    rings: Sequence[Rows], roles: Mapping[str, Sequence[str]], shift: float | None = None
) -> tuple[View, float | None]:
    """Compute what the page shows.

    Args:
        rings: the last rows of each, the loop's first.
        roles: columns by role.
        shift: from time by samples to that of the loop when they last had a sample in common [s].

    Returns:
        The view, and the shift for the next.
    """
    loop = rings[0]
    now = float(loop.ticks[-1]) * loop.step if len(loop.ticks) else 0.0
    tip = tip_of(rings, roles)
    numbers, arrived = loop.samples()
    if tip is not None:
        common, (place, _) = joined([numbers, tip.samples])
        if len(common):
            tick = loop.ticks[arrived[place[-1]]]
            shift = float(tick) * loop.step - float(common[-1]) * tip.step
        elif shift is None:
            shift = now - float(tip.samples[-1]) * tip.step
    samples = tip.samples if tip is not None else np.empty(0)
    tip_time = np.asarray(samples * (tip.step if tip else 1.0) + (shift or 0.0) - now)
    names = loop.names(_SENT) or tuple(
        name for name in roles.get("actuator_voltage", ()) if loop.names(name)
    )
    mode, latency = loop.names(_MODE), loop.names(_LATENCY)
    latencies = loop.of(latency)[arrived] if latency else None
    return View(
        seconds=now,
        time=np.asarray(loop.ticks * loop.step - now),
        tip=tip,
        tip_time=tip_time,
        volts=(names, loop.of(names)),
        mode=loop.of(mode)[:, 0] if mode else None,
        latency=None if latencies is None else latencies[latencies > 0.0],  # 0: no new one
        feeds=tuple(_feed(loop, name) for name in loop.feeds),
    ), shift


class _Source:
    """A ring that may not be there yet."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.watchdog = Watchdog()
        self.ring: Ring | None = None
        self._taken: tuple[int, ...] = ()

    def open(self, roles: Mapping[str, Sequence[str]]) -> None:
        self.ring = ring = Ring.open(self.path)
        feeds = [name.rpartition(".")[0] for name in matching(ring.names, "*.sample")]
        shown = matching(ring.names, (_SENT, _LATENCY, _MODE, *chain(*roles.values())))
        ports = {f"{name}.{port}" for name in feeds for port in _FEED + FAULTS}
        self._taken = tuple(i for i, n in enumerate(ring.names) if n in ports or n in shown)

    def rows(self) -> Rows:
        if self.ring is None:
            return Rows(1.0, np.empty(0, np.int64), (), np.empty((0, 0)))
        ring, taken = self.ring, self._taken
        ticks, values = ring.latest(round(WINDOW / ring.step), taken)
        return Rows(ring.step, ticks, tuple(ring.columns[i] for i in taken), values)


class MonitoredRings:
    """The rings of a loop and its boards, opened as they appear. For any number of threads.

    Attributes:
        revision: rises whenever another ring has been opened.
    """

    def __init__(self, paths: Sequence[Path], roles: Mapping[str, Sequence[str]]) -> None:
        """Open nothing yet.

        Args:
            paths: of the rings, the loop's first.
            roles: names or patterns (`*`, `?`) of columns by role.
        """
        self.revision = 0
        self._roles = roles
        self._sources = [_Source(path) for path in paths]
        self._shift: float | None = None
        self._lock = threading.Lock()

    def open(self) -> Path | None:
        """Open what has appeared.

        Returns:
            A file that is not there yet.

        Raises:
            SteadytipError: a file is not a ring.
        """
        missing = None
        with self._lock:
            for source in self._sources:
                if source.ring is None and source.path.is_file():
                    source.open(self._roles)
                    self.revision += 1
                elif source.ring is None:
                    missing = missing or source.path
        return missing

    def look(self) -> list[tuple[Path, MonitorState, float]]:
        """State of each ring's writer, the loop's first, and for how long it has been quiet [s]."""
        now = time.monotonic()
        with self._lock:
            return [(each.path, *each.watchdog.look(each.ring, now)) for each in self._sources]

    def view(self) -> View:
        """Return the present view."""
        with self._lock:
            rings = [source.rows() for source in self._sources]
            view, self._shift = view_of(rings, self._roles_in(rings), self._shift)
        return view

    def _roles_in(self, rings: Sequence[Rows]) -> dict[str, tuple[str, ...]]:
        """Columns by role, of the first ring that has any."""
        found: dict[str, tuple[str, ...]] = {}
        for role, patterns in self._roles.items():
            each = (matching([c.name for c in rows.columns], patterns) for rows in rings)
            found[role] = next(filter(None, each), ())
        return found
