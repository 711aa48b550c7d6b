"""The harness: parts in a loop, recorded, measured and reported.

    import harness
    result = harness.run("closed_loop", motion="recording.csv", overrides={"seconds": 5.0})
    result.metrics["reduction_in_band"].value
    result.signals("instrument.tip_*")          # (n, 3) [m]

Names are loaded when they are used, so that the command line starts quickly.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'harness' has no attribute '{name}'")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value
