"""Explain validation errors of tables: which key, which value, what is expected, what was meant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from harness.common.errors import nearest

__all__ = ["explain", "known_keys"]


def known_keys(model: type[BaseModel]) -> list[str]:
    """Return the keys of a table, as its author writes them."""
    return [field.alias or name for name, field in model.model_fields.items()]


def explain(
    error: ValidationError,
    model: type[BaseModel],
    inner: Mapping[str, type[BaseModel]] | None = None,
    also: Iterable[str] = (),
) -> list[str]:
    """Return a sentence for each mistake in a table.

    Args:
        error: what pydantic says.
        model: of the table.
        inner: models of the tables in it, by their dotted keys.
        also: further keys that the table itself may have.
    """
    tables = {"": model, **(inner or {})}
    return [_sentence(dict(entry), tables, also) for entry in error.errors()]


def _sentence(
    entry: Mapping[str, Any], tables: Mapping[str, type[BaseModel]], also: Iterable[str]
) -> str:
    # Pydantic names the alternatives of a union as if they were keys.
    place = [str(item) for item in entry["loc"] if item not in {"str", "list[str]"}]
    key = ".".join(place)
    if entry["type"] == "extra_forbidden":
        within = ["" if len(place) == 1 else ".".join(place[:n]) for n in (2, 1)]
        table = next(name for name in within if name in tables)
        known = [*known_keys(tables[table]), *(also if not table else ())]
        return f"unknown key '{key}'; {nearest(place[-1], known)}"
    if entry["type"] == "missing":
        return f"'{key}' is missing"
    text = entry["msg"].removeprefix("Value error, ")
    return f"'{key}' = {entry['input']!r}: {text[:1].lower()}{text[1:]}"
