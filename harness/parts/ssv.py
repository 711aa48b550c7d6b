"""Parameter sets in the SSP standard's format (System Structure Parameter Values, `.ssv`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from fmu_src.errors import SteadytipError
from harness.parts import ssp_markup as markup
from harness.parts.ports import Unit

__all__ = ["SsvValue", "find_values", "read_ssv", "write_ssv"]

_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}
_TYPES: Mapping[str, Callable[[str], float | int | bool | str]] = {
    "Real": float,
    "Integer": int,
    "Enumeration": int,
    "Boolean": lambda text: _BOOLEANS[text.strip()],
    "String": lambda text: text,
}


@dataclass(frozen=True)
class SsvValue:
    """One parameter of a set.

    Attributes:
        value: value of the type that the file gives.
        unit: name of the unit; None if the file gives none.
        definition: definition of the unit; None if the file gives none.
    """

    value: float | int | bool | str
    unit: str | None = None
    definition: Unit | None = None


def read_ssv(path: Path) -> dict[str, SsvValue]:
    """Read the values of a parameter set by name.

    Raises:
        SteadytipError: the file does not exist, is no parameter set, or a value has another type.
    """
    if not path.is_file():
        raise SteadytipError(f"parameter set {path} does not exist")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise SteadytipError(f"parameter set {path} cannot be read: {error.strerror}") from None
    where = f"{path} (an SSP parameter set, .ssv)"
    return find_values(markup.read(content, "ssv", where), where)


def find_values(root: Any, where: str) -> dict[str, SsvValue]:
    """Return the values of a checked parameter set by name.

    Args:
        root: its root element.
        where: its name, for messages.

    Raises:
        SteadytipError: a parameter is given twice, or a value cannot be used.
    """
    units = markup.find_units(root, "ssv")
    values: dict[str, SsvValue] = {}
    for parameter in root.iterfind(f"{markup.tag('ssv', 'Parameters')}/*"):
        name, entry = parameter.get("name"), next(parameter.iterchildren("*"))
        if name in values:
            raise SteadytipError(f"{where}: parameter '{name}' is given twice; keep one")
        unit = entry.get("unit")
        kind = etree.QName(entry).localname
        try:
            value = _TYPES[kind](entry.get("value"))
        except (KeyError, ValueError, TypeError):
            raise SteadytipError(
                f"{where}: parameter '{name}' = {entry.get('value')!r} is not usable as {kind}"
                + ("; give the number of the item" if kind == "Enumeration" else "")
            ) from None
        values[name] = SsvValue(value, unit, units.get(unit) if unit else None)
    return values


def write_ssv(name: str, values: Mapping[str, SsvValue]) -> bytes:
    """Return the content of the file of a parameter set.

    A set must define its units. It can only define units of whole powers of base units; others
    (`m/s2/Hz0.5`) are left out.

    Args:
        name: name of the set.
        values: values by name of the parameter.
    """
    root = markup.element("ssv", name=name)
    parameters = etree.SubElement(root, markup.tag("ssv", "Parameters"))
    units = []
    for key, entry in values.items():
        parameter = etree.SubElement(parameters, markup.tag("ssv", "Parameter"), {"name": key})
        kind, shown = _written(entry.value)
        attributes = {"value": shown}
        unit = entry.definition
        if kind == "Real" and unit is not None and unit.exponents is not None:
            attributes["unit"] = unit.name
            units.append(unit)
        etree.SubElement(parameter, markup.tag("ssv", kind), attributes)
    markup.add_units(root, "ssv", units)
    return markup.text(root)


def _written(value: float | int | bool | str) -> tuple[str, str]:
    if isinstance(value, bool):
        return "Boolean", str(value).lower()
    if isinstance(value, int):
        return "Integer", str(value)
    return ("Real", repr(value)) if isinstance(value, float) else ("String", value)
