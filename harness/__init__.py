"""The harness: parts in a loop, recorded, measured and reported. Private: see `steadytip`."""

from typing import Any

_MOVED = {
    **dict.fromkeys(
        ("PartError", "RecordError", "Result", "RunError", "SteadytipError", "StoppedError"), ""
    ),
    **dict.fromkeys(("load", "read", "run", "sweep"), ""),
    "available": "scenarios",
}
"""Public names of before, and the new ones where they differ."""


def __getattr__(name: str) -> Any:
    if name in _MOVED:
        raise AttributeError(
            f"'harness.{name}' is 'steadytip.{_MOVED[name] or name}' now: import steadytip as st"
        )
    raise AttributeError(f"module 'harness' has no attribute '{name}'")
