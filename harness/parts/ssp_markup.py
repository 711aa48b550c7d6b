"""The XML of SSP: namespaces, schema check, units."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lxml import etree

from fmu_src.errors import SteadytipError
from fmu_src.kit.units import BASE
from harness.common.xml_files import parse_xml
from harness.parts.ports import Unit

if TYPE_CHECKING:
    from harness.parts.description import Description

__all__ = [
    "Kind",
    "add_units",
    "check",
    "convert",
    "element",
    "enumerations_of",
    "find_units",
    "read",
    "tag",
    "text",
    "units_of",
]

Kind = Literal["ssd", "ssv", "ssm"]
"""System structure description, parameter values, parameter mapping."""

_ROOTS: dict[str, str] = {
    "ssd": "SystemStructureDescription",
    "ssv": "ParameterSet",
    "ssm": "ParameterMapping",
}
_SCHEMAS: dict[str, str] = {
    "ssd": "SystemStructureDescription",
    "ssv": "SystemStructureParameterValues",
    "ssm": "SystemStructureParameterMapping",
    "ssc": "SystemStructureCommon",
}
_NAMESPACES = {p: f"http://ssp-standard.org/SSP1/{name}" for p, name in _SCHEMAS.items()}


def tag(prefix: str, name: str) -> str:
    """Qualified name of an element, as lxml writes it."""
    return f"{{{_NAMESPACES[prefix]}}}{name}"


def element(kind: Kind, **attributes: str) -> Any:
    """Root element of a new document.

    Prefixes are those of the standard's text: importers exist that know elements by them.
    """
    prefixes = {p: _NAMESPACES[p] for p in (kind, "ssc")}
    return etree.Element(tag(kind, _ROOTS[kind]), {"version": "1.0", **attributes}, prefixes)


def text(root: Any) -> bytes:
    """Serialise a document as a file holds it."""
    return bytes(etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True))


def read(content: bytes, kind: Kind, where: str) -> Any:
    """Root element of a document, checked against the standard's schema.

    Args:
        content: the document.
        kind: what it has to be.
        where: its name, for messages.

    Raises:
        SteadytipError: not XML, hostile, not of this kind, or against the schema.
    """
    root = parse_xml(content, where)
    check(root, kind, where)
    return root


def check(root: Any, kind: Kind, where: str) -> None:
    """Check an element against the standard's schema.

    Raises:
        SteadytipError: not of this kind, or against the schema.
    """
    if root.tag != tag(kind, _ROOTS[kind]):
        raise SteadytipError(f"{where} is not an SSP {_ROOTS[kind]}: its root is {root.tag}")
    version = root.get("version", "")
    if not version.startswith("1."):
        raise SteadytipError(f"{where} is of version '{version}'; versions 1.x are read")
    schema = _schema(kind)
    # A copy: an element inside a document would be judged with what stands around it.
    if not schema.validate(copy.deepcopy(root)):
        first = schema.error_log[0]
        raise SteadytipError(f"{where} breaks the SSP schema: line {first.line}: {first.message}")


@cache
def _schema(kind: Kind) -> Any:
    import fmpy.ssp

    folder = Path(fmpy.ssp.__file__).parent / "schema"
    return etree.XMLSchema(file=str(folder / f"{_SCHEMAS[kind]}.xsd"))


def find_units(root: Any, kind: Kind) -> dict[str, Unit]:
    """Units that a document defines, by name."""
    return {
        unit.get("name"): Unit(
            unit.get("name"),
            tuple(int(base.get(name, "0")) for name in BASE),
            float(base.get("factor", "1")),
            float(base.get("offset", "0")),
        )
        for unit in root.iterfind(f"{tag(kind, 'Units')}/{tag('ssc', 'Unit')}")
        for base in unit.iterfind(tag("ssc", "BaseUnit"))
    }


def add_units(root: Any, kind: Kind, units: Iterable[Unit]) -> None:
    """Define units in a document, in the order of their names; each is one with exponents."""
    known = sorted({unit.name: unit for unit in units}.items())
    if not known:
        return
    section = etree.SubElement(root, tag(kind, "Units"))
    for name, unit in known:
        entry = etree.SubElement(section, tag("ssc", "Unit"), {"name": name})
        base = {n: str(e) for n, e in zip(BASE, unit.exponents or (), strict=True) if e}
        base |= {"factor": repr(unit.factor)} if unit.factor != 1.0 else {}
        base |= {"offset": repr(unit.offset)} if unit.offset != 0.0 else {}
        etree.SubElement(entry, tag("ssc", "BaseUnit"), base)


def units_of(description: Description) -> Mapping[str, Unit]:
    """Units that an FMU defines, by name."""
    return description.units


def enumerations_of(description: Description) -> set[str]:
    """Names of an FMU's variables that are of an enumeration type."""
    return {v.name for v in description.model.modelVariables if v.type == "Enumeration"}


def convert(value: float, source: Unit, target: Unit) -> float | None:
    """Convert a value to another unit; None where the two do not measure the same.

    >>> ms = Unit("ms", (0, 0, 1, 0, 0, 0, 0, 0), 1e-3)
    >>> convert(2.0, ms, Unit("s", (0, 0, 1, 0, 0, 0, 0, 0)))
    0.002
    """
    if source.same_as(target):
        return value
    if source.exponents is None or source.exponents != target.exponents or not target.factor:
        return None
    return (value * source.factor + source.offset - target.offset) / target.factor
