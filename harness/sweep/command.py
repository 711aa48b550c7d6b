"""The command that runs one case of a sweep again, alone."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from harness.scenario.schema import Scenario
    from harness.sweep.plan import SweepCase

__all__ = ["command_of", "overrides_of"]


def overrides_of(scenario: Scenario, case: SweepCase) -> dict[str, Any]:
    """Return what makes the case of the scenario, as `running.run` takes it, without its recording.

    Args:
        scenario: that was swept over, with what the command line has replaced in it.
        case: one run of it.
    """
    found = {key: value for key, value in scenario.overrides.items() if not _of_sweep(key)}
    found |= {**case.values, "seed": case.seed}
    if case.changes:
        found["change"] = [_plain(each) for each in (*scenario.changes, *case.changes)]
    if case.fault is not None:
        found["fault"] = [_plain(each) for each in (*scenario.faults, case.fault)]
    return found


def _of_sweep(key: str) -> bool:
    return key == "sweep" or key.startswith("sweep.")


def _plain(table: Any) -> dict[str, Any]:
    return dict(table.model_dump(exclude_none=True, exclude_defaults=True))


def command_of(scenario: Scenario, case: SweepCase) -> str:
    """Return the command for a shell."""
    words = ["steadytip", "run", scenario.given]
    if scenario.variant is not None:
        words += ["--variant", scenario.variant]
    if case.motion is not None:
        words += ["--motion", case.motion]
    values = overrides_of(scenario, case)
    seed = values.pop("seed")
    for key, value in values.items():
        words += ["--set", f"{key}={toml(value)}"]
    return shlex.join([*words, "--seed", str(seed)])


def toml(value: Any) -> str:
    """Write a value as TOML does, on one line.

    >>> toml([{"at": 5.0, "set": {"part.x": 1e-05}}])
    '[{at = 5.0, set = {"part.x" = 1e-05}}]'
    """
    if isinstance(value, Mapping):
        pairs = (f"{_key(key)} = {toml(each)}" for key, each in value.items())
        return f"{{{', '.join(pairs)}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return repr(value)


def _key(key: str) -> str:
    plain = key.replace("_", "").replace("-", "").isalnum() and key.isascii()
    return key if plain else json.dumps(key, ensure_ascii=False)
