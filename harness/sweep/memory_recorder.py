"""A run's signals in memory, and no file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from harness.common.patterns import matching
from harness.results.consistency import consistency_of
from harness.results.metrics import metrics_of_result
from harness.results.run_metadata import RunMetadata
from harness.scenario.schema import NIS_OUTPUT

if TYPE_CHECKING:
    from harness.common.types import FloatArray
    from harness.results.metrics import Metric
    from harness.system.assembly import System

__all__ = ["MemoryRecorder", "wanted"]

_OF_ESTIMATORS = (NIS_OUTPUT, "innovation_size", "valid", "*_sigma_?")


def wanted(system: System) -> tuple[str, ...]:
    """Columns that figures of merit can need: those with a role, and what estimators state."""
    names = [column.name for column in system.columns]
    played = [name for columns in system.roles.values() for name in columns]
    stated = matching(names, [f"*.{port}" for port in _OF_ESTIMATORS])
    return tuple(dict.fromkeys([*played, *stated]))


class MemoryRecorder:
    """Takes the signals of every tick, as `recorder.Recorder` does; see `signals.Signals`."""

    def __init__(self, system: System, metadata: RunMetadata) -> None:
        """Make room for a whole run.

        Args:
            system: what is run.
            metadata: about the run, as far as figures of merit need them.
        """
        self.metadata = metadata
        self.columns: Sequence[str] = [column.name for column in system.columns]
        self._at = {name: k for k, name in enumerate(self.columns)}
        self._values = np.zeros((system.steps, len(self.columns)))
        self.ticks = 0
        """Rows that are filled; a run that goes on from a tick sets it to that."""

    def append(self, signals: FloatArray) -> None:
        """Keep one tick, (columns,)."""
        self._values[self.ticks] = signals
        self.ticks += 1

    def buffer(self) -> FloatArray:
        """See `harness.loop.loop.SignalSink`."""
        return self._values[self.ticks :]

    def commit(self, rows: int) -> None:
        """See `harness.loop.loop.SignalSink`."""
        self.ticks += rows

    def flush_idle(self) -> None:
        """Do nothing: nothing is held back."""

    @property
    def time(self) -> FloatArray:
        """(n,) instants of the samples [s]."""
        return np.asarray(np.arange(self.ticks) * self.metadata.step_size)

    def signals(self, name: str) -> FloatArray:
        """(n,) a signal by name."""
        return np.ascontiguousarray(self._values[: self.ticks, self._at[name]])

    def role(self, role: str) -> FloatArray | None:
        """(n, columns) signals that play a role; None without one."""
        names = self.metadata.roles.get(role)
        if not names:
            return None
        return np.column_stack([self._values[: self.ticks, self._at[name]] for name in names])

    def metrics(self) -> dict[str, Metric]:
        """Figures of merit by name, those of `Result` that are not of the clock."""
        found = metrics_of_result(self)
        return found | {k: v for each in consistency_of(self) for k, v in each.metrics().items()}
