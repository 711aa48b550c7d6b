"""Lay tables of scenarios over each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from harness.parts.kinds import kinds

__all__ = ["merge_tables", "nest_keys"]


def nest_keys(overrides: Mapping[str, Any], problems: list[str]) -> dict[str, Any]:
    """Values by dotted key as tables in tables.

    Args:
        overrides: values by dotted key.
        problems: keys that contradict each other are told here.
    """
    tables: dict[str, Any] = {}
    for dotted, value in overrides.items():
        *path, last = dotted.split(".")
        table = tables
        for key in path:
            table = table.setdefault(key, {})
            if not isinstance(table, dict):
                problems.append(f"override '{dotted}' = {value!r} contradicts another override")
                table = {}
        table[last] = value
    return tables


def merge_tables(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """`above` laid over `below`: tables merge, wires by their end, the rest is replaced."""
    laid = dict(below)
    for key, value in above.items():
        old = laid.get(key)
        if key == "wire" and isinstance(old, list) and isinstance(value, list):
            laid[key] = [wire for wire in old if not _ends_as(wire, value)] + value
        elif key == "vary" and isinstance(old, dict) and isinstance(value, dict):
            laid[key] = old | value  # what is said of a variable is not mixed
        elif key == "part" and isinstance(old, dict):
            laid[key] = old | {n: _merge_part(old.get(n, {}), p) for n, p in value.items()}
        elif isinstance(old, dict) and isinstance(value, dict):
            laid[key] = merge_tables(old, value)
        else:
            laid[key] = value
    return laid


def _ends_as(wire: Any, others: list[Any]) -> bool:
    ends = [other.get("to") for other in others if isinstance(other, dict)]
    return isinstance(wire, dict) and wire.get("to") in ends


def _merge_part(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    # Another kind of part has other settings: nothing of the old one fits.
    known = kinds().keys()
    changes_kind = any(key in known and key not in below for key in above)
    if not changes_kind or not below:
        return merge_tables(below, above)
    return {"stands_for": {k: v for k, v in below.items() if k != "stands_for"}, **above}
