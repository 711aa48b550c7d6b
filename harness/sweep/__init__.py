"""Sweeps: many runs of a scenario, over parameters, seeds, recordings and faults.

import harness
found = harness.sweep("closed_loop_sweep", runs=100)
found.table                                   # pyarrow, a row for each run
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from harness.sweep.outcome import Outcome

__all__ = ["sweep"]


def sweep(*arguments: Any, **options: Any) -> Outcome:
    """Run a sweep; see `harness.sweep.run.sweep`."""
    from harness.sweep.run import sweep as run_sweep

    return run_sweep(*arguments, **options)


class _Callable(ModuleType):
    """A module that is a function as well, so that `harness.sweep(...)` is what it says."""

    def __call__(self, *arguments: Any, **options: Any) -> Outcome:
        return sweep(*arguments, **options)


sys.modules[__name__].__class__ = _Callable
