"""Values that an SSP element's parameter bindings give, under the names that they are given to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from fmu_src.errors import SteadytipError
from harness.parts import ssp_markup as markup
from harness.parts.ssp_markup import tag
from harness.parts.ssv import SsvValue, find_values
from harness.ssp.place import Place

__all__ = ["Transformation", "find_bindings", "transformation"]

_SET = "application/x-ssp-parameter-set"
_LINEAR = "LinearTransformation"
_MAPPINGS = tuple(f"{kind}MappingTransformation" for kind in ("Boolean", "Integer", "Enumeration"))

Transformation = tuple[float, float] | str
"""Factor and offset, or the name of a table's kind."""


def find_bindings(item: Any, place: Place, path: tuple[str, ...]) -> Iterator[tuple[str, SsvValue]]:
    """Names and values, in the order in which they are to be applied.

    A mapping names those parameters of its set that are applied; the others of the set are not.

    Args:
        item: component or system.
        place: where it stands.
        path: its name after those of the systems that hold it.

    Raises:
        SteadytipError: a parameter source that is missing, hostile, or not supported.
    """
    what = f"{place.where}: parameters of '{'.'.join(path)}'"
    for binding in item.iterfind(f"{tag('ssd', 'ParameterBindings')}/*"):
        if binding.get("type", _SET) != _SET:
            raise SteadytipError(f"{what} are of type {binding.get('type')}, which is unknown")
        parameters = binding.find(tag("ssd", "ParameterValues"))
        root = _content(binding, parameters, "ssv", place, path)
        if root is None:
            raise SteadytipError(f"{what} are bound to nothing")
        values = find_values(root, what)
        mapping = binding.find(tag("ssd", "ParameterMapping"))
        if mapping is not None:
            values = _mapped(values, _content(mapping, mapping, "ssm", place, path), what)
        for name, value in values.items():
            yield f"{binding.get('prefix', '')}{name}", value


def transformation(item: Any) -> Transformation | None:
    """Return what a connection or a mapping's entry does to a value; None if it changes nothing."""
    linear = item.find(tag("ssc", _LINEAR))
    if linear is not None:
        shape = float(linear.get("factor", "1")), float(linear.get("offset", "0"))
        return None if shape == (1.0, 0.0) else shape
    return next((kind for kind in _MAPPINGS if item.find(tag("ssc", kind)) is not None), None)


def _content(
    item: Any, holding: Any, kind: markup.Kind, place: Place, path: tuple[str, ...]
) -> Any:
    """Parameter set or mapping: of a file, or inside the element; None without either."""
    source = item.get("source")
    if source is not None:
        if item.get("sourceBase") == "component":
            raise SteadytipError(
                f"{place.where}: '{'.'.join(path)}' takes {source} from inside the component; "
                "put it beside the SSD"
            )
        return markup.read(place.file(source, path).read_bytes(), kind, f"{place.where}: {source}")
    inside = None if holding is None else next(holding.iterchildren("*"), None)
    if inside is not None:
        markup.check(inside, kind, f"{place.where}: parameters of '{'.'.join(path)}'")
    return inside


def _mapped(values: dict[str, SsvValue], entries: Any, what: str) -> dict[str, SsvValue]:
    """Values under the names that a mapping gives them."""
    mapped: dict[str, SsvValue] = {}
    for entry in () if entries is None else entries.iterfind(tag("ssm", "MappingEntry")):
        if entry.get("source") not in values:
            continue
        value = values[entry.get("source")]
        change = transformation(entry)
        if isinstance(change, tuple) and isinstance(value.value, float):
            factor, offset = change
            value = replace(value, value=value.value * factor + offset)
        elif change is not None:
            raise SteadytipError(
                f"{what}: the mapping of '{entry.get('source')}' changes the value by "
                f"{_LINEAR if isinstance(change, tuple) else change}, which is supported for Real "
                "and linear ones only"
            )
        mapped[entry.get("target")] = value
    return mapped
