"""The harness: parts in a loop, recorded, measured and reported.

    import harness
    result = harness.run("closed_loop", motion="recording.csv", overrides={"seconds": 5.0})
    result.metrics["reduction_in_band"].value
    result.signals("instrument.tip_*")          # (n, 3) [m]
    harness.sweep("closed_loop_sweep", runs=100).summary["reduction_in_band"].median

Names are loaded when they are used, so that the command line starts quickly.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from harness import sweep
    from harness.errors import PartError, RecordError, RunError, SteadytipError, StoppedError
    from harness.result import Result, read
    from harness.runs import run
    from harness.scenario import available, load

_HOMES = {
    "PartError": "harness.errors",
    "RecordError": "harness.errors",
    "Result": "harness.result",
    "RunError": "harness.errors",
    "SteadytipError": "harness.errors",
    "StoppedError": "harness.errors",
    "available": "harness.scenario",
    "load": "harness.scenario",
    "read": "harness.result",
    "run": "harness.runs",
}

__all__ = [
    "PartError",
    "RecordError",
    "Result",
    "RunError",
    "SteadytipError",
    "StoppedError",
    "available",
    "load",
    "read",
    "run",
    "sweep",
]


def __getattr__(name: str) -> Any:
    if name == "sweep":
        return import_module("harness.sweep")  # a package that can be called
    if name not in _HOMES:
        raise AttributeError(f"module 'harness' has no attribute '{name}'")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value
