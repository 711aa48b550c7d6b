"""Say in words what is wrong with a table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from harness.common.errors import nearest
from harness.common.validation_errors import explain
from harness.parts.kinds import kinds
from harness.recordings.motion import MotionColumns
from harness.scenario.events import Change, Fault
from harness.scenario.schema import Hil, Limit, ScenarioTable, SignalRoles, WireTable
from harness.scenario.sweep import FaultRange, Sweep


def kind_problems(name: str, part: Mapping[str, Any]) -> Iterable[str]:
    """Yield what is wrong with the name and the kind of a part."""
    found = [key for key in kinds() if key in part]
    if "." in name or not name:
        yield f"part '{name}': a name has at least one letter and no dot"
    before = part.get("stands_for")
    if isinstance(before, dict) and len([key for key in kinds() if key in before]) != 1:
        yield f"part '{name}': 'stands_for' does not say what it was: one of {', '.join(kinds())}"
    if not found:
        yield (
            f"part '{name}' does not say what it is: add one of {', '.join(kinds())}"
            f"{_hint(part, kinds())}"
        )
    elif len(found) > 1:
        yield f"part '{name}' is several things at once ({', '.join(found)}): keep one"


def _hint(part: Mapping[str, Any], known: Iterable[str]) -> str:
    hints = {key: nearest(key, known) for key in part}
    close = [f"'{key}': {hint}" for key, hint in hints.items() if hint.startswith("did")]
    return f" ({'; '.join(close)})" if close else ""


_INNER: dict[str, type[BaseModel]] = {
    "part.columns": MotionColumns,
    "wire": WireTable,
    "signals": SignalRoles,
    "hil": Hil,
    "hil.limits": Limit,
    "change": Change,
    "fault": Fault,
    "sweep": Sweep,
    "sweep.fault": FaultRange,
}


def table_problems(error: ValidationError) -> list[str]:
    """Return what is wrong with a scenario's table, one sentence each."""
    return explain(error, ScenarioTable, _INNER, also=("extends",))
