"""Signals of a run, as figures of merit see them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from harness.common.types import FloatArray
from harness.results.run_metadata import RunMetadata

__all__ = ["RecordedSignals"]


class RecordedSignals(Protocol):
    """What figures of merit are computed from: see `Result`, which is one."""

    @property
    def metadata(self) -> RunMetadata:
        """About the run."""

    @property
    def time(self) -> FloatArray:
        """(n,) instants of the samples [s]."""

    @property
    def columns(self) -> Sequence[str]:
        """Names of what `signals` gives."""

    def signals(self, name: str) -> FloatArray:
        """(n,) a signal by name."""

    def role(self, role: str) -> FloatArray | None:
        """(n, columns) signals that play a role; None without one."""
