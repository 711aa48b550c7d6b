"""What options of the command line say about a scenario."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Any

from fmu_src.errors import SteadytipError

__all__ = ["parse_overrides", "toml_value"]


def parse_overrides(
    texts: Sequence[str] | None, seconds: float | None, seed: int | None
) -> dict[str, Any]:
    """Values by dotted key that replace those of a scenario.

    Args:
        texts: of `--set`, each KEY=VALUE with the value as TOML has it, or a word.
        seconds: simulated time [s].
        seed: of the run.

    Raises:
        SteadytipError: a text without a key or a value.
    """
    found: dict[str, Any] = {}
    for text in texts or []:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise SteadytipError(f"--set {text}: write KEY=VALUE, as in part.hand.seed=3")
        found[key.strip()] = toml_value(value.strip())
    if seconds is not None:
        found["seconds"] = seconds
    if seed is not None:
        found["seed"] = seed
    return found


def toml_value(text: str) -> Any:
    """Parse a value as TOML; what is not TOML is a word."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
