"""Old names of scenario keys, which are read for one release, and noted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fmu_src.errors import SteadytipError

__all__ = ["OLD_NAMES", "OLD_ROLES", "with_new_names"]

OLD_ROLES = {
    "moved": "tip_uncompensated",
    "drive": "actuator_voltage",
    "stroke": "actuator_stroke",
}
"""Roles of `[signals]`; records of earlier versions hold these, too."""
OLD_NAMES: Mapping[str, Mapping[str, str]] = {
    "": {"step": "step_size", "settle": "warm_up"},
    "signals": OLD_ROLES,
    "hil": {"slack": "sample_deadline", "patience": "startup_timeout"},
}
"""New name of each old one, by the table that it stands in."""


def with_new_names(table: Mapping[str, Any], where: str, notes: list[str]) -> dict[str, Any]:
    """Return a scenario's table with its old names replaced.

    Args:
        table: of a file, a variant, or of overrides.
        where: it comes from, for messages.
        notes: one for each old name is appended.

    Raises:
        SteadytipError: a value is given under both names.
    """
    found = _renamed(table, "", where, notes)
    for name in ("signals", "hil"):
        if isinstance(found.get(name), Mapping):
            found[name] = _renamed(found[name], name, where, notes)
    return found


def _renamed(table: Mapping[str, Any], name: str, where: str, notes: list[str]) -> dict[str, Any]:
    old_names, prefix = OLD_NAMES[name], f"{name}." if name else ""
    found: dict[str, Any] = {}
    for key, value in table.items():
        new = old_names.get(key, key)
        if new in found or (new != key and new in table):
            raise SteadytipError(
                f"{where}: '{prefix}{key}' is the old name of '{prefix}{new}'; keep the new one"
            )
        found[new] = value
        if new != key:
            note = f"{where}: '{prefix}{key}' is called '{prefix}{new}' now; the old name goes soon"
            if note not in notes:
                notes.append(note)
    return found
